//! Opens a recording with the camera that applies: a camera file given for the run, then the
//! recording's own, then `[camera]` in the settings (before the recording's own if
//! `run.camera_overrides` is set).

use std::ffi::OsString;
use std::path::{Component, Path, PathBuf};

use fgs_data::{CameraFile, DataError, Dataset, OpenOptions};
use fgs_recordings::open;

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
    take_camera_file(camera_file, settings)?;
    let with = |camera: Option<CameraFile>| {
        open(
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

/// Puts the camera file given for a run, if there is one, into the settings.
///
/// # Errors
/// [`RunError::Camera`] if it is refused.
pub(crate) fn take_camera_file(
    path: Option<&Path>,
    settings: &mut Settings,
) -> Result<(), RunError> {
    if let Some(path) = path {
        settings.camera = Some(CameraFile::read(path).map_err(RunError::Camera)?);
        settings.run.camera_overrides = Some(true);
    }
    Ok(())
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

/// A name for the recording: that of its folder, also for paths such as `.`, or of its file without the
/// extension.
pub fn recording_name(folder: &Path) -> OsString {
    let path = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = if path.is_file() {
        path.file_stem()
    } else {
        path.file_name()
    };
    name.unwrap_or("run".as_ref()).to_owned()
}

/// The way from a folder, which need not exist, to a path that does: `../../room`. Where there is none,
/// as between drives, the path as it is. What is not UTF-8 cannot be written down and is replaced.
pub(crate) fn path_from(folder: &Path, path: &Path) -> PathBuf {
    let real_folder = folder.canonicalize().ok().or_else(|| {
        let parent = folder.parent()?;
        let parent = if parent == Path::new("") {
            Path::new(".")
        } else {
            parent
        };
        Some(parent.canonicalize().ok()?.join(folder.file_name()?))
    });
    let (Some(from), Ok(to)) = (real_folder, path.canonicalize()) else {
        return in_utf8(path);
    };
    let common = from.components().zip(to.components());
    let common = common.take_while(|(a, b)| a == b).count();
    if common == 0 {
        return in_utf8(path);
    }
    let up = from.components().skip(common).map(|_| Component::ParentDir);
    let way: PathBuf = up.chain(to.components().skip(common)).collect();
    in_utf8(&way)
}

fn in_utf8(path: &Path) -> PathBuf {
    path.to_string_lossy().into_owned().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_from_folder_to_recording() {
        let parent = tempfile::tempdir().unwrap();
        let room = parent.path().join("data/room");
        std::fs::create_dir_all(&room).unwrap();
        let way = |folder: &str| path_from(&parent.path().join(folder), &room);
        assert_eq!(way("data/out"), Path::new("../room"));
        assert_eq!(way("data/room/out"), Path::new(".."));
        std::fs::create_dir_all(parent.path().join("runs/a")).unwrap();
        assert_eq!(way("runs/a"), Path::new("../../data/room"));
        assert_eq!(way("runs/b"), Path::new("../../data/room"));
    }
}
