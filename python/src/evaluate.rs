//! Errors of trajectories.

use fgs_eval::associate;
use fgs_geom::Se3;
use numpy::PyArray2;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::EvaluationError;
use crate::trajectory::Trajectory;

/// Absolute trajectory error after rigid alignment of the positions, without scale; the same as evo's.
///
/// Args:
///     estimated, reference: two :class:`Trajectory`, whose poses are paired by their times, or two arrays of poses
///         ``world_from_camera``, metres, float64 (N, 4, 4), which are paired by their order.
///     max_difference_secs: how far apart the times of a pair may be, seconds.
///
/// Raises:
///     ShapeError: an array has another shape, or a matrix is no pose.
///     EvaluationError: there are fewer than 3 pairs, or the numbers of poses differ.
#[pyfunction]
#[pyo3(signature = (estimated, reference, *, max_difference_secs = 0.02))]
pub fn ate(
    estimated: &Bound<'_, PyAny>,
    reference: &Bound<'_, PyAny>,
    max_difference_secs: f64,
) -> PyResult<Ate> {
    let trajectories = (
        estimated.cast::<Trajectory>(),
        reference.cast::<Trajectory>(),
    );
    let (estimated, reference): (Vec<Se3>, Vec<Se3>) = match trajectories {
        (Ok(estimated), Ok(reference)) => {
            let (estimated, reference) = (estimated.get().0.poses(), reference.get().0.poses());
            let times = |poses: &[fgs_data::StampedPose]| -> Vec<f64> {
                poses.iter().map(|pose| pose.timestamp_secs).collect()
            };
            let pairs = associate(&times(estimated), &times(reference), max_difference_secs);
            let pairs = pairs.into_iter();
            pairs
                .map(|(i, j)| {
                    (
                        estimated[i].world_from_camera,
                        reference[j].world_from_camera,
                    )
                })
                .unzip()
        }
        _ => (
            arrays::poses(estimated, "estimated")?,
            arrays::poses(reference, "reference")?,
        ),
    };
    let ate = fgs_eval::ate(&estimated, &reference);
    Ok(Ate {
        pairs: estimated.len(),
        ate: ate.map_err(|error| EvaluationError::new_err(error.to_string()))?,
    })
}

/// Absolute trajectory error.
#[pyclass(frozen, module = "fgs_slam.evaluate")]
pub struct Ate {
    ate: fgs_eval::Ate,
    pairs: usize,
}

#[pymethods]
impl Ate {
    /// Root mean square of the distances between positions, metres.
    #[getter]
    fn rmse_m(&self) -> f64 {
        self.ate.translation_m.rmse
    }

    /// Their mean, metres.
    #[getter]
    fn mean_m(&self) -> f64 {
        self.ate.translation_m.mean
    }

    /// Their median, metres.
    #[getter]
    fn median_m(&self) -> f64 {
        self.ate.translation_m.median
    }

    /// The largest, metres.
    #[getter]
    fn max_m(&self) -> f64 {
        self.ate.translation_m.max
    }

    /// Their standard deviation, metres.
    #[getter]
    fn std_m(&self) -> f64 {
        self.ate.translation_m.std
    }

    /// How many poses were compared.
    #[getter]
    fn pairs(&self) -> usize {
        self.pairs
    }

    /// The rigid alignment, metres, float64 (4, 4).
    #[getter]
    fn reference_from_estimated<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::matrix(py, &self.ate.reference_from_estimated)
    }

    fn __repr__(&self) -> String {
        format!(
            "<ATE: rmse {:.3e} m over {} poses>",
            self.rmse_m(),
            self.pairs
        )
    }
}
