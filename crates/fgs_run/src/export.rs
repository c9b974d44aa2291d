//! A finished run in the formats of other programs.

use std::fmt;
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use fgs_data::Trajectory;
use fgs_export::{
    ExportError, Keyframe, Level, Mesh, TrainingSet, surface_mesh, surface_points,
    write_compressed_ply, write_kitti, write_mesh_glb, write_mesh_obj, write_mesh_ply,
    write_points, write_splat, write_splat_glb, write_splat_ply, write_spz,
};
use fgs_files::OutputFolder;
use fgs_geom::View;
use fgs_splat::Gaussians;
use nalgebra::Vector3;

use crate::error::RunError;
use crate::frame_log::FrameRow;
use crate::rescore::FinishedRun;
use crate::run_folder::{CONFIG, RunFolder};
use crate::run_result::RunResult;
use crate::settings::Settings;
use crate::up::up_of;

/// The folder for exports, in that of the run.
const EXPORTS: &str = "export";

const OF_RUN: &str = "x right, y down, z forward from the first camera";
const OF_GLTF: &str = "x right, y up; the first camera looks along -z";
const LEVEL: &str = "level, x right, y down; the first camera looks over z";
const LEVEL_GLTF: &str = "level, x right, y up; the first camera looks over -z";

/// Sides of a voxel that are possible, metres: below a millimetre voxels are finer than any map.
const VOXEL_M: std::ops::RangeInclusive<f64> = 0.001..=1.0;

/// What an export is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// Gaussians: PLY of the original 3D gaussian splatting.
    Ply,
    /// Gaussians: PLY of `SuperSplat`, a quarter of the size.
    CompressedPly,
    /// Gaussians: .splat of antimatter15's viewer.
    Splat,
    /// Gaussians: Niantic's SPZ, a quarter of the size.
    Spz,
    /// Gaussians: binary glTF with `KHR_gaussian_splatting`.
    Glb,
    /// Coloured points of the measured surface: PLY.
    Points,
    /// Coloured mesh of the measured surface: PLY.
    MeshPly,
    /// The same as OBJ.
    MeshObj,
    /// The same as binary glTF.
    MeshGlb,
    /// Trajectory in TUM's format.
    Tum,
    /// Trajectory in KITTI's format.
    Kitti,
    /// The keyframes' images and poses, and points: COLMAP's text files.
    Colmap,
    /// The same for nerfstudio.
    Nerfstudio,
}

/// No [`ExportFormat`] has this name.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("'{0}' is no format for exports")]
pub struct UnknownFormat(String);

impl ExportFormat {
    /// All of them.
    pub const ALL: [Self; 13] = [
        Self::Ply,
        Self::CompressedPly,
        Self::Splat,
        Self::Spz,
        Self::Glb,
        Self::Points,
        Self::MeshPly,
        Self::MeshObj,
        Self::MeshGlb,
        Self::Tum,
        Self::Kitti,
        Self::Colmap,
        Self::Nerfstudio,
    ];

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

impl fmt::Display for ExportFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ply => "ply",
            Self::CompressedPly => "compressed-ply",
            Self::Splat => "splat",
            Self::Spz => "spz",
            Self::Glb => "glb",
            Self::Points => "points",
            Self::MeshPly => "mesh-ply",
            Self::MeshObj => "mesh-obj",
            Self::MeshGlb => "mesh-glb",
            Self::Tum => "tum",
            Self::Kitti => "kitti",
            Self::Colmap => "colmap",
            Self::Nerfstudio => "nerfstudio",
        })
    }
}

impl FromStr for ExportFormat {
    type Err = UnknownFormat;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let mut all = Self::ALL.into_iter();
        all.find(|format| format.to_string() == name)
            .ok_or_else(|| UnknownFormat(name.into()))
    }
}

/// What to export of a run, and how.
#[derive(Clone, Debug)]
pub struct ExportOptions {
    /// Folder of the run.
    pub run: PathBuf,
    /// The format.
    pub to: ExportFormat,
    /// File or folder to write; in the run's folder `export`, which the next run there replaces.
    pub out: Option<PathBuf>,
    /// Folder of the recording, for photographs; where it was during the run.
    pub dataset: Option<PathBuf>,
    /// Keep the first camera's axes in place of level ones.
    pub raw_axes: bool,
    /// Side of a voxel, for meshes, 0.001 to 1 m.
    pub voxel_m: f64,
}

