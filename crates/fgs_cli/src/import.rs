//! `fgs import`: writes a recording of any kind as a plain folder.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use anyhow::Context;
use clap::Args;
use fgs_recordings::{WriteError, write_plain};
use fgs_run::{Settings, open_recording};

use crate::console::{Console, Warnings};
use crate::failure::{EXIT_DONE, EXIT_INTERRUPTED};
use crate::interrupt;
use crate::run::warn_of_poses;

/// Write a recording of any kind as a plain folder of images
///
/// `fgs run` reads the same recordings as they are. A plain folder takes several times the room, but any
/// program reads it, and images can be looked at and left out.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Kinds: Record3D (.r3d), Stray Scanner, Polycam's raw data, ROS 2 bags in MCAP, nerfstudio and COLMAP with
depth images, and the plain layouts of `fgs run --help`.

Results: rgb/, depth/ (PNG, 16 bits), rgb.txt, depth.txt (TUM RGB-D: time stamp and file), camera.toml,
and groundtruth.txt or, of poses that a device or a program estimated, device_poses.txt.

Examples:
  fgs import scan.r3d recordings/scan
  fgs run recordings/scan --eval")]
pub struct ImportArgs {
    /// The recording: a file or a folder
    recording: PathBuf,
    /// Folder to write; must not exist
    out: PathBuf,
    /// Camera file; overrides the recording's own camera
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
}

/// Executes `fgs import`.
///
/// # Errors
/// If the recording cannot be read, or the folder exists or cannot be written.
pub fn run(args: &ImportArgs) -> anyhow::Result<u8> {
    let mut settings = Settings::default();
    let dataset = open_recording(&args.recording, args.camera.as_deref(), &mut settings)?;
    warn_of_poses(&dataset);
    if let Some(parent) = args.out.parent() {
        std::fs::create_dir_all(parent)
            .with_context(|| format!("cannot make {}", parent.display()))?;
    }
    let stop = interrupt::stop_flag()?;
    let console = Console::People;
    let bar = console.progress(dataset.len(), "frames");
    let mut damaged = Warnings::default();
    let written = write_plain(&dataset, &args.out, |index, error| {
        bar.inc(1);
        if let Some(error) = error {
            damaged.warn(&bar, format!("frame {index} is left out: {error}"));
        }
        if stop.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    bar.finish_and_clear();
    match written {
        Err(WriteError::Stopped) => Ok(EXIT_INTERRUPTED),
        Err(error) => Err(error.into()),
        Ok(frames) => {
            let (format, out) = (dataset.format(), args.out.display());
            console.say(format!("{out}: {frames} frames ({format})"));
            Ok(EXIT_DONE)
        }
    }
}
