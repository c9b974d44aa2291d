//! Where and when a depth image was measured, seen from the colour image of the same frame.
//!
//! An RGB-D camera is two sensors. Their shutters do not open at the same moment and the drivers'
//! registration of one image to the other is a pixel or two off; while the camera turns, both shift
//! the colours on the surfaces. A frame's pose is that of the colour camera when the colour image
//! was taken; [`DepthSensor`] says where the depth camera was when its image was taken.

use nalgebra::{Matrix3, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use crate::{Camera, Image, Se3, has_depth, row_delay_secs};

/// The depth sensor's place and time relative to the colour camera's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DepthSensor {
    /// How much later than the colour image the depth image was taken, seconds; negative if it was
    /// taken earlier.
    pub delay_secs: f64,
    /// From the axes in which the depth image was measured to the colour camera's, at one moment:
    /// what the driver's registration left over. Near the identity.
    pub color_from_depth: Se3,
    /// How long the depth camera takes to read its rows, seconds: from the first row to the last;
    /// negative if it reads from the bottom; 0 for a global shutter. Its image was taken when the
    /// middle row was.
    pub readout_secs: f64,
}

impl Default for DepthSensor {
    /// Both images are of one moment and one camera.
    fn default() -> Self {
        Self {
            delay_secs: 0.0,
            color_from_depth: Se3::identity(),
            readout_secs: 0.0,
        }
    }
}

impl DepthSensor {
    /// From the axes of the depth image, when it was taken, to those of the colour camera, when its
    /// image was taken. `velocity` is the camera's twist `[omega, v]` in the colour camera's axes,
    /// rad/s and m/s.
    pub fn color_from_depth(&self, velocity: &Vector6<f64>) -> Se3 {
        Se3::exp(&(self.delay_secs * velocity)) * self.color_from_depth
    }

    /// For each of `height` rows of the depth image, from the depth camera's axes when that row was
    /// read to its axes when the middle row was. `velocity` as above.
    pub fn middle_from_rows(&self, height: usize, velocity: &Vector6<f64>) -> Vec<Se3> {
        let depth_from_color = self.color_from_depth.inverse();
        let velocity = depth_from_color.adjoint() * velocity;
        let delays = (0..height).map(|v| row_delay_secs(v, height, self.readout_secs));
        delays.map(|delay| Se3::exp(&(delay * velocity))).collect()
    }
}

/// A measurement that lands further than this from a pixel, in pixels, is not that pixel's.
const MAX_MISS_PX: f64 = 0.75;

/// The depth image as the colour camera would have measured it, with a global shutter, when its image
/// was taken. Both cameras are `camera`, and move with `velocity`, `[omega, v]` in the colour camera's
/// axes, rad/s and m/s; what a measurement moves by is a few pixels in the image. Pixels that no
/// measurement reaches get 0.
///
/// Each measurement goes to the pixel that it lands nearest to, the nearer surface hiding the one
/// behind. Where rounding leaves a pixel out between two that were hit, it takes what lands
/// next to it.
pub fn registered_depth(
    depth_m: &Image<f32>,
    camera: &Camera,
    sensor: &DepthSensor,
    velocity: &Vector6<f64>,
) -> Image<f32> {
    let (width, height) = (depth_m.width(), depth_m.height());
    let landing = Landing::new(camera, sensor, velocity);
    let mut registered = Image::filled(width, height, 0.0_f32);
    for v in 0..height {
        for (u, &depth) in depth_m.row(v).iter().enumerate() {
            let (x, y, z) = landing.of(u, v, depth);
            let (column, row) = (x.round(), y.round());
            // Also rejects NaN.
            let inside =
                (0.0..width as f64).contains(&column) && (0.0..height as f64).contains(&row);
            if has_depth(depth) && inside && z > 0.0 {
                let (column, row) = (column as usize, row as usize);
                let nearest = registered.at(column, row);
                if nearest == 0.0 || (z as f32) < nearest {
                    registered.set(column, row, z as f32);
                }
            }
        }
    }
    for v in 0..height {
        for u in 1..width {
            // What is left of it is of the same surface, and moved alike.
            let beside = registered.at(u - 1, v);
            if registered.at(u, v) == 0.0 && beside > 0.0 {
                registered.set(u, v, landing.next_to(u, v, beside, depth_m));
            }
        }
    }
    registered
}