/// What was exported.
#[derive(Clone, Debug)]
pub struct Exported {
    /// The file or folder.
    pub path: PathBuf,
    /// What it holds, in words.
    pub what: String,
    /// Its axes, in words.
    pub axes: &'static str,
}

/// Sees how far an export is, as (done, total), and may end it.
pub type OnStep<'a> = &'a mut dyn FnMut(usize, usize) -> ControlFlow<()>;

impl ExportOptions {
    /// Writes the map (the refined one if there is one), its surface or the trajectory. A file that
    /// exists is replaced, but not one of the run's own; a folder never is.
    ///
    /// # Errors
    /// If the run or its recording cannot be read, there is nothing to export, it cannot be written, or
    /// `on_step` ended it ([`ExportError::Stopped`]).
    pub fn export(&self, on_step: OnStep<'_>) -> Result<Exported, RunError> {
        if !VOXEL_M.contains(&self.voxel_m) {
            return Err(RunError::VoxelSize(self.voxel_m));
        }
        let folder = RunFolder::open(&self.run)?;
        if let Some(out) = &self.out {
            prepare(out, &folder)?;
        }
        let mut result = RunResult::read(&folder)?;
        if !self.raw_axes {
            let up = up_of(Some(folder.path()), result.finest_map(), &result.poses());
            turn_level(&mut result, up)?;
        }
        let (path, what) = match &self.out {
            Some(out) => (out.clone(), self.write(&result, out, on_step)?),
            None => self.write_in_run(&folder, &result, on_step)?,
        };
        Ok(Exported {
            path,
            what,
            axes: self.to.axes(!self.raw_axes),
        })
    }

    /// Writes into the run's folder, beside earlier exports, so that they are known as the program's
    /// own: the next run there replaces them with the rest.
    fn write_in_run(
        &self,
        folder: &RunFolder,
        result: &RunResult,
        on_step: OnStep<'_>,
    ) -> Result<(PathBuf, String), RunError> {
        let (exports, name) = (folder.join(EXPORTS), self.to.default_name());
        let out = exports.join(name);
        if out.is_dir() {
            return Err(ExportError::Exists { path: out }.into());
        }
        let folder = OutputFolder::claim_any(&exports)?;
        let cannot_write = |source| ExportError::Write {
            path: out.clone(),
            source,
        };
        let staged = folder.begin().map_err(cannot_write)?;
        staged.carry_over(&[]).map_err(cannot_write)?;
        staged.may_replace(name)?;
        let written = self.write(result, &staged.path().join(name), on_step);
        let what = written.map_err(|error| match error {
            // Not where it is for the moment.
            RunError::Export(ExportError::Write { source, .. }) => cannot_write(source).into(),
            error => error,
        })?;
        staged.finish()?;
        Ok((out, what))
    }

