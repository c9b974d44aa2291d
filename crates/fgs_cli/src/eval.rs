//! `fgs eval`: scores the folder of a finished run (again).

use std::fmt::Write;
use std::path::PathBuf;

use clap::Args;
use fgs_run::{FinishedRun, SCORES};

use crate::console::Console;
use crate::failure::{EXIT_DONE, EXIT_INTERRUPTED, explain};
use crate::interrupt;
use crate::progress::Progress;
use crate::run::warn_of_poses;
use crate::threads::Threads;

/// Score the results of a finished run
///
/// Renders the map, and the refined one if there is one, at the pose of every tracked frame, compares
/// them with the recording, and writes the scores into the run's metrics.json and frames.csv.
#[derive(Debug, Args)]
#[command(after_long_help = after_help())]
pub struct EvalArgs {
    /// Folder of the run
    run: PathBuf,
    /// Folder of the recording [default: where it was during the run]
    #[arg(long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    #[command(flatten)]
    threads: Threads,
    /// Write the metrics to stdout as JSON
    #[arg(long)]
    json: bool,
}

fn after_help() -> String {
    let mut text = "\
Examples:
  fgs eval runs/desk
  fgs eval runs/desk --dataset /mnt/disk/desk     if the recording has moved

What the scores mean (those of images are means over the tracked frames):"
        .to_owned();
    for score in SCORES {
        // Writing to a string cannot fail.
        let _ = write!(text, "\n  {:<21}{}", score.name, score.meaning);
    }
    text
}

/// Executes `fgs eval`.
///
/// # Errors
/// If the folder or the recording cannot be read, or the scores cannot be written.
pub fn run(args: &EvalArgs) -> anyhow::Result<u8> {
    let console = Console::new(args.json);
    let finished = FinishedRun::open(&args.run, args.dataset.as_deref()).map_err(explain)?;
    warn_of_poses(finished.dataset());
    args.threads.apply()?;
    let stop = interrupt::stop_flag()?;
    let mut progress = Progress::new(Some(0), console);
    let result = finished.rescore(&mut progress, &stop);
    drop(progress);
    let Some(result) = result.map_err(explain)? else {
        return Ok(EXIT_INTERRUPTED);
    };
    console.event("metrics", &result.metrics);
    console.say(result.metrics.table());
    Ok(EXIT_DONE)
}
