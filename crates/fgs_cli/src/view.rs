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
use fgs_geom::{Camera, RgbdFrame, Se3};
use fgs_run::{
    CONFIG, FinishedRun, FrameRow, MAP, MapFolder, OutputFolder, REFINED_MAP, RunError, RunFolder,
    RunResult, Settings, TRAJECTORY, recording_name, up_of,
};
use fgs_splat::Gaussians;
use fgs_view::{Address, KeyframePictures, Site, SiteKeyframe, Summary};
use nalgebra::Vector3;

use crate::console::Console;
use crate::failure::{EXIT_DONE, EXIT_INTERRUPTED, UsageError};
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
  fgs view runs/desk.map                   the map of the last checkpoint (fgs run --checkpoint-every)
  fgs view runs/desk --export desk-pages   pages for any web server: cd desk-pages; python3 -m http.server

A run that was killed has left no results: what is shown of it is its last checkpoint.

From another machine: `ssh -L 7070:localhost:7070 HOST`, or `--address 0.0.0.0:7070` and the address that
is printed, with its token.")]
pub struct ViewArgs {
    /// Folder of a run or of a map with checkpoints, or a PLY file
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
    let site = match open(&args.source, &stop) {
        Err(error) if is_interruption(&error) => return Ok(EXIT_INTERRUPTED),
        site => site?,
    };
    match claimed {
        Some(folder) => write(&site, &folder),
        None => serve(site, &args.address, &stop),
    }
}

/// Pages of whatever there is: results before checkpoints.
fn open(source: &Path, stop: &AtomicBool) -> anyhow::Result<Site> {
    if let Ok(folder) = RunFolder::open(source) {
        return of_run(&folder, stop);
    }
    if source.is_file() {
        return of_map(source);
    }
    match MapFolder::open(source) {
        Ok(folder) => of_checkpoint(&folder, source, stop),
        Err(RunError::NoMap { path }) if path.is_dir() => {
            let path = path.display();
            bail!(UsageError(format!(
                "{path} is not the folder of a run: it has no {CONFIG}, nor is there a map of checkpoints"
            )))
        }
        Err(RunError::NoMap { path }) => of_map(&path),
        Err(error) => Err(error.into()),
    }
}

fn is_interruption(error: &anyhow::Error) -> bool {
    let error = error.downcast_ref::<io::Error>();
    error.is_some_and(|error| error.kind() == io::ErrorKind::Interrupted)
}

/// Pages of a run: its map (the refined one if there is one), with pictures of keyframes. Photographs are
/// there if the recording is where it was.
fn of_run(folder: &RunFolder, stop: &AtomicBool) -> anyhow::Result<Site> {
    let path = folder.path();
    let result = RunResult::read(folder)?;
    let map = result.finest_map();
    check(map, path)?;
    let settings = Settings::read(&folder.join(CONFIG))?;
    let poses = result.poses();
    let up = up_of(Some(path), map, &poses);
    let keyframes = keyframes(&result);
    let finished = FinishedRun::open(path, None).ok();
    let mut photograph = |place: usize| {
        let index = keyframes.get(place)?.index;
        let frame = finished.as_ref()?.dataset().frame(index).ok()?;
        Some(result.trajectory.synchronized(&frame).into_owned())
    };
    let pictures = settings
        .camera
        .map(|file| (*file.camera(), &mut photograph as Photograph<'_>));
    let summary = Summary {
        title: recording_name(path).to_string_lossy().into_owned(),
        numbers: numbers(&result),
    };
    with_pictures(&summary, (map, up), &poses, &keyframes, pictures, stop)
}

/// The keyframes that have a pose in the largest sub-map.
pub fn keyframes(result: &RunResult) -> Vec<SiteKeyframe> {
    let rows = result.rows.iter().filter(|row| row.keyframe.is_some());
    let keyframe = |row: &FrameRow| {
        Some(SiteKeyframe {
            index: row.index,
            kind: row.keyframe,
            world_from_camera: result.pose(row)?,
        })
    };
    rows.filter_map(keyframe).collect()
}

/// Pages of a map's last checkpoint. Its folder has the keyframes' photographs; the camera's path is drawn
/// from keyframe to keyframe.
fn of_checkpoint(folder: &MapFolder, source: &Path, stop: &AtomicBool) -> anyhow::Result<Site> {
    let saved = folder.session()?;
    let (map, records) = saved.largest_map()?;
    check(&map, folder.path())?;
    let poses: Vec<Se3> = (records.iter())
        .map(|record| record.world_from_camera)
        .collect();
    let keyframes: Vec<SiteKeyframe> = (records.iter())
        .map(|record| SiteKeyframe {
            index: record.index.0,
            kind: Some(record.kind),
            world_from_camera: record.world_from_camera,
        })
        .collect();
    let camera = *saved.camera();
    // A merge has left what is known.
    let up = up_of(Some(source), &map, &poses);
    let mut photograph = |place: usize| {
        let id = records.get(place)?.id;
        folder.keyframe(id, &camera).ok()
    };
    let mut numbers = vec![("keyframes".into(), keyframes.len().to_string())];
    let next = folder.next_frame();
    // A merged map has seen no frame of its own.
    if next > 0 {
        let path = folder.path().display();
        Console::People.say(format!("{path}: the last checkpoint, before frame {next}"));
        numbers.push(("last checkpoint before frame".into(), next.to_string()));
    }
    let summary = Summary {
        title: recording_name(folder.path()).to_string_lossy().into_owned(),
        numbers,
    };
    let pictures = Some((camera, &mut photograph as Photograph<'_>));
    with_pictures(&summary, (&map, up), &poses, &keyframes, pictures, stop)
}

/// Gives a keyframe's photograph.
type Photograph<'a> = &'a mut dyn FnMut(usize) -> Option<RgbdFrame>;

/// Pages with pictures of keyframes, if their camera is known, which take a while.
fn with_pictures(
    summary: &Summary,
    (map, up): (&Gaussians, Vector3<f64>),
    poses: &[Se3],
    keyframes: &[SiteKeyframe],
    pictures: Option<(Camera, Photograph<'_>)>,
    stop: &AtomicBool,
) -> anyhow::Result<Site> {
    let bar = Console::People.progress(Site::pictures(keyframes.len()), "pictures");
    let on_picture = &mut || {
        bar.inc(1);
        if stop.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    };
    let pictures = pictures.map(|(camera, photograph)| KeyframePictures {
        camera,
        photograph,
        on_picture,
    });
    let site = Site::new(summary, map, up, poses, keyframes, pictures);
    bar.finish_and_clear();
    Ok(site?)
}

/// Pages of a map alone.
fn of_map(path: &Path) -> anyhow::Result<Site> {
    let map = fgs_splat::read_ply(path)?;
    check(&map, path)?;
    let trajectory = path.with_file_name(TRAJECTORY);
    let poses = if trajectory.is_file() {
        let trajectory = Trajectory::read(&trajectory)?;
        let poses = trajectory.poses().iter();
        poses.map(|pose| pose.world_from_camera).collect()
    } else {
        Vec::new()
    };
    let summary = Summary {
        title: recording_name(path).to_string_lossy().into_owned(),
        numbers: Vec::new(),
    };
    // Other maps there have axes of their own.
    let is_main = [MAP, REFINED_MAP].iter().any(|name| path.ends_with(name));
    let up = up_of(path.parent().filter(|_| is_main), &map, &poses);
    Ok(Site::new(&summary, &map, up, &poses, &[], None)?)
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
