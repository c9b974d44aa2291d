//! `fgs run`: turns the arguments into options of a run, executes it and reports.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::bail;
use clap::Args;
use fgs_data::{Dataset, SensorTimes};
use fgs_run::{
    Backend, FrameRange, KnownMap, Model, Plan, RunOptions, RunResult, pipeline_cache_folder,
    recording_name,
};
use fgs_sensors::frames_to_measure;
use fgs_slam::{Execution, FrameStatus, Holdout};
use serde_json::json;

use crate::console::{Console, complain};
use crate::failure::{EXIT_DONE, EXIT_INTERRUPTED, explain};
use crate::live::{Live, Onlookers};
use crate::threads::Threads;
use crate::{camera, choices, interrupt};

/// Track the camera and build the map
///
/// Reads a recording and writes a folder with the trajectory, the map and a log of the frames.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs run recordings/desk                            results in runs/desk
  fgs run rgbd_dataset_freiburg1_desk --config configs/tum-fr1.toml --eval
  fgs run recordings/desk --frames 0..200 --mode lockstep --out out/desk
  fgs run recordings/desk --set mapping.iterations_per_frame=10 --set seed=2
  fgs run recordings/desk --refine 2000 --eval        a second, finer map: refined.ply
  fgs run recordings/desk --eval-holdout 8 --eval     scored by views the map has never seen
  fgs run recordings/desk --config runs/desk/config.effective.toml   repeats a run
  fgs run recordings/desk --live                      watch it in a browser
  fgs run recordings/desk --checkpoint-every 60       can go on after a power cut:
  fgs run --resume runs/desk
  fgs run --camera-source ros2:/camera --live         a camera at work
  fgs run recordings/desk-again --map runs/desk       goes on in a known place, once it is recognised

The recording is that of a phone, a robot or another program (Record3D, Stray Scanner, Polycam, ROS 2 bags
in MCAP, nerfstudio and COLMAP with depth; docs/recordings.md), or a folder in the layout of TUM RGB-D
(rgb.txt, depth.txt), Replica (results/), 7-Scenes (frame-*.color.png), or with folders rgb/ and depth/
whose files correspond in the order of their names. Unless the layout includes the
camera, put a camera.toml into the folder:

  width = 640
  height = 480
  fx = 525.0
  fy = 525.0
  cx = 319.5
  cy = 239.5
  depth_scale = 1000.0    # the value in a depth image that stands for 1 metre

When the sensors take their images (depth_delay_secs, color_readout_secs, depth_readout_secs in
camera.toml) is measured first from up to 300 frames, unless it is given.

Settings: --config overrides the defaults, and --set overrides both. config.effective.toml in the
results lists them all. The camera comes from --camera, else from the recording, else from [camera] in
--config. --camera also takes a settings file that has a [camera] table.

