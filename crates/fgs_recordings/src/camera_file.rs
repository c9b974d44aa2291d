//! The camera file of a recording that has no lens distortion.

use std::path::Path;

use fgs_data::{CameraFile, DataError};
use fgs_geom::Camera;

/// Values a metre, should depth be written down as whole numbers: TUM's, which keep millimetres exactly,
/// and five steps between, up to 13 m. Phones see 5 m.
const DEPTH_SCALE: f64 = 5000.0;

/// `path` is where the camera comes from.
///
/// # Errors
/// If it is out of range.
pub(crate) fn pinhole(camera: Camera, path: &Path) -> Result<CameraFile, DataError> {
    CameraFile::new(camera, None, DEPTH_SCALE).map_err(|source| DataError::Camera {
        path: path.into(),
        source,
    })
}
