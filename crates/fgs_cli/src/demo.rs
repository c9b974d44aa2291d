//! `fgs demo`: everything once, on a synthetic recording: synthesis, run, evaluation.

use std::path::{Path, PathBuf};

use clap::Args;
use fgs_data::{Dataset, OpenOptions};
use fgs_synth::{FRAMES_PER_LOOP, SensorModel, Sequence, kinect_camera};

use crate::backend::Backend;
use crate::console::Console;
use crate::failure::EXIT_DONE;
use crate::mode::Mode;
use crate::pipeline::Plan;
use crate::run_folder::RunFolder;
use crate::settings::Settings;
use crate::threads::Threads;
use crate::{interrupt, synth};

/// Half a Kinect's resolution and once round the room: two minutes on two cores.
const SIZE: (usize, usize) = (320, 240);
const FRAMES: usize = FRAMES_PER_LOOP;
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
    /// Where the map is optimised
    #[arg(long, value_enum, default_value_t)]
    backend: Backend,
    #[command(flatten)]
    threads: Threads,
}

/// Executes `fgs demo`.
///
/// # Errors
/// If something cannot be written or the device cannot be used.
pub fn run(args: &DemoArgs) -> anyhow::Result<u8> {
    let console = Console::People;
    let mut settings = Settings::default();
    let model = args.backend.model(&settings.mapping)?;
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
    settings.camera = Some(dataset.camera_file().clone());
    settings.record_run(&recording, mode, model.backend(), &frames);
    let plan = Plan {
        dataset_path: recording,
        dataset,
        frames,
        settings,
        mode,
        folder,
        evaluate: true,
    };
    let exit_code = plan.execute(model, console, &stop)?;
    let out = plan.folder.path().display();
    console.say(format!("\nLook at {out}/pictures (camera on the left, map on the right), or try\n  fgs render {out} --fly-through"));
    Ok(exit_code)
}
