//! A run from end to end: open a recording, track and map it, save and score the results.
//!
//! This is what `fgs run` and `fgs eval` do, as a library: it prints nothing, asks nothing and reads
//! no command line. [`RunOptions`] say what to run, [`Plan::resolve`] checks them and opens
//! everything, [`Plan::run`] does the work and leaves a folder ([`RunFolder`]) with the trajectory,
//! the map and the scores. A [`RunObserver`] sees each frame as it is tracked; setting the stop flag
//! ends the run early, with everything so far saved.
//!
//! ```no_run
//! use std::sync::atomic::AtomicBool;
//!
//! use fgs_run::{Plan, RunError, RunOptions};
//!
//! fn main() -> Result<(), RunError> {
//!     let options = RunOptions {
//!         dataset: "recordings/desk".into(),
//!         evaluate: true,
//!         ..RunOptions::default()
//!     };
//!     let (plan, model) = Plan::resolve(&options)?;
//!     println!("computing on {model}, results in {}", plan.folder.path().display());
//!     let stop = AtomicBool::new(false); // set it from any thread to end the run
//!     let result = plan.run(model, &mut (), &stop)?;
//!     println!("{} poses", result.trajectory.poses().len());
//!     println!("PSNR: {:?} dB", result.metrics.scores.get("psnr_valid_depth_db"));
//!     Ok(())
//! }
//! ```
//!
//! With [`RunOptions::checkpoint_every_secs`] the run also leaves its map in a form that outlives it
//! ([`MapFolder`]): another run goes on with it, or finds its camera in it.
//!
//! [`Plan::resolve_live`] does the same with a camera at work: frames come once, so that nothing can be
//! scored by them.
//!
//! [`ExportOptions`] take a finished run to other programs, as `fgs export` does.
//!
//! What a run is scored by stands in one place, [`SCORES`].

mod assignment;
mod backend;
mod checkpoints;
mod drive;
mod error;
mod evaluation;
mod export;
mod frame_log;
mod frame_range;
mod input;
mod map_folder;
mod merge;
mod metrics;
mod observer;
mod peak_memory;
mod pictures;
mod pipeline_cache;
mod plan;
mod recording;
mod reference;
mod report;
mod rescore;
mod run_folder;
mod run_result;
mod score_values;
mod scores;
mod settings;
mod up;

pub use backend::{Backend, Model};
pub use error::RunError;
pub use evaluation::score_images;
pub use export::{ExportFormat, ExportOptions, Exported, UnknownFormat};
pub use fgs_files::OutputFolder;
pub use frame_log::FrameRow;
pub use frame_range::FrameRange;
pub use input::{Input, LiveCamera};
pub use map_folder::MapFolder;
pub use merge::{MergeOptions, Merged, merge};
pub use metrics::{Metrics, RefinedMetrics};
pub use observer::{RunEvent, RunObserver};
pub use pictures::render_png;
pub use pipeline_cache::pipeline_cache_folder;
pub use plan::{KnownMap, Plan, RunOptions};
pub use recording::{open_recording, recording_name};
pub use report::{comparison_page, write_report};
pub use rescore::FinishedRun;
pub use run_folder::{
    CONFIG, FRAMES, MAP, METRICS, PICTURES, REFERENCE, REFINED_MAP, REPORT, RunFolder, TRAJECTORY,
    UP,
};
pub use run_result::RunResult;
pub use score_values::Scores;
pub use scores::{FrameErrors, SCORES, Score, Shown, Source, TrajectoryErrors};
pub use settings::{COMMIT, RunSettings, Settings};
pub use up::up_of;
