//! The camera file of a recording, as far as it follows from the images that a run sees.

use std::path::Path;

use fgs_data::{CameraFile, DataError};
use fgs_geom::Camera;

/// Values a metre, should depth be written down as whole numbers: TUM's, which keep millimetres exactly,
/// and five steps between, up to 13 m. Phones see 5 m.
const DEPTH_SCALE: f64 = 5000.0;

/// Of a camera with a lens distortion, if any, and so many depth units a metre. `path` is where it comes from.
///
/// # Errors
/// If it is out of range.
pub(crate) fn camera_file(
    camera: Camera,
    distortion: Option<[f64; 5]>,
    units_per_m: f64,
    path: &Path,
) -> Result<CameraFile, DataError> {
    CameraFile::new(camera, distortion, units_per_m).map_err(|source| DataError::Camera {
        path: path.into(),
        source,
    })
}

/// Of a camera without lens distortion.
///
/// # Errors
/// If it is out of range.
pub(crate) fn pinhole(camera: Camera, path: &Path) -> Result<CameraFile, DataError> {
    camera_file(camera, None, DEPTH_SCALE, path)
}
