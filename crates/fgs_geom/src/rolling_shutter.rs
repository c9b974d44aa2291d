//! Rolling shutters: most cameras read their image row by row, each row a moment after the one before.
//! While the camera turns, the image is sheared or stretched: a Kinect at 50 degrees a second by ten
//! pixels from top to bottom.
//!
//! A frame's time, and so its pose, is that of the middle row. With the velocity known, each pixel
//! is taken from where the camera saw the same surface when it read that row.

use std::borrow::Cow;
use std::sync::Arc;

use nalgebra::Vector6;

use crate::{DepthSensor, Image, PixelMap, RgbdFrame, Se3, has_depth, registered_depth};

/// A pixel's row says when it was read and where it moved from; that decides its row. After two
/// rounds the error is far below a hundredth of a pixel.
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
        let map = self.steady_color_map(velocity);
        let mut valid = map.color_valid();
        if let Some(seen) = &self.color_valid {
            let seen = seen.map(|seen| [if *seen { u8::MAX } else { 0 }; 3]);
            let seen = map.color(&seen);
            let seen = seen.iter().flat_map(Image::data);
            for (valid, [seen, ..]) in valid.data_mut().iter_mut().zip(seen) {
                *valid &= *seen == u8::MAX;
            }
        }
        let mut steady = self.clone();
        // The map is made for this camera, whose size the image has.
        steady.color = map.color(&self.color).unwrap_or(steady.color);
        steady.color_valid = Some(Arc::new(valid));
        steady.color_readout_secs = 0.0;
        Cow::Owned(steady)
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

    /// Where the rolling shutter shows what a global one would show at each pixel.
    fn steady_color_map(&self, velocity: &Vector6<f64>) -> PixelMap {
        let (camera, height) = (&self.camera, self.camera.height);
        let row_from_middle: Vec<_> = (0..height)
            .map(|v| {
                let delay = row_delay_secs(v, height, self.color_readout_secs);
                let motion = Se3::exp(&(-delay * velocity));
                (motion.rotation.to_rotation_matrix(), motion.translation)
            })
            .collect();
        let outside = [f32::NAN; 2];
        PixelMap::new(Image::from_fn(camera.width, height, |u, v| {
            let depth = self.depth_m.at(u, v);
            let depth = if has_depth(depth) { depth } else { FAR_M };
            let point = camera.unproject(u as f64, v as f64, depth.into());
            let mut row = v;
            let mut source = outside;
            for _ in 0..ROUNDS {
                let (rotation, translation) = &row_from_middle[row];
                let Some(pixel) = camera.project(&(rotation * point + translation)) else {
                    return outside;
                };
                source = [pixel.x as f32, pixel.y as f32];
                row = (pixel.y.round().max(0.0) as usize).min(height - 1);
            }
            source
        }))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::{Camera, FrameIndex, Intrinsics};

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