    /// Writes the export; returns what it holds, in words.
    fn write(
        &self,
        result: &RunResult,
        out: &Path,
        on_step: OnStep<'_>,
    ) -> Result<String, RunError> {
        let map = result.finest_map();
        let trajectory = &result.trajectory;
        match self.to {
            ExportFormat::Tum => write_file(out, |file| trajectory.encode(file))?,
            ExportFormat::Kitti => write_file(out, |file| write_kitti(file, trajectory))?,
            _ if map.is_empty() => return Err(RunError::EmptyMap),
            ExportFormat::Ply => write_file(out, |file| write_splat_ply(file, map))?,
            ExportFormat::CompressedPly => write_file(out, |file| write_compressed_ply(file, map))?,
            ExportFormat::Splat => write_file(out, |file| write_splat(file, map))?,
            ExportFormat::Spz => write_file(out, |file| write_spz(file, map))?,
            ExportFormat::Glb => write_file(out, |file| write_splat_glb(file, map))?,
            ExportFormat::Points => {
                let points = surface_points(map);
                write_file(out, |file| write_points(file, &points))?;
                return Ok(format!("{} points", points.len()));
            }
            ExportFormat::MeshPly | ExportFormat::MeshObj | ExportFormat::MeshGlb => {
                let mesh = self.mesh(result, map, on_step)?;
                write_file(out, |file| match self.to {
                    ExportFormat::MeshPly => write_mesh_ply(file, &mesh),
                    ExportFormat::MeshObj => write_mesh_obj(file, &mesh),
                    _ => write_mesh_glb(file, &mesh),
                })?;
                let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
                return Ok(format!("{vertices} vertices, {triangles} triangles"));
            }
            ExportFormat::Colmap | ExportFormat::Nerfstudio => {
                return self.write_training_set(result, map, out, on_step);
            }
        }
        Ok(match self.to {
            ExportFormat::Tum | ExportFormat::Kitti => format!(
                "{} poses, {} frames without one left out",
                trajectory.poses().len(),
                result.rows.len() - trajectory.poses().len()
            ),
            _ => format!("{} gaussians", map.len()),
        })
    }

    fn mesh(
        &self,
        result: &RunResult,
        map: &Gaussians,
        on_step: OnStep<'_>,
    ) -> Result<Mesh, RunError> {
        let path = self.run.join(CONFIG);
        let camera = Settings::read(&path)?.camera;
        let camera = *camera.ok_or(RunError::NoCamera { path })?.camera();
        let views: Vec<View> = keyframes(result)
            .iter()
            .map(|keyframe| View {
                camera,
                world_from_camera: keyframe.world_from_camera,
            })
            .collect();
        let mut on_view = counted(3 * views.len(), on_step);
        Ok(surface_mesh(map, &views, self.voxel_m, &mut on_view)?)
    }

    /// Writes a folder of the keyframes' images.
    fn write_training_set(
        &self,
        result: &RunResult,
        map: &Gaussians,
        out: &Path,
        on_step: OnStep<'_>,
    ) -> Result<String, RunError> {
        let finished = FinishedRun::open(&self.run, self.dataset.as_deref())?;
        let (keyframes, points) = (keyframes(result), surface_points(map));
        let set = TrainingSet {
            dataset: finished.dataset(),
            trajectory: &result.trajectory,
            keyframes: &keyframes,
            points: &points,
        };
        let mut on_image = counted(keyframes.len(), on_step);
        match self.to {
            ExportFormat::Colmap => set.write_colmap(out, &mut on_image),
            _ => set.write_nerfstudio(out, &mut on_image),
        }?;
        Ok(format!(
            "{} images, {} points",
            keyframes.len(),
            points.len()
        ))
    }
}

/// Counts steps.
fn counted(total: usize, on_step: OnStep<'_>) -> impl FnMut() -> ControlFlow<()> {
    let mut done = 0;
    move || {
        done += 1;
        on_step(done, total)
    }
}

/// Turns maps and poses so that floors are level.
fn turn_level(result: &mut RunResult, up: Vector3<f64>) -> Result<(), RunError> {
    let level = Level::new(up);
    result.gaussians = level.map(&result.gaussians);
    result.refined = result.refined.as_ref().map(|map| level.map(map));
    let poses = result.trajectory.poses().iter();
    let poses = poses.map(|pose| (pose.timestamp_secs, level.pose(&pose.world_from_camera)));
    result.trajectory = Trajectory::new(poses)?;
    Ok(())
}

/// Makes the folder around the place that the user named. A file there is replaced, but not one of the
/// run's own.
fn prepare(out: &Path, folder: &RunFolder) -> Result<(), RunError> {
    if folder.holds_result(out) {
        return Err(RunError::BelongsToRun { path: out.into() });
    }
    if let Some(parent) = out.parent() {
        fs::create_dir_all(parent).map_err(|source| RunError::OutputFolder {
            path: parent.into(),
            source,
        })?;
    }
    Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_has_its_name() {
        for format in ExportFormat::ALL {
            assert_eq!(format.to_string().parse(), Ok(format));
        }
        assert!("png".parse::<ExportFormat>().is_err());
    }
}
