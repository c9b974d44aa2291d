//! The colours of a mesh's vertices: means over the renders in which they are visible.

use fgs_geom::View;
use nalgebra::Vector3;
use rayon::prelude::*;

use super::depth::{SurfaceImage, depth_at};

/// Of a vertex that no view shows.
const GRAY: [f32; 3] = [0.5; 3];

/// Weighted sums of the colours of N vertices.
pub(super) struct VertexColors {
    /// Sum of weighted colours, and of weights, `[N]`.
    sums: Vec<(Vector3<f32>, f32)>,
}

impl VertexColors {
    pub(super) fn new(len: usize) -> Self {
        Self {
            sums: vec![(Vector3::zeros(), 0.0); len],
        }
    }

    /// Adds the colours of the vertices within `max_distance_m` of the surface that the view shows.
    pub(super) fn add(
        &mut self,
        positions: &[[f32; 3]],
        image: &SurfaceImage,
        view: &View,
        max_distance_m: f32,
    ) {
        let camera_from_world = view.world_from_camera.inverse();
        let sums = self.sums.par_iter_mut().zip(positions);
        sums.for_each(|((sum, weights), position)| {
            let point = camera_from_world.transform(&Vector3::from(*position).cast());
            let Some(pixel) = view.camera.project(&point) else {
                return;
            };
            let depth_m = depth_at(&image.depth_m, pixel.x as f32, pixel.y as f32);
            let Some(depth_m) =
                depth_m.filter(|depth_m| (depth_m - point.z as f32).abs() <= max_distance_m)
            else {
                return;
            };
            // The pixel lies inside, since it has depth.
            let color = image
                .color
                .at(pixel.x.round() as usize, pixel.y.round() as usize);
            let weight = 1.0 / (depth_m * depth_m);
            *sum += weight * Vector3::from(color);
            *weights += weight;
        });
    }

    /// sRGB, 0 to 1.
    pub(super) fn mean(&self) -> Vec<[f32; 3]> {
        let mean = |(sum, weight): &(Vector3<f32>, f32)| {
            if *weight > 0.0 {
                (sum / *weight).map(|value| value.clamp(0.0, 1.0)).into()
            } else {
                GRAY
            }
        };
        self.sums.iter().map(mean).collect()
    }
}
