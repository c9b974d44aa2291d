//! A map as NumPy arrays, and renders of it.

use std::path::PathBuf;

use fgs_geom::View;
use fgs_splat::{Rasterizer, Rendered};
use numpy::{PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays;
use crate::camera::Camera;
use crate::errors::{IntoPython, ShapeError};
use crate::pose::pose_of;

/// A map of N gaussians as NumPy arrays, which hold the memory that the map was computed in: nothing is copied.
/// The arrays may be changed; :meth:`render` and :meth:`write` take them as they are then.
///
/// Args:
///     means: centres in the world, metres, float32 (N, 3).
///     quats: rotations ``world_from_gaussian``, wxyz, float32 (N, 4).
///     log_scales: logarithms of the standard deviations along the gaussian's axes, metres, float32 (N, 3).
///     opacity_logits: float32 (N,); ``opacity = 1 / (1 + exp(-logit))``.
///     sh: colours as spherical harmonics of degree 0, float32 (N, 3); ``rgb = 0.5 + 0.28209479 sh``.
///     inferred: whether the depth at which the gaussian was made is a guess, bool (N,); none if left out.
///
/// Raises:
///     ShapeError: an array has another shape or type.
#[pyclass(frozen, module = "fgs_slam")]
pub struct Gaussians {
    /// Centres in the world, metres, float32 (N, 3).
    #[pyo3(get)]
    means: Py<PyArray2<f32>>,
    /// Rotations ``world_from_gaussian``, wxyz, float32 (N, 4).
    #[pyo3(get)]
    quats: Py<PyArray2<f32>>,
    /// Logarithms of the standard deviations along the gaussian's axes, metres, float32 (N, 3).
    #[pyo3(get)]
    log_scales: Py<PyArray2<f32>>,
    /// Logits of the opacities, float32 (N,).
    #[pyo3(get)]
    opacity_logits: Py<PyArray1<f32>>,
    /// Colours as spherical harmonics of degree 0, float32 (N, 3).
    #[pyo3(get)]
    sh: Py<PyArray2<f32>>,
    /// Whether the depth at which the gaussian was made is a guess, bool (N,).
    #[pyo3(get)]
    inferred: Py<PyArray1<bool>>,
}

impl Gaussians {
    /// Hands the map's memory to NumPy.
    pub fn from_rust(py: Python<'_>, map: fgs_splat::Gaussians) -> PyResult<Self> {
        Ok(Self {
            means: arrays::from_rows(py, map.means)?.unbind(),
            quats: arrays::from_rows(py, map.quats)?.unbind(),
            log_scales: arrays::from_rows(py, map.log_scales)?.unbind(),
            opacity_logits: PyArray1::from_vec(py, map.opacity_logits).unbind(),
            sh: arrays::from_rows(py, map.sh)?.unbind(),
            inferred: PyArray1::from_vec(py, map.inferred).unbind(),
        })
    }

    /// A copy, which Python cannot change while it is used.
    pub fn to_rust(&self, py: Python<'_>) -> PyResult<fgs_splat::Gaussians> {
        let map = fgs_splat::Gaussians {
            means: arrays::float_rows(self.means.bind(py), "means")?,
            quats: arrays::float_rows(self.quats.bind(py), "quats")?,
            log_scales: arrays::float_rows(self.log_scales.bind(py), "log_scales")?,
            opacity_logits: arrays::floats(self.opacity_logits.bind(py), "opacity_logits")?,
            sh: arrays::float_rows(self.sh.bind(py), "sh")?,
            inferred: arrays::flags(self.inferred.bind(py), "inferred")?,
        };
        if !map.has_len(map.len()) {
            return Err(ShapeError::new_err(
                "the arrays of gaussians differ in length",
            ));
        }
        Ok(map)
    }
}

#[pymethods]
impl Gaussians {
    #[new]
    #[pyo3(signature = (means, quats, log_scales, opacity_logits, sh, inferred = None))]
    fn new(
        py: Python<'_>,
        means: &Bound<'_, PyAny>,
        quats: &Bound<'_, PyAny>,
        log_scales: &Bound<'_, PyAny>,
        opacity_logits: &Bound<'_, PyAny>,
        sh: &Bound<'_, PyAny>,
        inferred: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let means: Vec<[f32; 3]> = arrays::float_rows(means, "means")?;
        let inferred = match inferred {
            Some(inferred) => arrays::flags(inferred, "inferred")?,
            None => vec![false; means.len()],
        };
        let map = fgs_splat::Gaussians {
            quats: arrays::float_rows(quats, "quats")?,
            log_scales: arrays::float_rows(log_scales, "log_scales")?,
            opacity_logits: arrays::floats(opacity_logits, "opacity_logits")?,
            sh: arrays::float_rows(sh, "sh")?,
            inferred,
            means,
        };
        if !map.has_len(map.len()) {
            return Err(ShapeError::new_err(
                "the arrays of gaussians differ in length",
            ));
        }
        Self::from_rust(py, map)
    }

    /// Reads a PLY file of 3-D gaussian splatting, such as a run's ``map.ply``.
    ///
    /// Raises:
    ///     FileError: it cannot be read or is damaged.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let map = py.detach(|| fgs_splat::read_ply(&path));
        Self::from_rust(py, map.map_err(IntoPython::into_python)?)
    }

    /// Writes a PLY file of 3-D gaussian splatting; :meth:`read` returns the same numbers.
    ///
    /// Raises:
    ///     FileError: it cannot be written, or a value is not finite.
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let map = self.to_rust(py)?;
        let written = py.detach(|| fgs_splat::write_ply(&path, &map));
        written.map_err(IntoPython::into_python)
    }

    /// All arrays by name, as for ``numpy.savez(file, **gaussians.arrays())``.
    pub fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let arrays = PyDict::new(py);
        arrays.set_item("means", &self.means)?;
        arrays.set_item("quats", &self.quats)?;
        arrays.set_item("log_scales", &self.log_scales)?;
        arrays.set_item("opacity_logits", &self.opacity_logits)?;
        arrays.set_item("sh", &self.sh)?;
        arrays.set_item("inferred", &self.inferred)?;
        Ok(arrays)
    }

    /// What a camera sees of the map.
    ///
    /// Args:
    ///     pose: ``world_from_camera``, a :class:`Pose` or a matrix of shape (4, 4).
    ///     camera: of any size up to 7680x4320.
    ///
    /// Raises:
    ///     ShapeError: `pose` is none, or an array of the map has been changed to another length.
    ///     SettingError: the camera's images are too large.
    fn render(&self, py: Python<'_>, pose: &Bound<'_, PyAny>, camera: &Camera) -> PyResult<Render> {
        let view = View {
            camera: camera.0,
            world_from_camera: pose_of(pose)?,
        };
        let map = self.to_rust(py)?;
        Render::of(py, &map, &view)
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.opacity_logits.bind(py).len().unwrap_or(0)
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("<{} gaussians>", self.__len__(py))
    }
}

