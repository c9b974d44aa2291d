//! `fgs demo`: everything once, on a synthetic recording: synthesis, run, evaluation.

use std::path::{Path, PathBuf};

use clap::Args;
use fgs_data::{Dataset, OpenOptions};
use fgs_synth::{SensorModel, Sequence, kinect_camera};

use crate::console::Console;
use crate::failure::EXIT_DONE;
use crate::mode::Mode;
use crate::pipeline::Plan;
use crate::run_folder::RunFolder;
use crate::settings::Settings;
use crate::threads::Threads;
use crate::{interrupt, synth};

/// Half a Kinect's resolution and a third of a loop: minutes on two cores.
const SIZE: (usize, usize) = (320, 240);
const FRAMES: usize = 100;
const SEED: u64 = 1;

/// See it work, without any data of your own
///
/// Makes a recording of a synthetic room as a Kinect would see it, follows the camera, builds the
/// map, and compares both with the truth. Takes a few minutes on two cores.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for recording and results [default: the first free of runs/demo, runs/demo-2, ...]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    threads: Threads,
}

/// Executes `fgs demo`.
///
/// # Errors
/// If something cannot be written.
pub fn run(args: &DemoArgs) -> anyhow::Result<u8> {
    let console = Console::People;
    let folder = match &args.out {
        Some(path) => RunFolder::create(path)?,
        None => RunFolder::create_new(Path::new("runs"), "demo")?,
    };
    args.threads.apply()?;
    let stop = interrupt::stop_flag()?;

    let recording = folder.join("recording");
    let camera = kinect_camera(SIZE.0, SIZE.1)?;
    let sequence = Sequence::new(SEED, FRAMES, camera, SensorModel::kinect());
    let exit_code = synth::write(&sequence, false, &recording, console, &stop)?;
    if exit_code != EXIT_DONE {
        return Ok(exit_code);
    }
    let dataset = Dataset::open(&recording, &OpenOptions::default())?;
    let frames = 0..dataset.len();
    let mode = Mode::Lockstep;
    let mut settings = Settings {
        camera: Some(dataset.camera_file().clone()),
        ..Settings::default()
    };
    settings.record_run(&recording, mode, &frames);
    let plan = Plan {
        dataset_path: recording,
        dataset,
        frames,
        settings,
        mode,
        folder,
        evaluate: true,
    };
    let exit_code = plan.execute(console, &stop)?;
    let out = plan.folder.path().display();
    console.say(format!("\nLook at {out}/pictures (camera on the left, map on the right), or try\n  fgs render {out} --fly-through"));
    Ok(exit_code)
}
