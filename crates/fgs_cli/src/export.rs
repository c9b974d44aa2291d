//! `fgs export`: a finished run in the formats of other programs.

use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use clap::{Args, ValueEnum};
use fgs_data::Trajectory;
use fgs_export::{
    ExportError, Keyframe, Level, Mesh, TrainingSet, surface_mesh, surface_points, up_direction,
    write_compressed_ply, write_kitti, write_mesh_glb, write_mesh_obj, write_mesh_ply,
    write_points, write_splat, write_splat_glb, write_splat_ply, write_spz,
};
use fgs_geom::View;
use fgs_run::{
    CONFIG, FinishedRun, FrameRow, OutputFolder, RunError, RunFolder, RunResult, Settings,
};
use fgs_splat::Gaussians;
use indicatif::ProgressBar;
use nalgebra::Vector3;

use crate::console::Console;
use crate::failure::{EXIT_DONE, EXIT_INTERRUPTED, UsageError, explain};
use crate::interrupt;
use crate::threads::Threads;

/// The folder for exports, in that of the run.
const EXPORTS: &str = "export";

const OF_RUN: &str = "x right, y down, z forward from the first camera";
const OF_GLTF: &str = "x right, y up; the first camera looks along -z";
const LEVEL: &str = "level, x right, y down; the first camera looks over z";
const LEVEL_GLTF: &str = "level, x right, y up; the first camera looks over -z";

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
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: Format,
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
    #[arg(long, value_name = "METRES", default_value_t = 0.01, value_parser = voxel_m)]
    voxel_m: f64,
    #[command(flatten)]
    threads: Threads,
}

/// `--to`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Gaussians: PLY of the original 3D gaussian splatting
    Ply,
    /// Gaussians: PLY of SuperSplat, a quarter of the size
    CompressedPly,
    /// Gaussians: .splat of antimatter15's viewer
    Splat,
    /// Gaussians: Niantic's SPZ, a quarter of the size
    Spz,
    /// Gaussians: binary glTF with `KHR_gaussian_splatting`
    Glb,
    /// Coloured points of the measured surface: PLY
    Points,
    /// Coloured mesh of the measured surface: PLY
    MeshPly,
    /// The same as OBJ
    MeshObj,
    /// The same as binary glTF
    MeshGlb,
    /// Trajectory in TUM's format
    Tum,
    /// Trajectory in KITTI's format
    Kitti,
    /// The keyframes' images and poses, and points: COLMAP's text files
    Colmap,
    /// The same for nerfstudio
    Nerfstudio,
}

impl Format {
    /// Name of the file or folder.
    fn default_name(self) -> &'static str {
        match self {
            Self::Ply => "map.ply",
            Self::CompressedPly => "map.compressed.ply",
            Self::Splat => "map.splat",
            Self::Spz => "map.spz",
            Self::Glb => "map.glb",
            Self::Points => "points.ply",
            Self::MeshPly => "mesh.ply",
            Self::MeshObj => "mesh.obj",
            Self::MeshGlb => "mesh.glb",
            Self::Tum => "trajectory.tum.txt",
            Self::Kitti => "trajectory.kitti.txt",
            Self::Colmap => "colmap",
            Self::Nerfstudio => "nerfstudio",
        }
    }

    fn axes(self, is_level: bool) -> &'static str {
        match (self, is_level) {
            (Self::Spz | Self::Glb | Self::MeshGlb, true) => LEVEL_GLTF,
            (Self::Spz | Self::Glb | Self::MeshGlb, false) => OF_GLTF,
            (_, true) => LEVEL,
            (_, false) => OF_RUN,
        }
    }
}

/// Below a millimetre voxels are finer than any map.
fn voxel_m(text: &str) -> Result<f64, String> {
    let voxel_m = text.parse().ok();
    let possible = voxel_m.filter(|voxel_m| (0.001..=1.0).contains(voxel_m));
    possible.ok_or_else(|| "a length of 0.001 to 1 m is expected".to_owned())
}

