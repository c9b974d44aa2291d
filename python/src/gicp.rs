//! Registration of point clouds.

use fgs_geom::Se3;
use fgs_gicp::{Alignment, PointMap, Settings, align as gicp_align, points_from_neighbors};
use nalgebra::Vector3;
use numpy::PyArray2;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::{AlignmentError, SettingError};
use crate::pose::pose_of;

/// Registers two point clouds by generalised ICP (Segal et al. 2009).
///
/// Each point is a disk fitted to its nearest neighbours; points whose neighbours do not span a plane are left out.
/// Thin dense clouds first: where points are nearer to each other than they are sure, disks are fitted to noise.
///
/// Args:
///     source, target: points, metres, float32 or float64 (N, 3) and (M, 3).
///     initial: where to start, ``target_from_source``, float64 (4, 4); the identity if left out.
///     max_distance_m: how far apart corresponding points may be.
///     neighbors: to how many points each disk is fitted, itself included, at least 3.
///     neighbor_distance_m: how far those may be; ``max_distance_m`` if left out.
///
/// Raises:
///     ShapeError: an array has another shape or type, or `initial` is no pose.
///     SettingError: a distance or number is not possible.
///     AlignmentError: too few points correspond, or they do not determine the motion.
#[pyfunction]
#[pyo3(signature = (source, target, *, initial = None, max_distance_m = 0.1, neighbors = 20, neighbor_distance_m = None))]
pub fn align(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    target: &Bound<'_, PyAny>,
    initial: Option<&Bound<'_, PyAny>>,
    max_distance_m: f32,
    neighbors: usize,
    neighbor_distance_m: Option<f32>,
) -> PyResult<PyAlignment> {
    let (source, target) = (
        arrays::float_rows(source, "source")?,
        arrays::float_rows(target, "target")?,
    );
    let initial = initial
        .map(pose_of)
        .transpose()?
        .unwrap_or_else(Se3::identity);
    let neighbor_distance_m = neighbor_distance_m.unwrap_or(max_distance_m);
    for (name, value) in [
        ("max_distance_m", max_distance_m),
        ("neighbor_distance_m", neighbor_distance_m),
    ] {
        if !(value.is_finite() && value > 0.0) {
            return Err(SettingError::new_err(format!(
                "{name} = {value}: a positive length is expected"
            )));
        }
    }
    if !(3..=1000).contains(&neighbors) {
        return Err(SettingError::new_err(format!(
            "neighbors = {neighbors}: 3 to 1000 are expected"
        )));
    }
    let settings = Settings {
        max_correspondence_distance_m: max_distance_m,
        ..Settings::default()
    };
    let alignment = py.detach(|| {
        let disks = |points: Vec<[f32; 3]>| {
            let positions: Vec<Vector3<f32>> = points.into_iter().map(Vector3::from).collect();
            points_from_neighbors(&positions, neighbors, neighbor_distance_m)
        };
        let mut map = PointMap::new(3.0 * max_distance_m);
        for (point, id) in disks(target).into_iter().zip(0..) {
            map.insert(id, point);
        }
        gicp_align(&disks(source), &map, &initial, &settings)
    });
    let alignment = alignment.map_err(|error| AlignmentError::new_err(error.to_string()))?;
    Ok(PyAlignment(alignment))
}

/// The result of a registration.
#[pyclass(frozen, name = "Alignment", module = "fgs_slam.gicp")]
pub struct PyAlignment(Alignment);

#[pymethods]
impl PyAlignment {
    /// Maps source points to the target's axes, metres, float64 (4, 4).
    #[getter]
    fn target_from_source<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::matrix(py, &self.0.target_from_source)
    }

    /// Whether the last step was small enough.
    #[getter]
    fn converged(&self) -> bool {
        self.0.converged
    }

    /// Steps over all points.
    #[getter]
    fn iterations(&self) -> usize {
        self.0.iterations
    }

    /// Source points that correspond to a target point.
    #[getter]
    fn inliers(&self) -> usize {
        self.0.inliers
    }

    /// Root mean square distance, mostly along the normals, metres.
    #[getter]
    fn rms_residual_m(&self) -> f64 {
        self.0.rms_residual_m
    }

    /// How well the weakest direction of motion is constrained relative to the strongest, 0 to 1.
    #[getter]
    fn conditioning(&self) -> f64 {
        self.0.conditioning.weakest
    }

    /// Information of the pose for an edge of a pose graph, float64 (6, 6): perturbations from the right, tangent
    /// ``[omega, v]`` in rad and metres.
    ///
    /// Args:
    ///     sensor_noise_m: standard deviation of the distance along the normal within a correspondence.
    fn information<'py>(
        &self,
        py: Python<'py>,
        sensor_noise_m: f64,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::square(py, &self.0.information(sensor_noise_m))
    }

    fn __repr__(&self) -> String {
        let Alignment {
            converged,
            inliers,
            rms_residual_m,
            ..
        } = self.0;
        format!(
            "<alignment: converged={converged}, inliers={inliers}, rms_residual_m={rms_residual_m:.2e}>"
        )
    }
}
