//! fgs-slam from Python: the extension module `fgs_slam._fgs_slam`, a thin user of the crates. Frames and
//! maps cross as NumPy arrays (`arrays`); whatever computes does so with Python released; errors are
//! the exceptions of `fgs_slam/errors.py`.

mod arrays;
mod camera;
mod config;
mod errors;
mod evaluate;
mod export;
mod frequency;
mod gaussians;
mod gicp;
mod interrupt;
mod options;
mod pose;
mod recording;
mod run;
mod session;
mod synth;
mod trajectory;

#[pyo3::pymodule]
mod _fgs_slam {
    #[pymodule_export]
    #[allow(non_upper_case_globals, reason = "its name in Python")]
    const __version__: &str = env!("CARGO_PKG_VERSION");

    #[pymodule_export]
    use crate::{
        camera::Camera,
        config::Config,
        evaluate::{Ate, ate},
        export::export,
        frequency::detail_mask,
        gaussians::{Gaussians, Render},
        gicp::{PyAlignment, align},
        pose::Pose,
        recording::Recording,
        run::{Run, run},
        session::{Slam, SlamResult},
        synth::synth,
        trajectory::Trajectory,
    };
}
