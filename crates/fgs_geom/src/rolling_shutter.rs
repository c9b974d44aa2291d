//! Rolling shutters: most cameras read their image row by row, each row a moment after the one before.
//! While the camera turns, the image is sheared or stretched: a Kinect at 50 degrees a second by ten
//! pixels from top to bottom.
//!
//! A frame's time, and so its pose, is that of the middle row. With the velocity known, each pixel
//! is taken from where the camera saw the same surface when it read that row.

use std::borrow::Cow;
use std::sync::Arc;

use nalgebra::Vector6;

use crate::pixel_map::{bilinear, corners};
use crate::{DepthSensor, Image, Kernel, RgbdFrame, dispatch, has_depth, registered_depth};

/// A pixel's row says when it was read and where it moved from; that decides its row. After two
/// rounds the error is below a hundredth of a pixel.
const ROUNDS: usize = 2;

/// Taken where no depth was measured, metres: there only the camera's rotation matters much.
const FAR_M: f32 = 10.0;

/// When row `v` of `height` is read, seconds after the middle of the image, if reading all of them
/// takes `readout_secs`.
pub fn row_delay_secs(v: usize, height: usize, readout_secs: f64) -> f64 {
    ((v as f64 + 0.5) / height as f64 - 0.5) * readout_secs
}

impl RgbdFrame {
    /// The frame with the colour image that a global shutter would have taken at the frame's time.
    /// `velocity` is the camera's twist `[omega, v]` in its own axes, rad/s and m/s. Pixels whose
    /// surface the rolling shutter missed are not valid; depth stays as it is.
    pub fn with_steady_color(&self, velocity: &Vector6<f64>) -> Cow<'_, Self> {
        if self.color_readout_secs == 0.0 {
            return Cow::Borrowed(self);
        }
        let (width, height) = (self.camera.width, self.camera.height);
        let shutter = Shutter::new(self, velocity);
        let mut color = Image::filled(width, height, [0; 3]);
        let mut valid = Image::filled(width, height, false);
        let [mut x, mut y] = [vec![0.0; width], vec![0.0; width]];
        for row in 0..height {
            dispatch(Sources {
                shutter: &shutter,
                row: row as f32,
                depth_m: self.depth_m.row(row),
                source: [&mut x, &mut y],
            });
            for (u, (&x, &y)) in x.iter().zip(&y).enumerate() {
                if let Some(seen) = bilinear(&self.color, x, y)
                    && self.is_seen_around(x, y)
                {
                    color.set(u, row, seen);
                    valid.set(u, row, true);
                }
            }
        }
        Cow::Owned(Self {
            color,
            color_valid: Some(Arc::new(valid)),
            depth_m: self.depth_m.clone(),
            color_readout_secs: 0.0,
            ..*self
        })
    }

    /// Whether all four pixels around a point have been seen.
    fn is_seen_around(&self, x: f32, y: f32) -> bool {
        let Some(seen) = &self.color_valid else {
            return true;
        };
        corners(seen, x, y).is_some_and(|(places, _)| places.iter().all(|i| seen.data()[*i]))
    }

    /// The frame as one camera with a global shutter would have taken it at the frame's time: steady
    /// colour, and depth registered to it.
    pub fn synchronized(&self, velocity: &Vector6<f64>) -> Cow<'_, Self> {
        let steady = self.with_steady_color(velocity);
        if self.depth_sensor == DepthSensor::default() {
            return steady;
        }
        let mut synchronized = steady.into_owned();
        synchronized.depth_m =
            registered_depth(&self.depth_m, &self.camera, &self.depth_sensor, velocity);
        synchronized.depth_sensor = DepthSensor::default();
        Cow::Owned(synchronized)
    }
}

/// How a camera reads its rows while it moves.
///
/// A point `p` in the camera's axes is at `p - t a + t^2 / 2 (omega x a)` when a row `t` later is read,
/// with `a = omega x p + v`. What is left out, `|t omega|^3 / 6`, is a hundredth of a pixel at 180
/// degrees a second.
struct Shutter {
    focal_px: [f32; 2],
    center_px: [f32; 2],
    omega: [f32; 3],
    velocity: [f32; 3],
    secs_per_row: f32,
    last_row: f32,
}

