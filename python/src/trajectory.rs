//! Poses at times.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray3};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::IntoPython;

/// Poses at strictly increasing times. Lost frames have none.
#[pyclass(frozen, module = "fgs_slam")]
pub struct Trajectory(pub fgs_data::Trajectory);

#[pymethods]
impl Trajectory {
    /// Args:
    ///     timestamps: seconds, float64 (N,), strictly increasing.
    ///     poses: ``world_from_camera``, metres, float64 (N, 4, 4).
    ///
    /// Raises:
    ///     ShapeError: the arrays have other shapes or lengths, or a matrix is no pose.
    ///     DatasetError: the times do not increase.
    #[new]
    fn new(timestamps: &Bound<'_, PyAny>, poses: &Bound<'_, PyAny>) -> PyResult<Self> {
        let (times, poses) = (arrays::times(timestamps)?, arrays::poses(poses, "poses")?);
        if times.len() != poses.len() {
            return Err(arrays::unequal(
                "timestamps",
                times.len(),
                "poses",
                poses.len(),
            ));
        }
        let trajectory = fgs_data::Trajectory::new(times.into_iter().zip(poses));
        trajectory.map(Self).map_err(IntoPython::into_python)
    }

    /// Reads a file in TUM's format: ``timestamp tx ty tz qx qy qz qw``.
    ///
    /// Raises:
    ///     DatasetError: it cannot be read or is damaged.
    #[staticmethod]
    fn read(path: PathBuf) -> PyResult<Self> {
        let trajectory = fgs_data::Trajectory::read(&path);
        trajectory.map(Self).map_err(IntoPython::into_python)
    }

    /// Writes a file in TUM's format with all digits.
    ///
    /// Raises:
    ///     DatasetError: it cannot be written.
    fn write(&self, path: PathBuf) -> PyResult<()> {
        self.0.write(&path).map_err(IntoPython::into_python)
    }

    /// Seconds, float64 (N,).
    #[getter]
    fn timestamps<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let poses = self.0.poses().iter();
        PyArray1::from_iter(py, poses.map(|pose| pose.timestamp_secs))
    }

    /// ``world_from_camera``, metres, float64 (N, 4, 4).
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let poses = self.0.poses().iter();
        arrays::matrices(py, poses.map(|pose| pose.world_from_camera))
    }

    fn __len__(&self) -> usize {
        self.0.poses().len()
    }

    fn __repr__(&self) -> String {
        format!("<trajectory of {} poses>", self.0.poses().len())
    }
}