Results: metrics.json, trajectory.txt (TUM: timestamp tx ty tz qx qy qz qw; without lost frames),
frames.csv, map.ply, config.effective.toml, pictures/, report.html (a page for people) and, where the
recording has ground truth, reference.txt (the same in the run's coordinates). Results already in --out
are replaced when the run has ended. map.ply is the map at the last frame; --refine leaves it as it is
and adds refined.ply, with scores of its own (`refined` in metrics.json). A camera that is lost for long
where nothing is known starts a sub-map, with axes of its own, which is joined to the others if they
meet. All of the above is about the largest; what is left of others goes into trajectory_1.txt,
map_1.ply and so on, and frames.csv says which each frame is in (submap).

Maps: --checkpoint-every leaves a folder NAME.map beside the results' NAME, which holds all that a later run needs.
--resume goes on with the same recording, in lockstep with the same results as if nothing had happened.
--map starts another recording of the same place, of the same camera, in the map's coordinates; with
--localize-only the map stays as it is. Settings are the map's unless --config is given.

Live page: --live serves a page at http://127.0.0.1:7070/ with what the run sees and builds. From another
machine: `ssh -L 7070:localhost:7070 HOST`, or `--live 0.0.0.0:7070` and the address that is printed, with
its token. Whoever has the address can stop the run.

Live cameras: --camera-source KIND:NAME tracks a camera at work, in real time; frames that come too fast are
dropped. --frames ..N ends after N frames. Which kinds there are depends on how fgs was built
(docs/live-cameras.md).

Exit code: 0 done, 1 failed, 2 usage error, 130 stopped by Ctrl-C (the results so far are saved; a
second Ctrl-C skips that). If a graphics device fails, the results so far are saved too.")]
pub struct RunArgs {
    /// The recording: a folder or a file
    #[arg(required_unless_present_any = ["resume", "camera_source"])]
    dataset: Option<PathBuf>,
    /// A camera at work in place of a recording, such as ros2:/camera; Ctrl-C ends the run
    #[arg(
        long,
        value_name = "KIND:NAME",
        conflicts_with_all = ["dataset", "resume", "mode", "eval", "eval_holdout"]
    )]
    camera_source: Option<String>,
    /// Write the map, in a form that can be gone on with, every so many seconds and at the end
    #[arg(long, value_name = "SECS", conflicts_with = "localize_only")]
    checkpoint_every: Option<u64>,
    /// Go on with a run that has checkpoints, given by its folder
    #[arg(
        long,
        value_name = "DIR",
        conflicts_with_all = [
            "config", "camera", "assignments", "out", "mode", "backend", "frames", "refine",
            "eval_holdout", "map",
        ]
    )]
    resume: Option<PathBuf>,
    /// Start in the map of a run that had checkpoints: the camera finds itself and extends the map
    #[arg(long, value_name = "DIR")]
    map: Option<PathBuf>,
    /// Only find the camera in the map
    #[arg(long, requires = "map", conflicts_with = "refine")]
    localize_only: bool,
    /// Settings file (TOML); may be partial
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Camera file; overrides the recording's own camera
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// A single setting, such as mapping.prune_every=200; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
    /// Folder for the results [default: the first free of runs/NAME, runs/NAME-2, ...]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// How tracker and mapper take turns [default: lockstep]
    #[arg(long, value_parser = choices::execution())]
    mode: Option<Execution>,
    /// Where the map is optimised [default: auto]
    #[arg(long, value_parser = choices::backend())]
    backend: Option<Backend>,
    /// Only these frames: from A up to, but not including, B, counted from 0
    #[arg(long, value_name = "A..B")]
    frames: Option<FrameRange>,
    #[command(flatten)]
    threads: Threads,
    /// After the last frame, optimise the map by N more steps with all keyframes alike; the result is
    /// saved and scored beside the map as it was
    #[arg(long, value_name = "N")]
    refine: Option<u32>,
    /// Render and score every frame at the end (PSNR, SSIM, depth)
    #[arg(long)]
    eval: bool,
    /// Track the last of every N frames but keep it out of the map; --eval scores these frames beside the
    /// others, as test views
    #[arg(long, value_name = "N")]
    eval_holdout: Option<Holdout>,
    #[command(flatten)]
    live: Live,
    /// Write JSON to stdout, one event per line; the last one holds the metrics
    #[arg(long)]
    json: bool,
}

/// Executes `fgs run`.
///
/// # Errors
/// If the run cannot be started, fails, or cannot be saved.
pub fn run(args: &RunArgs) -> anyhow::Result<u8> {
    let known_map = match (&args.resume, &args.map) {
        (Some(folder), _) => Some(KnownMap::Resume(folder.clone())),
        (None, Some(folder)) if args.localize_only => Some(KnownMap::LocalizeOnly(folder.clone())),
        (None, Some(folder)) => Some(KnownMap::Extend(folder.clone())),
        (None, None) => None,
    };
    let options = RunOptions {
        dataset: args.dataset.clone().unwrap_or_default(),
        known_map,
        checkpoint_every_secs: args.checkpoint_every,
        config: args.config.clone(),
        assignments: args.assignments.clone(),
        camera: args.camera.clone(),
        execution: args.mode,
        backend: args.backend,
        frames: args.frames,
        refine: args.refine.map(|steps| steps as usize),
        eval_holdout: args.eval_holdout,
        out: args.out.clone(),
        evaluate: args.eval,
        pipeline_cache: pipeline_cache_folder(),
        command: Some(command_line()),
    };
    let mut onlookers = args.live.listen()?;
    let console = Console::new(args.json);
    let (mut plan, model) = match &args.camera_source {
        None => Plan::resolve(&options),
        Some(name) => {
            let camera = camera::open(name, console)?;
            onlookers.publisher = camera.publisher;
            Plan::resolve_live(&options, name, camera.source)
        }
    }
    .map_err(explain)?;
    args.threads.apply()?;
    let stop = interrupt::stop_flag()?;
    measure_sensor_times(&mut plan, console, &stop);
    let name = recording_name(&plan.dataset_path);
    let name = name.to_string_lossy();
    execute(&plan, model, (onlookers, &name), console, &stop)
}