impl Shutter {
    fn new(frame: &RgbdFrame, velocity: &Vector6<f64>) -> Self {
        let (k, height) = (frame.camera.intrinsics, frame.camera.height);
        let twist = velocity.map(|value| value as f32);
        Self {
            focal_px: [k.fx as f32, k.fy as f32],
            center_px: [k.cx as f32, k.cy as f32],
            omega: [twist[0], twist[1], twist[2]],
            velocity: [twist[3], twist[4], twist[5]],
            secs_per_row: (frame.color_readout_secs / height as f64) as f32,
            last_row: height as f32 - 1.0,
        }
    }

    /// Where the rolling shutter shows what a global one would show at a pixel.
    #[inline(always)]
    fn source(&self, column: f32, row: f32, depth_m: f32) -> [f32; 2] {
        let ([fx, fy], [cx, cy]) = (self.focal_px, self.center_px);
        let z = if has_depth(depth_m) { depth_m } else { FAR_M };
        let point = [(column - cx) * (z / fx), (row - cy) * (z / fy), z];
        let turned = cross(self.omega, point);
        let along = [0, 1, 2].map(|i| turned[i] + self.velocity[i]);
        let around = cross(self.omega, along);
        let (mut x, mut y) = (column, row);
        for _ in 0..ROUNDS {
            let t = (y.max(0.0).min(self.last_row) - 0.5 * self.last_row) * self.secs_per_row;
            let moved = [0, 1, 2].map(|i| point[i] - t * along[i] + (0.5 * t * t) * around[i]);
            let per_z = 1.0 / moved[2];
            // Behind the camera there is nothing.
            x = if moved[2] > 0.0 {
                fx * moved[0] * per_z + cx
            } else {
                f32::NAN
            };
            y = fy * moved[1] * per_z + cy;
        }
        [x, y]
    }
}

#[inline(always)]
fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// The sources of a row's pixels, columns and rows.
struct Sources<'a> {
    shutter: &'a Shutter,
    row: f32,
    depth_m: &'a [f32],
    source: [&'a mut [f32]; 2],
}

