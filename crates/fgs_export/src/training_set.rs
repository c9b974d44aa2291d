//! What other programs that reconstruct from photographs start from: folders with the keyframes'
//! images, cameras and poses, and points to begin with.

use std::io;
use std::ops::ControlFlow;
use std::path::Path;

use fgs_data::{Dataset, Trajectory};
use fgs_files::NewFolder;
use fgs_geom::Camera;

use crate::keyframe_images::{KeyframeFiles, write_in, write_keyframe_images};
use crate::{ExportError, Keyframe, Point, colmap, nerfstudio};

/// What such a folder is made of.
#[derive(Clone, Copy)]
pub struct TrainingSet<'a> {
    /// The recording with the keyframes' images.
    pub dataset: &'a Dataset,
    /// The poses of all tracked frames; how the camera moved while a rolling shutter read an image.
    pub trajectory: &'a Trajectory,
    /// The keyframes.
    pub keyframes: &'a [Keyframe],
    /// Points on the surfaces.
    pub points: &'a [Point],
}

impl TrainingSet<'_> {
    /// Writes a COLMAP model: `images/` and `sparse/0/{cameras,images,points3D}.txt`. One camera,
    /// PINHOLE; poses are `camera_from_world`; camera and world have the run's axes, y down, metres.
    /// Points have no tracks. `on_image` is called after each image
    /// and may stop the export.
    ///
    /// # Errors
    /// If there is something at `path`, an image cannot be read, writing fails, or it was stopped.
    pub fn write_colmap(
        &self,
        path: &Path,
        on_image: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<(), ExportError> {
        self.write(path, on_image, |folder, files, camera| {
            write_in(folder, "sparse/0/cameras.txt", |file| {
                colmap::write_cameras(file, camera)
            })?;
            write_in(folder, "sparse/0/images.txt", |file| {
                colmap::write_images(file, files)
            })?;
            write_in(folder, "sparse/0/points3D.txt", |file| {
                colmap::write_points(file, self.points)
            })
        })
    }

    /// Writes a data set for nerfstudio: `images/`, `points.ply` and `transforms.json`. Poses are
    /// `world_from_camera` with the camera's axes as nerfstudio wants them, x right, y up, z backward;
    /// the world keeps the run's axes, y down, metres. `on_image` is called after each image
    /// and may stop the export.
    ///
    /// # Errors
    /// If there is something at `path`, an image cannot be read, writing fails, or it was stopped.
    pub fn write_nerfstudio(
        &self,
        path: &Path,
        on_image: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<(), ExportError> {
        self.write(path, on_image, |folder, files, camera| {
            write_in(folder, nerfstudio::POINTS, |mut file| {
                crate::write_points(&mut file, self.points)
            })?;
            write_in(folder, "transforms.json", |file| {
                nerfstudio::write_transforms(file, camera, files)
            })
        })
    }

    /// Writes the images and what `describe` adds; all of it appears at `path`, or nothing.
    fn write(
        &self,
        path: &Path,
        on_image: &mut dyn FnMut() -> ControlFlow<()>,
        describe: impl FnOnce(&Path, &[KeyframeFiles], &Camera) -> Result<(), ExportError>,
    ) -> Result<(), ExportError> {
        if self.keyframes.is_empty() {
            return Err(ExportError::NoKeyframes);
        }
        let refusal = |source: io::Error| match source.kind() {
            io::ErrorKind::AlreadyExists => ExportError::Exists { path: path.into() },
            _ => ExportError::Write {
                path: path.into(),
                source,
            },
        };
        let folder = NewFolder::begin(path).map_err(refusal)?;
        let files = write_keyframe_images(
            folder.path(),
            self.keyframes,
            self.dataset,
            self.trajectory,
            on_image,
        )?;
        describe(folder.path(), &files, self.dataset.camera())?;
        folder.finish().map_err(refusal)
    }
}
