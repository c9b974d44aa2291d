//! `fgs run`: turns what the user typed into a [`Plan`] and executes it.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::backend::{Backend, Model};
use crate::console::Console;
use crate::frame_range::FrameRange;
use crate::interrupt;
use crate::mode::Mode;
use crate::pipeline::Plan;
use crate::recording;
use crate::run_folder::RunFolder;
use crate::settings::Settings;
use crate::threads::Threads;

/// Where runs without `--out` go.
const RUNS: &str = "runs";

/// Follow the camera and build the map
///
/// Reads a recording and writes a folder with the trajectory, the map and what became of each frame.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs run recordings/desk                            results in runs/desk
  fgs run rgbd_dataset_freiburg1_desk --config configs/tum-fr1.toml --eval
  fgs run recordings/desk --frames 0..200 --mode lockstep --out out/desk
  fgs run recordings/desk --set mapping.iterations_per_frame=10 --set seed=2
  fgs run recordings/desk --config runs/desk/config.effective.toml   the same run again

The recording is a folder in the layout of TUM RGB-D (rgb.txt, depth.txt), Replica (results/),
7-Scenes (frame-*.color.png), or has a folder rgb/ and a folder depth/ whose files pair up in the
order of their names. Unless the layout brings its camera, put a camera.toml into the folder:

  width = 640
  height = 480
  fx = 525.0
  fy = 525.0
  cx = 319.5
  cy = 239.5
  depth_scale = 1000.0    # the value in a depth image that means 1 metre

Settings: defaults, then --config, then --set. config.effective.toml in the results lists them all.
Camera: --camera, then the one beside the recording, then [camera] in --config.

Results: metrics.json, trajectory.txt (TUM: timestamp tx ty tz qx qy qz qw; lost frames are left
out), frames.csv, map.ply, config.effective.toml, pictures/. Results already in --out are replaced
when the run has ended.

Exit code: 0 done, 1 failed, 2 to be corrected by you, 130 ended by Ctrl-C (what there was is saved;
a second Ctrl-C gives that up). Where a graphics device fails, what there was is saved too.")]
pub struct RunArgs {
    /// Folder of the recording
    dataset: PathBuf,
    /// Settings, as TOML; any part of them
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Camera file; goes before the one beside the recording
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// One setting, such as mapping.prune_every=200; may be given many times
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
    /// Folder for the results [default: the first free of runs/NAME, runs/NAME-2, ...]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// How tracker and mapper take turns [default: lockstep]
    #[arg(long, value_enum)]
    mode: Option<Mode>,
    /// Where the map is optimised [default: auto]
    #[arg(long, value_enum)]
    backend: Option<Backend>,
    /// Only these frames: from A up to but without B, counted from 0
    #[arg(long, value_name = "A..B")]
    frames: Option<FrameRange>,
    #[command(flatten)]
    threads: Threads,
    /// Afterwards render every frame and score it (PSNR, SSIM, depth)
    #[arg(long)]
    eval: bool,
    /// Write JSON to stdout, one event a line; the last one holds the metrics
    #[arg(long)]
    json: bool,
}

/// Executes `fgs run`.
///
/// # Errors
/// If the run cannot be started, fails, or cannot be saved.
pub fn run(args: &RunArgs) -> anyhow::Result<u8> {
    let (plan, model) = resolve(args)?;
    args.threads.apply()?;
    let stop = interrupt::stop_flag()?;
    plan.execute(model, Console::new(args.json), &stop)
}

fn resolve(args: &RunArgs) -> anyhow::Result<(Plan, Model)> {
    let mut settings = Settings::load(args.config.as_deref(), &args.assignments)?;
    let dataset = recording::open(&args.dataset, args.camera.as_deref(), &mut settings)?;
    let frames = args.frames.or(settings.run.frames).unwrap_or_default();
    let frames = frames.resolve(dataset.len())?;
    recording::check_size(&dataset, frames.start)?;
    let mode = args.mode.or(settings.run.mode).unwrap_or(Mode::Lockstep);
    let backend = args.backend.or(settings.run.backend).unwrap_or_default();
    let model = backend.model(&settings.mapping)?;
    settings.record_run(&args.dataset, mode, model.backend(), &frames);
    let folder = match &args.out {
        Some(path) => RunFolder::create(path)?,
        None => RunFolder::create_new(Path::new(RUNS), &recording::name(&args.dataset))?,
    };
    let plan = Plan {
        dataset_path: args.dataset.clone(),
        dataset,
        frames,
        settings,
        mode,
        folder,
        evaluate: args.eval,
    };
    Ok((plan, model))
}
