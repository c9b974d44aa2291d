//! A synthetic room for whole runs, and how well they did.

#![allow(clippy::unwrap_used)]

use fgs_geom::{Image, KeyframeId, RgbdFrame, Se3, View};
use fgs_slam::{SlamConfig, SlamOutput};
use fgs_splat::{CpuModel, GaussianModel, Seeds};
use fgs_synth::{SensorModel, Sequence, kinect_camera};

pub type Frames = Vec<Result<RgbdFrame, std::io::Error>>;

pub fn room(frames: usize) -> Sequence {
    let camera = kinect_camera(160, 120).unwrap();
    Sequence::new(3, frames, camera, SensorModel::exact())
}

pub fn config() -> SlamConfig {
    let mut config = SlamConfig::default();
    config.mapping.iterations_per_frame = 2.0;
    config
}

pub fn frames(sequence: &Sequence) -> Frames {
    sequence.frames().map(Ok).collect()
}

/// The largest distance between estimated and true camera positions, both seen from the first.
pub fn worst_position_error_m(output: &SlamOutput, sequence: &Sequence) -> f64 {
    let first_from_world = sequence.world_from_camera(0).inverse();
    let errors = output.frames.iter().map(|frame| {
        let truth = first_from_world * sequence.world_from_camera(frame.index.0);
        let estimate = frame.world_from_camera.unwrap_or(Se3::identity());
        (estimate.translation - truth.translation).norm()
    });
    errors.fold(0.0, f64::max)
}

/// How well the map shows a tracked frame, seen from the frame's estimated pose.
pub fn psnr_of_map_db(output: &SlamOutput, sequence: &Sequence, index: usize) -> f64 {
    let seen = sequence.frame(index);
    let mut model = CpuModel::default();
    let seeds = Seeds {
        gaussians: output.gaussians.clone(),
        sparse_ids: vec![None; output.gaussians.len()],
    };
    model.insert(&seeds, KeyframeId(0)).unwrap();
    let rendered = model
        .render(&View {
            camera: seen.camera,
            world_from_camera: output.frames[index].world_from_camera.unwrap(),
        })
        .unwrap();
    psnr_db(&rendered.color, &seen.color)
}

fn psnr_db(render: &Image<[f32; 3]>, seen: &Image<[u8; 3]>) -> f64 {
    let pairs = render
        .data()
        .as_flattened()
        .iter()
        .zip(seen.data().as_flattened());
    let squares = pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b) / 255.0).powi(2));
    let count = 3 * render.data().len();
    -10.0 * (squares.sum::<f64>() / count as f64).log10()
}
