//! `fgs view`: a finished map in the browser.

use std::io;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::Args;
use fgs_data::Trajectory;
use fgs_geom::Se3;
use fgs_run::{
    CONFIG, FinishedRun, OutputFolder, RunError, RunFolder, RunResult, Settings, TRAJECTORY,
    recording_name,
};
use fgs_splat::Gaussians;
use fgs_view::{Address, KeyframePictures, Site, SiteKeyframe, Summary};

use crate::console::Console;
use crate::failure::{EXIT_DONE, EXIT_INTERRUPTED};
use crate::interrupt;
use crate::threads::Threads;

/// How often to see whether somebody wants to stop.
const POLL: Duration = Duration::from_millis(100);

/// Look at a finished map in the browser
///
/// Serves a page with the map, the trajectory and the keyframes' pictures until Ctrl-C.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs view runs/desk                       http://127.0.0.1:7070/
  fgs view runs/desk/map.ply               a map alone, with trajectory.txt beside it if there is one
  fgs view runs/desk --export desk-pages   pages for any web server: cd desk-pages; python3 -m http.server

From another machine: `ssh -L 7070:localhost:7070 HOST`, or `--address 0.0.0.0:7070` and the address that
is printed, with its token.")]
pub struct ViewArgs {
    /// Folder of a run, or a PLY file
    #[arg(value_name = "RUN|MAP")]
    source: PathBuf,
    /// Write the pages into a folder in place of serving them
    #[arg(long, value_name = "DIR", conflicts_with = "address")]
    export: Option<PathBuf>,
    /// Where to serve: 0.0.0.0:7070 for other machines too, if they know the token that is printed
    #[arg(long, value_name = "ADDRESS", default_value_t)]
    address: Address,
    #[command(flatten)]
    threads: Threads,
}

/// Executes `fgs view`.
///
/// # Errors
/// If the map cannot be read, the pages not be written, or the address not be listened at.
pub fn run(args: &ViewArgs) -> anyhow::Result<u8> {
    let claimed = args.export.as_deref().map(OutputFolder::claim);
    let claimed = claimed.transpose().map_err(RunError::from)?;
    args.threads.apply()?;
    let stop = interrupt::stop_flag()?;
    let site = if args.source.is_dir() {
        of_run(&args.source, &stop)
    } else {
        of_map(&args.source)
    };
    let site = match site {
        Err(error) if is_interruption(&error) => return Ok(EXIT_INTERRUPTED),
        site => site?,
    };
    match claimed {
        Some(folder) => write(&site, &folder),
        None => serve(site, &args.address, &stop),
    }
}

fn is_interruption(error: &anyhow::Error) -> bool {
    let error = error.downcast_ref::<io::Error>();
    error.is_some_and(|error| error.kind() == io::ErrorKind::Interrupted)
}

/// Pages of a run: its map (the refined one if there is one), with pictures of keyframes. Photographs are
/// there if the recording is where it was.
fn of_run(path: &Path, stop: &AtomicBool) -> anyhow::Result<Site> {
    let folder = RunFolder::open(path)?;
    let result = RunResult::read(&folder)?;
    let map = result.refined.as_ref().unwrap_or(&result.gaussians);
    check(map, path)?;
    let settings = Settings::read(&folder.join(CONFIG))?;
    let poses: Vec<Se3> = poses(&result.trajectory);
    let rows = result.rows.iter().filter(|row| row.keyframe.is_some());
    let keyframes: Vec<SiteKeyframe> = rows
        .filter_map(|row| {
            Some(SiteKeyframe {
                index: row.index,
                kind: row.keyframe,
                world_from_camera: result.pose(row)?,
            })
        })
        .collect();
    let finished = FinishedRun::open(path, None).ok();
    let bar = Console::People.progress(Site::pictures(keyframes.len()), "pictures");
    let photograph = &mut |index| {
        let frame = finished.as_ref()?.dataset().frame(index).ok()?;
        Some(result.trajectory.synchronized(&frame).into_owned())
    };
    let on_picture = &mut || {
        bar.inc(1);
        if stop.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    };
    let pictures = settings.camera.map(|file| KeyframePictures {
        camera: *file.camera(),
        photograph,
        on_picture,
    });
    let summary = Summary {
        title: recording_name(path).to_string_lossy().into_owned(),
        numbers: numbers(&result),
    };
    let site = Site::new(&summary, map, &poses, &keyframes, pictures);
    bar.finish_and_clear();
    Ok(site?)
}

/// Pages of a map alone.
fn of_map(path: &Path) -> anyhow::Result<Site> {
    let map = fgs_splat::read_ply(path)?;
    check(&map, path)?;
    let trajectory = path.with_file_name(TRAJECTORY);
    let poses = if trajectory.is_file() {
        poses(&Trajectory::read(&trajectory)?)
    } else {
        Vec::new()
    };
    let summary = Summary {
        title: recording_name(path).to_string_lossy().into_owned(),
        numbers: Vec::new(),
    };
    Ok(Site::new(&summary, &map, &poses, &[], None)?)
}

fn check(map: &Gaussians, path: &Path) -> anyhow::Result<()> {
    if map.is_empty() {
        bail!(
            "the map of {} is empty: there is nothing to see",
            path.display()
        );
    }
    Ok(())
}

fn poses(trajectory: &Trajectory) -> Vec<Se3> {
    let poses = trajectory.poses().iter();
    poses.map(|pose| pose.world_from_camera).collect()
}

/// What there is to say about a run.
fn numbers(result: &RunResult) -> Vec<(String, String)> {
    let metrics = &result.metrics;
    let scores = metrics
        .refined
        .as_ref()
        .map_or(&metrics.scores, |refined| &refined.scores);
    let score = |name, factor: f64, digits: usize, unit: &str| {
        let value: Option<f64> = scores.get(name).or(metrics.scores.get(name));
        value.map(|value| format!("{:.digits$} {unit}", factor * value))
    };
    let some = |value: usize| Some(value.to_string());
    let numbers = [
        ("frames", some(metrics.frames)),
        ("keyframes", some(metrics.keyframes)),
        ("loops closed", some(metrics.loops)),
        ("lost", some(metrics.frames_lost)),
        ("speed", metrics.fps.map(|fps| format!("{fps:.1} fps"))),
        ("ATE", score("ate_rmse_m", 1000.0, 2, "mm")),
        ("PSNR", score("psnr_db", 1.0, 2, "dB")),
        ("SSIM", score("ssim", 1.0, 3, "")),
    ];
    let known = numbers.into_iter();
    known
        .filter_map(|(name, value)| Some((name.to_owned(), value?)))
        .collect()
}

fn write(site: &Site, folder: &OutputFolder) -> anyhow::Result<u8> {
    let path = folder.path().display();
    let cannot = || format!("cannot write {path}");
    let pages = folder.begin().with_context(cannot)?;
    site.write(&pages).with_context(cannot)?;
    pages.finish().map_err(RunError::from)?;
    Console::People.say(format!(
        "{path}: pages for any web server, such as\n  python3 -m http.server --bind 127.0.0.1 --directory {path}"
    ));
    Ok(EXIT_DONE)
}

fn serve(site: Site, address: &Address, stop: &AtomicBool) -> anyhow::Result<u8> {
    let server = site
        .serve(address)
        .with_context(|| format!("--address: cannot listen at {address}"))?;
    Console::People.say(format!("{}  until Ctrl-C", server.url()));
    while !stop.load(Ordering::Relaxed) {
        thread::sleep(POLL);
    }
    Ok(EXIT_DONE)
}