/// Where measurements land in the other camera's image.
struct Landing<'a> {
    camera: &'a Camera,
    /// For each row, from the depth camera's axes when it was read.
    color_from_rows: Vec<(Matrix3<f64>, Vector3<f64>)>,
}

impl<'a> Landing<'a> {
    fn new(camera: &'a Camera, sensor: &DepthSensor, velocity: &Vector6<f64>) -> Self {
        let color_from_middle = sensor.color_from_depth(velocity);
        let middle_from_rows = sensor.middle_from_rows(camera.height, velocity);
        let color_from_rows = middle_from_rows.iter().map(|middle_from_row| {
            let motion = color_from_middle * *middle_from_row;
            let rotation = *motion.rotation.to_rotation_matrix().matrix();
            (rotation, motion.translation)
        });
        Self {
            camera,
            color_from_rows: color_from_rows.collect(),
        }
    }

    /// Column, row and depth of what was measured at pixel (u, v).
    fn of(&self, u: usize, v: usize, depth_m: f32) -> (f64, f64, f64) {
        let ray = self.camera.ray(u as f64, v as f64);
        let (rotation, translation) = &self.color_from_rows[v];
        let point = (rotation * ray) * f64::from(depth_m) + translation;
        let intrinsics = &self.camera.intrinsics;
        (
            intrinsics.fx * point.x / point.z + intrinsics.cx,
            intrinsics.fy * point.y / point.z + intrinsics.cy,
            point.z,
        )
    }

