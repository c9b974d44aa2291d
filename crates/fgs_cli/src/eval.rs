//! `fgs eval`: scores the folder of an earlier run (again).

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;

use crate::console::Console;
use crate::failure::{EXIT_DONE, EXIT_INTERRUPTED, UsageError};
use crate::run_folder::{CONFIG, RunFolder};
use crate::run_result::RunResult;
use crate::settings::Settings;
use crate::threads::Threads;
use crate::{evaluation, interrupt, pictures, recording};

/// Score the results of an earlier run
///
/// Renders the map at the pose of every tracked frame, compares it with the recording, and writes
/// the numbers into the run's metrics.json and frames.csv.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs eval runs/desk
  fgs eval runs/desk --dataset /mnt/disk/desk     if the recording is not where it was

What the numbers mean (means over the tracked frames):
  ate_rmse_m, ate_mean_m  distance to the known positions after rigid alignment without scale
  rpe_mean_m              error of the motion between successive tracked frames
  psnr_valid_depth_db     where depth is measured
  psnr_db                 over all pixels that the camera saw
  psnr_paper_db           both images black where no depth is measured, those pixels counted
  psnr_heldout_db         as psnr_valid_depth_db, over frames that were never keyframes
  ssim, depth_l1_m        structural similarity; mean absolute depth error")]
pub struct EvalArgs {
    /// Folder of the run
    run: PathBuf,
    /// The recording [default: where it was during the run]
    #[arg(long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    #[command(flatten)]
    threads: Threads,
    /// Write the metrics to stdout as JSON
    #[arg(long)]
    json: bool,
}

/// Executes `fgs eval`.
///
/// # Errors
/// If the folder or the recording cannot be read, or the scores not be written.
pub fn run(args: &EvalArgs) -> anyhow::Result<u8> {
    let console = Console::new(args.json);
    check_run(&args.run)?;
    let folder = RunFolder::create(&args.run)?;
    let mut settings = Settings::read(&folder.join(CONFIG))?;
    let recorded = settings.run.dataset.clone();
    let path = args.dataset.clone().or(recorded).ok_or_else(|| {
        UsageError(format!(
            "{} names no recording: add --dataset DIR",
            args.run.display()
        ))
    })?;
    settings.run.camera_overrides = Some(true);
    let dataset = recording::open(&path, None, &mut settings)
        .context("cannot open the run's recording (--dataset DIR says where it is)")?;
    args.threads.apply()?;
    let stop = interrupt::stop_flag()?;
    let mut result = RunResult::read(&folder)?;
    evaluation::score_trajectory(&mut result, &dataset)?;
    if !evaluation::score_images(&mut result, &dataset, console, &stop)? {
        return Ok(EXIT_INTERRUPTED);
    }
    pictures::write_samples(&result, &dataset, &folder)?;
    result.save_numbers(&folder)?;
    console.event("metrics", &result.metrics);
    console.say(result.metrics.table());
    Ok(EXIT_DONE)
}

/// Refuses a folder that no run has made.
fn check_run(path: &Path) -> Result<(), UsageError> {
    if path.join(CONFIG).is_file() {
        return Ok(());
    }
    Err(UsageError(format!(
        "{} is not the folder of a run: it has no {CONFIG}",
        path.display()
    )))
}