/// Executes `fgs export`.
///
/// # Errors
/// If the run or its recording cannot be read, there is nothing to export, or it cannot be written.
pub fn run(args: &ExportArgs) -> anyhow::Result<u8> {
    let folder = RunFolder::open(&args.run)?;
    let out = match &args.out {
        Some(out) => out.clone(),
        None => folder.join(EXPORTS).join(args.to.default_name()),
    };
    if args.out.is_some() {
        prepare(&out, &folder)?;
    }
    let mut result = RunResult::read(&folder)?;
    if !args.raw_axes {
        turn_level(&mut result)?;
    }
    args.threads.apply()?;
    let stop = interrupt::stop_flag()?;
    let written = match &args.out {
        Some(out) => write(args, &result, out, &stop),
        None => write_in_run(args, &folder, &result, &stop),
    };
    let what = match written {
        Err(error) if matches!(error.downcast_ref(), Some(ExportError::Stopped)) => {
            return Ok(EXIT_INTERRUPTED);
        }
        written => written?,
    };
    Console::People.say(format!(
        "{}: {what}\naxes: {}; metres",
        out.display(),
        args.to.axes(!args.raw_axes)
    ));
    Ok(EXIT_DONE)
}

/// Turns maps and poses so that floors are level.
fn turn_level(result: &mut RunResult) -> anyhow::Result<()> {
    let poses = result.trajectory.poses();
    let ups = poses
        .iter()
        .map(|pose| -(pose.world_from_camera.rotation * Vector3::y()));
    let map = result.refined.as_ref().unwrap_or(&result.gaussians);
    let level = Level::new(up_direction(map, ups.sum()));
    result.gaussians = level.map(&result.gaussians);
    result.refined = result.refined.as_ref().map(|map| level.map(map));
    let poses = poses
        .iter()
        .map(|pose| (pose.timestamp_secs, level.pose(&pose.world_from_camera)));
    result.trajectory = Trajectory::new(poses)?;
    Ok(())
}

/// Makes the folder around the place that the user named. A file there is replaced, but not one of the
/// run's own.
fn prepare(out: &Path, folder: &RunFolder) -> anyhow::Result<()> {
    if folder.holds_result(out) {
        let refusal = format!("--out: {} belongs to the run", out.display());
        return Err(UsageError(refusal).into());
    }
    if let Some(parent) = out.parent() {
        fs::create_dir_all(parent).with_context(|| format!("cannot make {}", parent.display()))?;
    }
    Ok(())
}

/// Writes into the run's folder, beside earlier exports, so that they are known as the program's own:
/// the next run there replaces them with the rest.
fn write_in_run(
    args: &ExportArgs,
    folder: &RunFolder,
    result: &RunResult,
    stop: &AtomicBool,
) -> anyhow::Result<String> {
    let (exports, name) = (folder.join(EXPORTS), args.to.default_name());
    let out = exports.join(name);
    if out.is_dir() {
        return Err(ExportError::Exists { path: out }.into());
    }
    let folder = OutputFolder::claim_any(&exports).map_err(RunError::from)?;
    let cannot_write = |source| ExportError::Write {
        path: out.clone(),
        source,
    };
    let staged = folder.begin().map_err(cannot_write)?;
    staged.carry_over(&[]).map_err(cannot_write)?;
    staged.may_replace(name).map_err(RunError::from)?;
    let written = write(args, result, &staged.path().join(name), stop);
    let what = written.map_err(|error| match error.downcast() {
        // Not where it is for the moment.
        Ok(ExportError::Write { source, .. }) => cannot_write(source).into(),
        Ok(error) => error.into(),
        Err(error) => error,
    })?;
    staged.finish().map_err(RunError::from)?;
    Ok(what)
}

