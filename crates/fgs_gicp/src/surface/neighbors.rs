//! Covariances of a point cloud from each point's nearest neighbours, as the paper's tracker and
//! small_gicp compute them: the reference for the covariances that a depth image gives directly.

use nalgebra::{Matrix3, Vector3};

use crate::{Covariance, PointMap};

/// The regularised covariance of the `count` nearest neighbours (itself among them) of each point
/// of `map` at `positions`, searched up to `max_distance_m`. `None` where they span no plane.
pub fn covariances_from_neighbors(
    map: &PointMap,
    positions: &[Vector3<f32>],
    count: usize,
    max_distance_m: f32,
) -> Vec<Option<Covariance>> {
    positions
        .iter()
        .map(|position| {
            let neighbors = map.k_nearest(position, count, max_distance_m);
            let n = neighbors.len() as f64;
            // Relative to the point itself, which keeps the digits.
            let offsets = neighbors
                .iter()
                .map(|neighbor| (neighbor.point.position - position).cast::<f64>());
            let mean = offsets.clone().sum::<Vector3<f64>>() / n;
            let scatter: Matrix3<f64> = offsets
                .map(|offset| (offset - mean) * (offset - mean).transpose())
                .sum();
            Covariance::regularized(&scatter)
        })
        .collect()
}

#[cfg(test)]
#[path = "neighbors_tests.rs"]
mod tests;
