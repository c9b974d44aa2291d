//! `fgs export`: a finished run in the formats of other programs.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use clap::Args;
use fgs_export::ExportError;
use fgs_run::{ExportFormat, ExportOptions, RunError};

use crate::console::Console;
use crate::failure::{EXIT_DONE, EXIT_INTERRUPTED, explain};
use crate::threads::Threads;
use crate::{choices, interrupt};

/// Take a finished run to other programs
///
/// Writes the map (the refined one if there is one), its surface or the trajectory in a format that
/// other programs read.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs export runs/desk --to spz                     runs/desk/export/map.spz
  fgs export runs/desk --to mesh-glb --voxel-m 0.02
  fgs export runs/desk --to colmap --out desk-colmap

Lengths are metres. The world of a run is the first camera: x right, y down, z forward. It is turned about
its origin so that floors are level, unless --raw-axes is given; spz, glb and mesh-glb want y up.")]
pub struct ExportArgs {
    /// Folder of the run
    run: PathBuf,
    /// Format
    #[arg(long, value_name = "FORMAT", value_parser = choices::export_format())]
    to: ExportFormat,
    /// File or folder to write [default: in RUN/export, which the next run into RUN replaces]
    #[arg(long, value_name = "PATH")]
    out: Option<PathBuf>,
    /// Folder of the recording, for colmap and nerfstudio [default: where it was during the run]
    #[arg(long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    /// Keep the first camera's axes in place of level ones
    #[arg(long)]
    raw_axes: bool,
    /// Side of a voxel, for meshes, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.01)]
    voxel_m: f64,
    #[command(flatten)]
    threads: Threads,
}

/// Executes `fgs export`.
///
/// # Errors
/// If the run or its recording cannot be read, there is nothing to export, or it cannot be written.
pub fn run(args: &ExportArgs) -> anyhow::Result<u8> {
    args.threads.apply()?;
    let stop = interrupt::stop_flag()?;
    let options = ExportOptions {
        run: args.run.clone(),
        to: args.to,
        out: args.out.clone(),
        dataset: args.dataset.clone(),
        raw_axes: args.raw_axes,
        voxel_m: args.voxel_m,
    };
    let mut bar = None;
    let exported = options.export(&mut |done, total| {
        bar.get_or_insert_with(|| Console::People.progress(total, "export"))
            .set_position(done as u64);
        if stop.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    let exported = match exported {
        Err(RunError::Export(ExportError::Stopped)) => return Ok(EXIT_INTERRUPTED),
        exported => exported.map_err(explain)?,
    };
    Console::People.say(format!(
        "{}: {}\naxes: {}; metres",
        exported.path.display(),
        exported.what,
        exported.axes
    ));
    Ok(EXIT_DONE)
}
