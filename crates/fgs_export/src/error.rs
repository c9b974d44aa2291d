//! Why an export failed.

use std::io;
use std::ops::ControlFlow;
use std::path::PathBuf;

use fgs_data::DataError;
use thiserror::Error;

/// Why an export failed. Nothing half-written is left behind.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ExportError {
    /// The folder exists already; existing folders are never touched.
    #[error("{} exists already", path.display())]
    Exists {
        /// The folder.
        path: PathBuf,
    },
    /// A file cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// A keyframe's image cannot be read.
    #[error(transparent)]
    Data(#[from] DataError),
    /// No keyframe has a pose, so that there is nothing to see the map from.
    #[error("the run has no keyframes")]
    NoKeyframes,
    /// The caller's `on_view` or `on_image` asked to stop.
    #[error("stopped")]
    Stopped,
    /// The surface takes more memory than is allowed.
    #[error("voxels of {voxel_m} m are too small for a map of this extent")]
    TooManyVoxels {
        /// Side of a voxel, metres.
        voxel_m: f64,
    },
}

/// Ends the work if a callback asks for it.
///
/// # Errors
/// [`ExportError::Stopped`].
pub(crate) fn go_on(asked: ControlFlow<()>) -> Result<(), ExportError> {
    match asked {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(ExportError::Stopped),
    }
}
