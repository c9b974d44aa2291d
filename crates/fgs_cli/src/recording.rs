//! Opens a recording with the camera that counts: `--camera`, then the one beside the recording,
//! then `[camera]` in the configuration (before the recording's own if `run.camera_overrides`).

use std::path::Path;

use fgs_data::{CameraFile, DataError, Dataset, OpenOptions};

use crate::failure::UsageError;
use crate::settings::Settings;

/// Opens the recording and puts the camera that counts into the settings.
///
/// # Errors
/// If the recording or the camera file is refused.
pub fn open(
    folder: &Path,
    camera_file: Option<&Path>,
    settings: &mut Settings,
) -> anyhow::Result<Dataset> {
    if let Some(path) = camera_file {
        settings.camera =
            Some(CameraFile::read(path).map_err(|error| UsageError(error.to_string()))?);
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

/// Refuses a camera that does not fit the recording's images, before every frame is found damaged.
///
/// # Errors
/// A [`UsageError`] if the frame's images have another size than the camera.
pub fn check_size(dataset: &Dataset, index: usize) -> Result<(), UsageError> {
    match dataset.frame(index) {
        Err(error @ DataError::ImageSize { .. }) => Err(UsageError(error.to_string())),
        // A damaged first frame is none of the camera's fault.
        _ => Ok(()),
    }
}

/// The folder's own name, also for paths such as `.`.
pub fn name(folder: &Path) -> String {
    let path = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = path
        .file_name()
        .map(|name| name.to_string_lossy().into_owned());
    name.unwrap_or_else(|| "run".into())
}
