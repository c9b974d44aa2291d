//! `fgs demo`: a synthetic recording is made, run and scored.

use std::path::{Path, PathBuf};

use clap::Args;
use fgs_run::{
    Backend, MAP, Plan, REPORT, RunOptions, Settings, TRAJECTORY, pipeline_cache_folder,
};
use fgs_slam::Execution;
use fgs_synth::{FRAMES_PER_LOOP, SensorModel, Sequence, kinect_camera};

use crate::console::Console;
use crate::failure::{EXIT_DONE, explain};
use crate::live::Live;
use crate::run::{command_line, execute};
use crate::threads::Threads;
use crate::{choices, interrupt, synth};

/// Half a Kinect's resolution, once round the room: two minutes on two cores.
const SIZE: (usize, usize) = (320, 240);
const FRAMES: usize = FRAMES_PER_LOOP;
const SEED: u64 = 1;

/// See it work without data of your own
///
/// Makes a recording of a synthetic room as a Kinect would see it, tracks the camera, builds the map,
/// and compares both with the ground truth. Takes a few minutes on two cores.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for the recording and, in run/, the results [default: the first free of runs/demo, runs/demo-2, ...]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Where the map is optimised
    #[arg(long, value_parser = choices::backend(), default_value_t)]
    backend: Backend,
    #[command(flatten)]
    live: Live,
    #[command(flatten)]
    threads: Threads,
}

/// Executes `fgs demo`.
///
/// # Errors
/// If something cannot be written or the device cannot be used.
pub fn run(args: &DemoArgs) -> anyhow::Result<u8> {
    let console = Console::People;
    if args.backend == Backend::Gpu {
        // Where there is no device, say so before the recording is made.
        let settings = Settings::default();
        let cache = pipeline_cache_folder();
        args.backend
            .model(&settings.mapping, cache.as_deref())
            .map_err(explain)?;
    }
    let onlookers = args.live.listen()?;
    let folder = args.out.clone().unwrap_or_else(first_free);
    args.threads.apply()?;
    let stop = interrupt::stop_flag()?;

    let recording = folder.join("recording");
    let camera = kinect_camera(SIZE.0, SIZE.1)?;
    let sequence = Sequence::new(SEED, FRAMES, camera, SensorModel::kinect());
    let exit_code = synth::write(&sequence, false, &recording, console, &stop)?;
    if exit_code != EXIT_DONE {
        return Ok(exit_code);
    }
    let options = RunOptions {
        dataset: recording,
        execution: Some(Execution::Lockstep),
        backend: Some(args.backend),
        out: Some(folder.join("run")),
        evaluate: true,
        pipeline_cache: pipeline_cache_folder(),
        command: Some(command_line()),
        ..RunOptions::default()
    };
    let (plan, model) = Plan::resolve(&options).map_err(explain)?;
    let exit_code = execute(&plan, model, (onlookers, "demo"), console, &stop)?;
    let out = plan.folder.path().display();
    console.say(format!(
        "
  report     {out}/{REPORT}
  map        {out}/{MAP}
  trajectory {out}/{TRAJECTORY}
  look at it with
    fgs view {out}"
    ));
    Ok(exit_code)
}

/// The first of `runs/demo`, `runs/demo-2`, ... that does not exist.
fn first_free() -> PathBuf {
    let mut path = Path::new("runs/demo").to_owned();
    let mut number = 2_u32;
    while path.symlink_metadata().is_ok() {
        path = Path::new("runs").join(format!("demo-{number}"));
        number += 1;
    }
    path
}