    /// The depth of a measurement near `about_m` that lands beside (u, v); 0 if there is none.
    fn next_to(&self, u: usize, v: usize, about_m: f32, depth_m: &Image<f32>) -> f32 {
        // The shift changes little over its own length: undo that of this pixel.
        let (x, y, _) = self.of(u, v, about_m);
        let (column, row) = ((2.0 * u as f64 - x).round(), (2.0 * v as f64 - y).round());
        let inside = (0.0..depth_m.width() as f64).contains(&column)
            && (0.0..depth_m.height() as f64).contains(&row);
        if !inside {
            return 0.0;
        }
        let (column, row) = (column as usize, row as usize);
        let (x, y, z) = self.of(column, row, depth_m.at(column, row));
        let miss_px = (x - u as f64).abs().max((y - v as f64).abs());
        if miss_px <= MAX_MISS_PX && z > 0.0 && has_depth(depth_m.at(column, row)) {
            z as f32
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;

    const W: usize = 160;
    const H: usize = 120;

    fn camera() -> Camera {
        let intrinsics = Intrinsics {
            fx: 130.0,
            fy: 128.0,
            cx: 80.3,
            cy: 58.1,
        };
        Camera::new(W, H, intrinsics).unwrap()
    }

    /// Depth of the plane n . p = d in the axes of a camera at `plane_from_camera`.
    fn plane(plane_from_camera: &Se3) -> Image<f32> {
        Image::from_fn(W, H, |u, v| plane_at(plane_from_camera, u, v))
    }

    fn plane_at(plane_from_camera: &Se3, u: usize, v: usize) -> f32 {
        let normal = Vector3::new(0.2, -0.1, -1.0).normalize();
        let ray = plane_from_camera.rotation * camera().ray(u as f64, v as f64);
        let to_plane = normal.dot(&(Vector3::new(0.0, 0.0, 2.5) - plane_from_camera.translation));
        (to_plane / normal.dot(&ray)) as f32
    }

    fn moved(color_from_depth: &Se3) -> DepthSensor {
        DepthSensor {
            color_from_depth: *color_from_depth,
            ..DepthSensor::default()
        }
    }

    fn registered(depth_m: &Image<f32>, color_from_depth: &Se3) -> Image<f32> {
        registered_depth(
            depth_m,
            &camera(),
            &moved(color_from_depth),
            &Vector6::zeros(),
        )
    }

    #[test]
    fn a_plane_is_registered_to_where_the_color_camera_sees_it() {
        let color_from_depth = Se3::exp(&Vector6::new(0.02, -0.03, 0.01, 0.01, -0.02, 0.03));
        let depth = plane(&Se3::identity());
        let truth = plane(&color_from_depth.inverse());
        let registered = registered(&depth, &color_from_depth);
        let mut covered = 0;
        for (found, truth) in registered.data().iter().zip(truth.data()) {
            if *found > 0.0 {
                covered += 1;
                // A source pixel is at most 0.75 px off; the plane's depth changes by less than
                // 0.5 % over a pixel.
                assert!((found / truth - 1.0).abs() <= 4e-3, "{found} {truth}");
            }
        }
        // All but the border that the depth camera did not see: 4 and 3 px on two sides.
        assert!(covered >= (W - 8) * (H - 7), "{covered}");
        // Left where it was, the depth would be wrong by more.
        let worst = depth.data().iter().zip(truth.data());
        assert!(worst.map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f32::max) >= 0.02);
    }

    #[test]
    fn the_identity_changes_nothing_and_holes_stay() {
        let mut depth = plane(&Se3::identity());
        depth.set(40, 30, 0.0);
        depth.set(41, 30, f32::NAN);
        let registered = registered(&depth, &Se3::identity());
        for (i, (found, measured)) in registered.data().iter().zip(depth.data()).enumerate() {
            if [30 * W + 40, 30 * W + 41].contains(&i) {
                assert_eq!(*found, 0.0);
            } else {
                assert!((found - measured).abs() <= 1e-6 * measured, "{i}");
            }
        }
    }

    #[test]
    fn a_near_surface_hides_a_far_one_no_wider_than_it_is() {
        // A column of 20 px at 1 m before a wall at 3 m; the camera shifts by 2 cm, 2.6 px at 1 m.
        let depth = Image::from_fn(W, H, |u, _| if (70..90).contains(&u) { 1.0 } else { 3.0 });
        let shift = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.02, 0.0, 0.0));
        let registered = registered(&depth, &shift);
        for u in 20..W - 20 {
            let expected = match u {
                73..=92 => 1.0,
                ..=70 | 94.. => 3.0,
                _ => continue, // between the two shifts
            };
            let found = registered.at(u, 60);
            assert!(
                found == 0.0 || (found - expected).abs() <= 1e-6,
                "{u}: {found}"
            );
        }
        assert!((73..=92).all(|u| registered.at(u, 60) == 1.0));
    }

    #[test]
    fn a_delay_moves_by_the_velocity() {
        let sensor = DepthSensor {
            delay_secs: -0.01,
            ..DepthSensor::default()
        };
        let velocity = Vector6::new(0.5, 0.0, 0.0, 0.0, 0.0, 2.0);
        // The colour camera is where the depth camera will be 10 ms later: forward by 2 cm.
        let depth_from_color = sensor.color_from_depth(&velocity).inverse();
        let expected = Se3::exp(&(0.01 * velocity));
        assert!((depth_from_color.inverse() * expected).log().norm() <= 1e-12);
    }

    #[test]
    fn rows_read_one_after_the_other_are_brought_to_one_moment() {
        let velocity = Vector6::new(0.9, -1.2, 0.5, 0.2, -0.3, 0.1);
        let sensor = DepthSensor {
            delay_secs: 0.01,
            color_from_depth: Se3::exp(&Vector6::new(0.0, 0.0, 0.02, 0.01, 0.0, 0.0)),
            readout_secs: 0.03,
        };
        // Each row as a global shutter would see it at that row's moment.
        let rows = Image::from_fn(W, H, |u, v| {
            let delay = sensor.delay_secs + row_delay_secs(v, H, sensor.readout_secs);
            plane_at(
                &(Se3::exp(&(delay * velocity)) * sensor.color_from_depth),
                u,
                v,
            )
        });
        let found = registered_depth(&rows, &camera(), &sensor, &velocity);
        let truth = plane(&Se3::identity());
        let (mut covered, mut worst_before) = (0, 0.0_f32);
        for (i, (found, truth)) in found.data().iter().zip(truth.data()).enumerate() {
            if *found > 0.0 {
                covered += 1;
                assert!((found / truth - 1.0).abs() <= 4e-3, "{i}: {found} {truth}");
                worst_before = worst_before.max((rows.data()[i] / truth - 1.0).abs());
            }
        }
        assert!(covered >= W * H * 85 / 100, "{covered}");
        assert!(worst_before >= 0.02, "{worst_before}");
    }

    #[test]
    fn absurd_motions_give_no_depth_and_no_panic() {
        let depth = plane(&Se3::identity());
        for tangent in [[1e3; 6], [0.0, 0.0, 0.0, 0.0, 0.0, -10.0], [f64::NAN; 6]] {
            let motion = Se3::exp(&Vector6::from(tangent));
            let registered = registered(&depth, &motion);
            assert!(registered.data().iter().all(|depth| depth.is_finite()));
        }
    }
}