/// Measures when the sensors take their images, if the camera file leaves it open, and reports it.
fn measure_sensor_times(plan: &mut Plan, console: Console, stop: &AtomicBool) {
    let Some(dataset) = plan.dataset() else {
        return;
    };
    if dataset.camera_file().sensor_times().are_known() {
        return;
    }
    let bar = console.progress(frames_to_measure(dataset), "measuring sensor times");
    plan.measure_sensor_times(|| {
        bar.inc(1);
        !stop.load(Ordering::Relaxed)
    });
    bar.finish_and_clear();
    let times = plan
        .dataset()
        .map(|dataset| dataset.camera_file().sensor_times());
    let Some(times) = times.filter(SensorTimes::are_known) else {
        // Stopped before anything was measured.
        return;
    };
    let [delay, color, depth] = [
        times.depth_delay_secs,
        times.color_readout_secs,
        times.depth_readout_secs,
    ]
    .map(|secs| secs.unwrap_or(0.0));
    console.event(
        "sensor_times",
        json!({
            "depth_delay_secs": delay,
            "color_readout_secs": color,
            "depth_readout_secs": depth,
        }),
    );
    console.say(format!(
        "sensor times: depth {:.1} ms after colour, rows read in {:.1} ms (colour) and {:.1} ms (depth)",
        1e3 * delay,
        1e3 * color,
        1e3 * depth
    ));
}

/// The command line as typed; what is not UTF-8 is shown as far as it can be.
pub fn command_line() -> String {
    let words: Vec<_> = std::env::args_os().collect();
    let words = words.iter().map(|word| word.to_string_lossy());
    words.collect::<Vec<_>>().join(" ")
}

/// Does what was planned and reports on it, also to those who look on, under a title; returns the exit code.
///
/// # Errors
/// If the page cannot be served, no frame can be read, the mapper fails, or something cannot be scored or saved.
pub fn execute(
    plan: &Plan,
    model: Model,
    (onlookers, title): (Onlookers, &str),
    console: Console,
    stop: &Arc<AtomicBool>,
) -> anyhow::Result<u8> {
    announce(plan, &model, console);
    let mut watchers = onlookers.watchers(title, plan, console, stop)?;
    let result = plan.run(model, &mut watchers, stop);
    watchers.end(plan, &result);
    let result = result.map_err(explain)?;
    report(plan, &result, console)?;
    Ok(if stop.load(Ordering::Relaxed) {
        EXIT_INTERRUPTED
    } else {
        EXIT_DONE
    })
}

fn announce(plan: &Plan, model: &Model, console: Console) {
    let camera = plan.input.camera();
    let format = match plan.dataset() {
        Some(dataset) => dataset.format().to_string(),
        None => "live camera".into(),
    };
    let (dataset, out) = (plan.dataset_path.display(), plan.folder.path());
    console.event(
        "start",
        json!({
            "dataset": plan.dataset_path.to_string_lossy(),
            "format": format,
            "frames": plan.num_frames_left().map(|_| plan.frames_left()),
            "width": camera.width,
            "height": camera.height,
            "backend": model.name,
            "out": out.to_string_lossy(),
        }),
    );
    let frames = match plan.dataset() {
        Some(dataset) => {
            let Range { start, end } = plan.frames_left();
            format!("frames {start}..{end} of {}", dataset.len())
        }
        None => match plan.num_frames_left() {
            Some(count) => format!("{count} frames"),
            None => "until Ctrl-C".into(),
        },
    };
    let (width, height) = (camera.width, camera.height);
    console.say(format!("{dataset}: {format}, {frames}, {width}x{height}"));
    console.say(format!("computing on {model}"));
    if let Some(dataset) = plan.dataset() {
        warn_of_poses(dataset);
    }
}

/// Says so if the recording's poses cannot be used.
pub fn warn_of_poses(dataset: &Dataset) {
    if let Some(error) = dataset.ground_truth_error() {
        complain(format_args!(
            "warning: the recording's poses are left out: {error}"
        ));
    }
}

fn report(plan: &Plan, result: &RunResult, console: Console) -> anyhow::Result<()> {
    let folder = plan.folder.path().display();
    console.event("metrics", &result.metrics);
    console.say(result.metrics.table());
    console.say(format!("  results    {folder}"));
    if let Some(failure) = &result.metrics.failure {
        let place = match &result.metrics.refined {
            Some(refined) => format!("after {} steps of refinement", refined.steps),
            None => format!("at frame {}", result.rows.last().map_or(0, |row| row.index)),
        };
        bail!("the run ended early, {place}: {failure}; the results so far are in {folder}");
    }
    let mut seen = result
        .rows
        .iter()
        .filter(|row| row.points.is_some())
        .peekable();
    if seen.peek().is_some() && seen.all(|row| row.status == FrameStatus::Lost) {
        let cause = if result.rows.iter().all(|row| row.points.unwrap_or(0) == 0) {
            "no surface is seen; is depth missing, further away than tracking.max_depth_m, or depth_scale wrong?"
        } else {
            "no frame fits another; do depth_scale and the focal lengths fit the images?"
        };
        let help = plan.dataset().map(|_| {
            let dataset = plan.dataset_path.display();
            format!(" `fgs doctor {dataset}` looks for the cause")
        });
        let help = help.unwrap_or_default();
        bail!("the camera was lost in every frame: {cause}{help}");
    }
    Ok(())
}
