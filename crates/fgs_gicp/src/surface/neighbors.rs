//! Covariances of a point cloud from the nearest neighbours of each point, as in the paper's
//! tracker and small_gicp. Serves as reference for the covariances taken directly from a depth
//! image.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::{Covariance, Neighbor, Point, PointMap};

/// So many points tell how dense a cloud is.
const SAMPLE_POINTS: usize = 100;

/// The points of a cloud of any density as disks fitted to their `count` nearest neighbours (including
/// themselves), searched up to `max_distance_m`. Points whose neighbours do not span a plane are left
/// out.
pub fn points_from_neighbors(
    positions: &[Vector3<f32>],
    count: usize,
    max_distance_m: f32,
) -> Vec<Point> {
    let radius_m = usual_radius_m(positions, count);
    let radius_m = radius_m.max(1e-3 * max_distance_m).min(max_distance_m);
    let map = map_of(positions, radius_m);
    let point = |&position: &Vector3<f32>| {
        // Where the cloud is dense, most of what is within the limit is not among the nearest.
        let mut reach_m = 1.5 * radius_m;
        let mut neighbors = map.k_nearest(&position, count, reach_m.min(max_distance_m));
        while neighbors.len() < count && reach_m < max_distance_m {
            reach_m *= 2.0;
            neighbors = map.k_nearest(&position, count, reach_m.min(max_distance_m));
        }
        let covariance = covariance_of(&position, &neighbors)?;
        Some(Point {
            position,
            covariance,
        })
    };
    positions.par_iter().filter_map(point).collect()
}

/// The points of a cloud, to search among.
fn map_of(positions: &[Vector3<f32>], radius_m: f32) -> PointMap {
    let mut map = PointMap::new(radius_m);
    for (&position, id) in positions.iter().zip(0..) {
        let covariance = Covariance::isotropic();
        map.insert(
            id,
            Point {
                position,
                covariance,
            },
        );
    }
    map
}

/// The median distance, over a sample of the points, to the last of the `count` nearest.
fn usual_radius_m(positions: &[Vector3<f32>], count: usize) -> f32 {
    let step = positions.len().div_ceil(SAMPLE_POINTS).max(1);
    let sample: Vec<&Vector3<f32>> = positions.iter().step_by(step).collect();
    let squared_radius = |point: &&Vector3<f32>| {
        let squared = positions
            .iter()
            .map(|other| (other - *point).norm_squared());
        let mut squared: Vec<f32> = squared.collect();
        let last = count.clamp(1, squared.len()) - 1;
        *squared.select_nth_unstable_by(last, f32::total_cmp).1
    };
    let mut radii: Vec<f32> = sample.par_iter().map(squared_radius).collect();
    radii.sort_by(f32::total_cmp);
    let median = radii.get(radii.len() / 2).copied().unwrap_or(0.0);
    if median.is_finite() {
        median.sqrt()
    } else {
        0.0
    }
}

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
        .map(|position| covariance_of(position, &map.k_nearest(position, count, max_distance_m)))
        .collect()
}

/// The regularised covariance of a point's neighbours, if they span a plane.
fn covariance_of(position: &Vector3<f32>, neighbors: &[Neighbor<'_>]) -> Option<Covariance> {
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
}

#[cfg(test)]
#[path = "neighbors_tests.rs"]
mod tests;
