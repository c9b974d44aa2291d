//! Covariances of a point cloud from the nearest neighbours of each point, as in the paper's
//! tracker and small_gicp. Serves as reference for the covariances taken directly from a depth
//! image.

use nalgebra::{Matrix3, Vector3};

use crate::{Covariance, PointMap};

/// For each of `positions`, the regularised covariance of its `count` nearest neighbours in `map`
/// (including the point itself), searched up to `max_distance_m`. `None` where they do not span a
/// plane.
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
            // Relative to the point itself, which avoids cancellation.
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
