//! What became of a frame.

use fgs_geom::Se3;
use fgs_slam::FrameResult;
use numpy::PyArray2;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::ShapeError;

/// What became of a frame.
#[pyclass(frozen, module = "fgs_slam")]
pub struct Pose(pub FrameResult);

#[pymethods]
impl Pose {
    /// Which frame of the session, from 0.
    #[getter]
    fn index(&self) -> usize {
        self.0.index.0
    }

    /// The frame's time, seconds.
    #[getter]
    fn timestamp(&self) -> Option<f64> {
        self.0.timestamp_secs
    }

    /// ``"tracked"``, ``"weak"`` (a pose that is probably right, on which nothing is built) or ``"lost"``.
    #[getter]
    fn verdict(&self) -> String {
        self.0.status.to_string()
    }

    /// ``world_from_camera``, which maps points of the camera's axes into the world, metres, float64 (4, 4); None
    /// if the frame is lost. The world is the first camera: x right, y down, z forward.
    #[getter]
    fn world_from_camera<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let pose = self.0.world_from_camera.as_ref();
        pose.map(|pose| arrays::matrix(py, pose)).transpose()
    }

    /// Standard deviation of the position along its worst direction, by depth and colour alone, metres; None if the
    /// frame is lost or nothing was registered, as in the first.
    #[getter]
    fn uncertainty_m(&self) -> Option<f64> {
        self.0.world_from_camera?;
        let quality = self.0.tracking.as_ref()?;
        (quality.inliers > 0).then_some(quality.uncertainty_m)
    }

    /// The part of the session that the pose is in, from 0; None if the frame is lost. A camera that is lost for long
    /// where nothing is known starts another, with axes of its own.
    #[getter]
    fn submap(&self) -> Option<usize> {
        self.0.submap
    }

    /// Whether the frame became a keyframe.
    #[getter]
    fn is_keyframe(&self) -> bool {
        self.0.keyframe.is_some()
    }

    fn __repr__(&self) -> String {
        let position = self.0.world_from_camera.map_or(String::new(), |pose| {
            let [x, y, z]: [f64; 3] = pose.translation.into();
            format!(" at ({x:.3}, {y:.3}, {z:.3}) m")
        });
        format!("<frame {}: {}{position}>", self.0.index.0, self.0.status)
    }
}

/// A pose `world_from_camera` given as a matrix or as a [`Pose`] that is not lost.
pub fn pose_of(value: &Bound<'_, PyAny>) -> PyResult<Se3> {
    match value.cast::<Pose>() {
        Ok(pose) => {
            let pose = pose.get().0.world_from_camera;
            pose.ok_or_else(|| ShapeError::new_err("pose: the frame is lost"))
        }
        Err(_) => arrays::pose(value, "pose"),
    }
}
