//! Opens a recording with the camera that applies: a camera file given for the run, then the
//! recording's own, then `[camera]` in the settings (before the recording's own if
//! `run.camera_overrides` is set).

use std::path::Path;

use fgs_data::{CameraFile, DataError, Dataset, OpenOptions};

use crate::error::RunError;
use crate::settings::Settings;

/// Opens the recording and puts the camera that applies into the settings.
///
/// # Errors
/// If the recording or the camera file is refused.
pub fn open_recording(
    folder: &Path,
    camera_file: Option<&Path>,
    settings: &mut Settings,
) -> Result<Dataset, RunError> {
    if let Some(path) = camera_file {
        settings.camera = Some(CameraFile::read(path).map_err(RunError::Camera)?);
        settings.run.camera_overrides = Some(true);
    }
    let with = |camera: Option<CameraFile>| {
        Dataset::open(
            folder,
            &OpenOptions {
                camera,
                ..OpenOptions::default()
            },
        )
    };
    let dataset = match &settings.camera {
        Some(camera) if settings.run.camera_overrides == Some(true) => with(Some(camera.clone()))?,
        Some(camera) => match with(None) {
            Err(DataError::NoCamera { .. }) => with(Some(camera.clone()))?,
            opened => opened?,
        },
        None => with(None)?,
    };
    settings.camera = Some(dataset.camera_file().clone());
    Ok(dataset)
}

/// Refuses a camera of another size than the recording's images, before every frame is found
/// damaged.
///
/// # Errors
/// [`RunError::Camera`] if the frame at `index` has another size than the camera.
pub(crate) fn check_size(dataset: &Dataset, index: usize) -> Result<(), RunError> {
    match dataset.frame(index) {
        Err(error @ DataError::ImageSize { .. }) => Err(RunError::Camera(error)),
        // That the frame is damaged does not mean that the camera is wrong.
        _ => Ok(()),
    }
}

/// A name for the recording: that of its folder, also for paths such as `.`.
pub fn recording_name(folder: &Path) -> String {
    let path = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = path
        .file_name()
        .map(|name| name.to_string_lossy().into_owned());
    name.unwrap_or_else(|| "run".into())
}