/// Writes the export; returns what it holds, in words.
fn write(
    args: &ExportArgs,
    result: &RunResult,
    out: &Path,
    stop: &AtomicBool,
) -> anyhow::Result<String> {
    let map = result.refined.as_ref().unwrap_or(&result.gaussians);
    let trajectory = &result.trajectory;
    match args.to {
        Format::Tum => write_file(out, |file| trajectory.encode(file))?,
        Format::Kitti => write_file(out, |file| write_kitti(file, trajectory))?,
        _ if map.is_empty() => anyhow::bail!("the run's map is empty"),
        Format::Ply => write_file(out, |file| write_splat_ply(file, map))?,
        Format::CompressedPly => write_file(out, |file| write_compressed_ply(file, map))?,
        Format::Splat => write_file(out, |file| write_splat(file, map))?,
        Format::Spz => write_file(out, |file| write_spz(file, map))?,
        Format::Glb => write_file(out, |file| write_splat_glb(file, map))?,
        Format::Points => {
            let points = surface_points(map);
            write_file(out, |file| write_points(file, &points))?;
            return Ok(format!("{} points", points.len()));
        }
        Format::MeshPly | Format::MeshObj | Format::MeshGlb => {
            let mesh = mesh(args, result, map, stop)?;
            write_file(out, |file| match args.to {
                Format::MeshPly => write_mesh_ply(file, &mesh),
                Format::MeshObj => write_mesh_obj(file, &mesh),
                _ => write_mesh_glb(file, &mesh),
            })?;
            let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
            return Ok(format!("{vertices} vertices, {triangles} triangles"));
        }
        Format::Colmap | Format::Nerfstudio => {
            return write_training_set(args, result, map, out, stop);
        }
    }
    Ok(match args.to {
        Format::Tum | Format::Kitti => format!(
            "{} poses, {} frames without one left out",
            trajectory.poses().len(),
            result.rows.len() - trajectory.poses().len()
        ),
        _ => format!("{} gaussians", map.len()),
    })
}

fn mesh(
    args: &ExportArgs,
    result: &RunResult,
    map: &Gaussians,
    stop: &AtomicBool,
) -> anyhow::Result<Mesh> {
    let settings = Settings::read(&args.run.join(CONFIG))?;
    let camera = *settings.camera.context("the run names no camera")?.camera();
    let views: Vec<View> = keyframes(result)
        .iter()
        .map(|keyframe| View {
            camera,
            world_from_camera: keyframe.world_from_camera,
        })
        .collect();
    let bar = Console::People.progress(3 * views.len(), "mesh");
    let mesh = surface_mesh(map, &views, args.voxel_m, &mut || advance(&bar, stop));
    bar.finish_and_clear();
    Ok(mesh?)
}

/// Writes a folder of the keyframes' images.
fn write_training_set(
    args: &ExportArgs,
    result: &RunResult,
    map: &Gaussians,
    out: &Path,
    stop: &AtomicBool,
) -> anyhow::Result<String> {
    let finished = FinishedRun::open(&args.run, args.dataset.as_deref()).map_err(explain)?;
    let (keyframes, points) = (keyframes(result), surface_points(map));
    let set = TrainingSet {
        dataset: finished.dataset(),
        trajectory: &result.trajectory,
        keyframes: &keyframes,
        points: &points,
    };
    let bar = Console::People.progress(keyframes.len(), "images");
    let mut on_image = || advance(&bar, stop);
    let written = match args.to {
        Format::Colmap => set.write_colmap(out, &mut on_image),
        _ => set.write_nerfstudio(out, &mut on_image),
    };
    bar.finish_and_clear();
    written?;
    Ok(format!(
        "{} images, {} points",
        keyframes.len(),
        points.len()
    ))
}

/// One step further, if nobody has asked to stop.
fn advance(bar: &ProgressBar, stop: &AtomicBool) -> ControlFlow<()> {
    bar.inc(1);
    if stop.load(Ordering::Relaxed) {
        ControlFlow::Break(())
    } else {
        ControlFlow::Continue(())
    }
}

/// The keyframes that have a pose.
fn keyframes(result: &RunResult) -> Vec<Keyframe> {
    let rows = result.rows.iter().filter(|row| row.keyframe.is_some());
    let keyframe = |row: &FrameRow| {
        Some(Keyframe {
            index: row.index,
            world_from_camera: result.pose(row)?,
        })
    };
    rows.filter_map(keyframe).collect()
}

fn write_file(
    path: &Path,
    content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), ExportError> {
    fgs_files::write_file(path, content).map_err(|source| ExportError::Write {
        path: path.into(),
        source,
    })
}