impl Kernel for Sources<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        let [x, y] = self.source;
        let sources = x.iter_mut().zip(y.iter_mut()).zip(self.depth_m);
        for (column, ((x, y), depth_m)) in sources.enumerate() {
            [*x, *y] = self.shutter.source(column as f32, self.row, *depth_m);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::{Camera, FrameIndex, Intrinsics, Se3};

    const W: usize = 320;
    const H: usize = 240;
    const READOUT_SECS: f64 = 0.03;

    fn camera() -> Camera {
        let intrinsics = Intrinsics {
            fx: 260.0,
            fy: 258.0,
            cx: 160.3,
            cy: 118.1,
        };
        Camera::new(W, H, intrinsics).unwrap()
    }

    /// A slanted wall with smooth paint.
    fn seen(world_from_camera: &Se3, u: usize, v: usize) -> (f64, f32) {
        let normal = Vector3::new(0.2, -0.1, -1.0).normalize();
        let ray = world_from_camera.rotation * camera().ray(u as f64, v as f64);
        let from = world_from_camera.translation;
        let depth = normal.dot(&(Vector3::new(0.0, 0.0, 2.0) - from)) / normal.dot(&ray);
        let point = from + depth * ray;
        let paint = 127.0 + 60.0 * (9.0 * point.x).sin() + 60.0 * (11.0 * point.y).cos();
        (paint, depth as f32)
    }

    /// The wall seen by a camera that moves through the origin with a velocity.
    fn frame(velocity: &Vector6<f64>, readout_secs: f64) -> RgbdFrame {
        let color = Image::from_fn(W, H, |u, v| {
            let pose = Se3::exp(&(row_delay_secs(v, H, readout_secs) * velocity));
            [seen(&pose, u, v).0.round() as u8; 3]
        });
        let depth_m = Image::from_fn(W, H, |u, v| seen(&Se3::identity(), u, v).1);
        let mut frame = RgbdFrame::new(FrameIndex(0), 0.0, color, depth_m, camera()).unwrap();
        frame.color_readout_secs = readout_secs;
        frame
    }

    fn difference(a: &RgbdFrame, b: &RgbdFrame, u: usize, v: usize) -> u8 {
        a.color.at(u, v)[0].abs_diff(b.color.at(u, v)[0])
    }

    #[test]
    fn a_steadied_image_is_that_of_a_global_shutter() {
        let velocity = Vector6::new(0.9, -1.2, 0.5, 0.2, -0.3, 0.1);
        let rolling = frame(&velocity, READOUT_SECS);
        let global = frame(&velocity, 0.0);
        let steady = rolling.with_steady_color(&velocity);
        let (mut valid, mut worst_before) = (0, 0);
        for v in 0..H {
            for u in 0..W {
                if steady.has_color(u, v) {
                    valid += 1;
                    assert!(difference(&steady, &global, u, v) <= 2, "({u}, {v})");
                    worst_before = worst_before.max(difference(&rolling, &global, u, v));
                }
            }
        }
        assert!(valid >= W * H * 9 / 10, "{valid}");
        assert!(worst_before >= 15, "{worst_before}");
        assert_eq!(steady.color_readout_secs, 0.0);
    }

    #[test]
    fn a_mask_moves_with_the_image_and_loses_no_unseen_pixel() {
        let velocity = Vector6::new(0.0, -1.2, 0.0, 0.0, 0.0, 0.0);
        let unseen = |u: usize, v: usize| (100..120).contains(&u) && (5..15).contains(&v);
        let mask = Image::from_fn(W, H, |u, v| !unseen(u, v));
        let mut rolling = frame(&velocity, READOUT_SECS);
        for v in 0..H {
            for u in (0..W).filter(|u| unseen(*u, v)) {
                rolling.color.set(u, v, [0; 3]);
            }
        }
        let rolling = rolling.with_color_valid(Arc::new(mask)).unwrap();
        let steady = rolling.with_steady_color(&velocity);
        let global = frame(&velocity, 0.0);
        let mut masked = 0;
        for v in 2..H - 2 {
            for u in 12..W - 12 {
                let valid = steady.has_color(u, v);
                masked += usize::from(!valid);
                // No black of the mask mixes in.
                assert!(
                    !valid || difference(&steady, &global, u, v) <= 2,
                    "({u}, {v})"
                );
            }
        }
        assert!((200..=280).contains(&masked), "{masked}");
    }

    #[test]
    fn a_global_shutter_and_rest_change_nothing() {
        let velocity = Vector6::new(0.9, -1.2, 0.5, 0.2, -0.3, 0.1);
        let global = frame(&velocity, 0.0);
        let same = global.with_steady_color(&velocity);
        assert!(same.color == global.color && same.color_valid.is_none());
        let rest = frame(&Vector6::zeros(), READOUT_SECS);
        let same = rest.with_steady_color(&Vector6::zeros());
        let border = [(0, 0), (W - 1, H - 1)];
        let inside = |u: usize, v: usize| same.has_color(u, v) || border.contains(&(u, v));
        let unchanged = |u, v| difference(&same, &rest, u, v) <= 1;
        assert!((1..H - 1).all(|v| (1..W - 1).all(|u| inside(u, v) && unchanged(u, v))));
    }

    #[test]
    fn absurd_velocities_neither_panic_nor_invent_colours() {
        for velocity in [[1e6; 6], [f64::NAN; 6], [0.0, 0.0, 0.0, 0.0, 0.0, -1e9]] {
            let velocity = Vector6::from(velocity);
            let mut rolling = frame(&Vector6::zeros(), 0.0);
            rolling.color_readout_secs = READOUT_SECS;
            let steady = rolling.with_steady_color(&velocity);
            let valid = steady.color_valid.as_deref().unwrap();
            assert!(valid.data().iter().filter(|valid| **valid).count() <= W * H / 2);
        }
    }
}
