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

#[cfg(test)]
mod tests {
    use fgs_geom::{Camera, Image, Intrinsics, Se3};

    use super::*;

    #[test]
    fn vertices_take_the_colors_of_the_views_that_show_them() {
        let intrinsics = Intrinsics {
            fx: 40.0,
            fy: 40.0,
            cx: 19.5,
            cy: 14.5,
        };
        let view = View {
            camera: Camera::new(40, 30, intrinsics).unwrap(),
            world_from_camera: Se3::identity(),
        };
        let positions = [
            [0.1, 0.0, 1.0],
            [0.2, 0.0, 2.0],
            [0.0, 0.0, -1.0],
            [3.0, 0.0, 1.0],
        ];
        let mut colors = VertexColors::new(positions.len());
        // Near red, behind it blue, which is seen once the red is gone.
        let seen = [
            (1.0, [1.0, 0.0, 0.0]),
            (2.0, [0.0, 0.0, 1.5]),
            (1.0, [0.5, 0.0, 0.0]),
        ];
        for (depth_m, color) in seen {
            let image = SurfaceImage {
                color: Image::filled(40, 30, color),
                depth_m: Image::filled(40, 30, depth_m),
            };
            colors.add(&positions, &image, &view, 0.05);
        }
        assert_eq!(
            colors.mean(),
            [[0.75, 0.0, 0.0], [0.0, 0.0, 1.0], GRAY, GRAY]
        );
    }
}