/// A render of the map.
#[pyclass(frozen, get_all, module = "fgs_slam")]
pub struct Render {
    /// Colour over black, sRGB, uint8 (H, W, 3).
    color: Py<PyArray3<u8>>,
    /// Depth of the surface along z, metres, float32 (H, W); 0 where nothing is rendered.
    depth_m: Py<PyArray2<f32>>,
    /// How opaque the map is, 0 to 1, float32 (H, W).
    alpha: Py<PyArray2<f32>>,
}

impl Render {
    /// Renders with Python released.
    pub fn of(py: Python<'_>, map: &fgs_splat::Gaussians, view: &View) -> PyResult<Self> {
        arrays::check_size(&view.camera)?;
        let (color, depth_m, alpha) = py.detach(|| {
            let mut rasterizer = Rasterizer::default();
            let pass = rasterizer.render(map, view);
            let rendered: &Rendered = pass.rendered();
            let depth_m =
                fgs_geom::Image::from_fn(view.camera.width, view.camera.height, |u, v| {
                    let depth_m = rendered.surface_depth_m(u, v);
                    if depth_m.is_finite() { depth_m } else { 0.0 }
                });
            (rendered.color_bytes(), depth_m, rendered.alpha.clone())
        });
        Ok(Self {
            color: arrays::from_color(py, color)?.unbind(),
            depth_m: arrays::from_image(py, depth_m)?.unbind(),
            alpha: arrays::from_image(py, alpha)?.unbind(),
        })
    }
}
