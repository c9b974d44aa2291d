//! `--rerun` and `--save-rrd`: a run in the Rerun viewer, or in a file for it. Only with the feature `rerun`.

use std::path::PathBuf;

use clap::Args;
use fgs_data::Trajectory;
use fgs_rerun::{Outcome, Outputs, RerunError, RerunView};
use fgs_run::{Plan, REFERENCE, RunError, RunResult};

use crate::view;

/// The options.
#[derive(Debug, Args)]
pub struct Rerun {
    /// Show the run at work in the Rerun viewer that runs on this machine
    #[arg(long)]
    rerun: bool,
    /// Write what the Rerun viewer shows into a file
    #[arg(long, value_name = "FILE")]
    save_rrd: Option<PathBuf>,
}

impl Rerun {
    /// Turns to the viewer and begins the file, as far as they are wanted.
    ///
    /// # Errors
    /// If no viewer runs, or the file cannot be written.
    pub fn open(&self) -> Result<Option<Outputs>, RerunError> {
        let is_wanted = self.rerun || self.save_rrd.is_some();
        is_wanted
            .then(|| Outputs::open(self.rerun, self.save_rrd.as_deref()))
            .transpose()
    }
}

/// The run has ended: shows what it has come to.
///
/// # Errors
/// If something could not be shown or written.
pub fn end(
    view: RerunView,
    plan: &Plan,
    result: &Result<RunResult, RunError>,
) -> Result<(), RerunError> {
    // Whether there is one depends on the recording.
    let reference = Trajectory::read(&plan.folder.path().join(REFERENCE)).ok();
    let keyframes = result.as_ref().map_or(Vec::new(), view::keyframes);
    let outcome = result.as_ref().ok().map(|result| Outcome {
        map: result.finest_map(),
        keyframes: &keyframes,
        trajectory: &result.trajectory,
        reference: reference.as_ref(),
    });
    view.end(outcome.as_ref())
}
