//! Selects the points of a keyframe that constrain motion best: those with strong image gradients.

use fgs_geom::{Camera, Image, has_depth};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::residual::gradient_by_point;
use crate::{IntensityImage, IntensityPyramid};

/// Side of a selection cell. At most one point is taken per cell, so that the points are spread
/// over the image.
const CELL_PX: usize = 8;

/// Weaker gradients, in brightness per pixel, are mostly noise.
const MIN_GRADIENT: f32 = 0.01;

/// Next to a depth discontinuity larger than this fraction, a pixel may show either the foreground
/// or the background.
const MAX_DEPTH_STEP: f32 = 0.05;

/// A point with its brightness in the keyframe.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct ReferencePoint {
    /// Position in the reference camera frame, metres.
    pub position: Vector3<f64>,
    /// Brightness, 0 to 1.
    pub intensity: f32,
    /// How brightness changes where the point moves, per metre, in the reference camera frame.
    pub gradient: Vector3<f32>,
}

/// The reference for photometric alignment: points of a keyframe for each pyramid level.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Reference {
    /// The points of each level, finest first.
    pub levels: Vec<Vec<ReferencePoint>>,
}

impl Reference {
    /// Selects the points of a keyframe. `depth_m` is an image of `depth_camera`, of which every level
    /// of the pyramid is a halving or the whole.
    pub fn new(pyramid: &IntensityPyramid, depth_m: &Image<f32>, depth_camera: &Camera) -> Self {
        let points_of = |image: &IntensityImage| {
            let size = depth_camera.intrinsics.fx / image.camera.intrinsics.fx;
            points(image, depth_m, size.round() as usize)
        };
        Self {
            levels: pyramid.levels.iter().map(points_of).collect(),
        }
    }
}

/// The pixel with the strongest gradient in each cell, among those where depth is available and
/// continuous. A pixel of `image` covers `size` x `size` pixels of `depth_m`.
fn points(image: &IntensityImage, depth_m: &Image<f32>, size: usize) -> Vec<ReferencePoint> {
    let (width, height) = (image.camera.width, image.camera.height);
    let depth_at = |u: usize, v: usize| {
        let (u, v) = (u * size + size / 2, v * size + size / 2);
        depth_m.at(u.min(depth_m.width() - 1), v.min(depth_m.height() - 1))
    };
    let is_continuous = |u: usize, v: usize| {
        let depth = depth_at(u, v);
        let around = [(u - 1, v), (u + 1, v), (u, v - 1), (u, v + 1)];
        let near = |other: f32| (other / depth - 1.0).abs() <= MAX_DEPTH_STEP;
        has_depth(depth) && around.iter().all(|&(u, v)| near(depth_at(u, v)))
    };
    let mut points = Vec::new();
    for top in (0..height).step_by(CELL_PX) {
        for left in (0..width).step_by(CELL_PX) {
            let rows = top.max(1)..(top + CELL_PX).min(height - 1);
            let columns = left.max(1)..(left + CELL_PX).min(width - 1);
            let cell = rows.flat_map(|v| columns.clone().map(move |u| (u, v)));
            let mut strongest = (MIN_GRADIENT * MIN_GRADIENT, None);
            for (u, v) in cell {
                let strength = squared_gradient(image.pixels(), u, v);
                let is_seen = image.pixels().at(u, v).is_finite();
                if strength > strongest.0 && is_seen && is_continuous(u, v) {
                    strongest = (strength, Some((u, v)));
                }
            }
            points.extend(strongest.1.map(|(u, v)| {
                let position = (image.camera).unproject(u as f64, v as f64, depth_at(u, v).into());
                let [du, dv] = gradient(image.pixels(), u, v);
                ReferencePoint {
                    position,
                    intensity: image.pixels().at(u, v),
                    gradient: gradient_by_point(image, &position, [du, dv]).cast(),
                }
            }));
        }
    }
    points
}

/// Gradient per pixel by central differences; NaN next to invalid pixels.
fn gradient(pixels: &Image<f32>, u: usize, v: usize) -> [f32; 2] {
    let du = 0.5 * (pixels.at(u + 1, v) - pixels.at(u - 1, v));
    let dv = 0.5 * (pixels.at(u, v + 1) - pixels.at(u, v - 1));
    [du, dv]
}

fn squared_gradient(pixels: &Image<f32>, u: usize, v: usize) -> f32 {
    let [du, dv] = gradient(pixels, u, v);
    du * du + dv * dv
}
