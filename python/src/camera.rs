//! The pinhole camera.

use fgs_geom::Intrinsics;
use pyo3::prelude::*;

use crate::errors::SettingError;

/// A pinhole camera without lens distortion: u = fx x/z + cx, v = fy y/z + cy.
///
/// Pixel centres lie at integer coordinates. Camera axes: x right, y down, z forward.
///
/// Args:
///     width, height: size of the images, pixels.
///     fx, fy: focal lengths, pixels.
///     cx, cy: principal point, pixels.
///
/// Raises:
///     SettingError: a value is not plausible.
#[pyclass(frozen, eq, from_py_object, module = "fgs_slam")]
#[derive(Clone, Copy, PartialEq)]
pub struct Camera(pub fgs_geom::Camera);

#[pymethods]
impl Camera {
    #[new]
    fn new(width: usize, height: usize, fx: f64, fy: f64, cx: f64, cy: f64) -> PyResult<Self> {
        fgs_geom::Camera::new(width, height, Intrinsics { fx, fy, cx, cy })
            .map(Self)
            .map_err(|error| SettingError::new_err(error.to_string()))
    }

    /// Columns, pixels.
    #[getter]
    fn width(&self) -> usize {
        self.0.width
    }

    /// Rows, pixels.
    #[getter]
    fn height(&self) -> usize {
        self.0.height
    }

    /// Horizontal focal length, pixels.
    #[getter]
    fn fx(&self) -> f64 {
        self.0.intrinsics.fx
    }

    /// Vertical focal length, pixels.
    #[getter]
    fn fy(&self) -> f64 {
        self.0.intrinsics.fy
    }

    /// Column of the principal point, pixels.
    #[getter]
    fn cx(&self) -> f64 {
        self.0.intrinsics.cx
    }

    /// Row of the principal point, pixels.
    #[getter]
    fn cy(&self) -> f64 {
        self.0.intrinsics.cy
    }

    /// A camera of the same horizontal field of view with images of another size.
    ///
    /// Raises:
    ///     SettingError: the size is not possible.
    fn resized(&self, width: usize, height: usize) -> PyResult<Self> {
        let resized = self.0.resized(width, height);
        resized
            .map(Self)
            .map_err(|error| SettingError::new_err(error.to_string()))
    }

    fn __repr__(&self) -> String {
        let fgs_geom::Camera {
            width,
            height,
            intrinsics: Intrinsics { fx, fy, cx, cy },
        } = self.0;
        format!("Camera(width={width}, height={height}, fx={fx}, fy={fy}, cx={cx}, cy={cy})")
    }
}
