//! The pinhole camera: u = fx x/z + cx, with pixel centres at integer coordinates.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::Number;

use crate::Se3;

/// Focal lengths and principal point, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Horizontal focal length.
    pub fx: f64,
    /// Vertical focal length.
    pub fy: f64,
    /// Column of the principal point.
    pub cx: f64,
    /// Row of the principal point.
    pub cy: f64,
}

/// A camera parameter out of its plausible range.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{key} = {} is not possible: {expected}", Number(*.value))]
pub struct CameraError {
    /// Name of the parameter, as in a camera file.
    pub key: &'static str,
    /// The rejected value.
    pub value: f64,
    /// The accepted range, in words.
    pub expected: String,
}

/// A pinhole camera without lens distortion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Focal lengths and principal point.
    pub intrinsics: Intrinsics,
}

impl Camera {
    /// Creates a camera after checking its parameters: 1 to 65536 pixels per side, focal lengths
    /// between 0.1 and 100 times the longer side, the principal point inside the image.
    ///
    /// # Errors
    /// Names the first parameter out of range.
    pub fn new(width: usize, height: usize, intrinsics: Intrinsics) -> Result<Self, CameraError> {
        let refuse = |key, value: f64, expected: String| {
            Err(CameraError {
                key,
                value,
                expected,
            })
        };
        for (key, size) in [("width", width), ("height", height)] {
            if !(1..=65536).contains(&size) {
                return refuse(key, size as f64, "1 to 65536 pixels".into());
            }
        }
        let side = width.max(height) as f64;
        for (key, focal) in [("fx", intrinsics.fx), ("fy", intrinsics.fy)] {
            if !(0.1 * side..=100.0 * side).contains(&focal) {
                let range = format!("{:.0} to {:.0} pixels", 0.1 * side, 100.0 * side);
                return refuse(key, focal, range);
            }
        }
        for (key, center, size) in [
            ("cx", intrinsics.cx, width as f64),
            ("cy", intrinsics.cy, height as f64),
        ] {
            if !(-0.5..=size - 0.5).contains(&center) {
                let range = format!("a point in the image, -0.5 to {:.1}", size - 0.5);
                return refuse(key, center, range);
            }
        }
        Ok(Self {
            width,
            height,
            intrinsics,
        })
    }

    /// The same horizontal field of view in images of another size.
    ///
    /// # Errors
    /// If the size is out of range, or the principal point would lie outside.
    pub fn resized(&self, width: usize, height: usize) -> Result<Self, CameraError> {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        let scale = width as f64 / self.width as f64;
        // Pixel centres lie at integers, so the image begins at -0.5.
        let cx = (cx + 0.5) * scale - 0.5;
        let cy = (cy + 0.5) * (height as f64 / self.height as f64) - 0.5;
        let (fx, fy) = (fx * scale, fy * scale);
        Self::new(width, height, Intrinsics { fx, fy, cx, cy })
    }

    /// Projects a point in camera coordinates to pixel coordinates, which may lie outside the
    /// image. `None` if the point is not in front of the camera.
    #[inline]
    pub fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        (point.z > 0.0)
            .then(|| Vector2::new(fx * point.x / point.z + cx, fy * point.y / point.z + cy))
    }

    /// The viewing ray K^-1 (u, v, 1) of a pixel in camera coordinates, scaled to z = 1.
    #[inline]
    pub fn ray(&self, u: f64, v: f64) -> Vector3<f64> {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        Vector3::new((u - cx) / fx, (v - cy) / fy, 1.0)
    }

    /// Back-projects a pixel at depth `depth_m` (along z) to a point in camera coordinates.
    #[inline]
    pub fn unproject(&self, u: f64, v: f64, depth_m: f64) -> Vector3<f64> {
        self.ray(u, v) * depth_m
    }

    /// Whether pixel coordinates, rounded to the nearest pixel, lie in the image.
    #[inline]
    pub fn contains(&self, pixel: &Vector2<f64>) -> bool {
        let inside = |x: f64, size: usize| (-0.5..size as f64 - 0.5).contains(&x);
        inside(pixel.x, self.width) && inside(pixel.y, self.height)
    }
}

/// A camera and its pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// The camera.
    pub camera: Camera,
    /// The camera's pose in the world.
    pub world_from_camera: Se3,
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTRINSICS: Intrinsics = Intrinsics {
        fx: 500.0,
        fy: 520.0,
        cx: 310.5,
        cy: 250.25,
    };

    #[test]
    fn unproject_inverts_project() {
        let camera = Camera::new(640, 480, INTRINSICS).unwrap();
        let point = camera.unproject(17.0, 401.0, 2.5);
        assert!((point.z - 2.5).abs() <= 1e-15);
        let pixel = camera.project(&point).unwrap();
        assert!((pixel - Vector2::new(17.0, 401.0)).amax() <= 1e-10);
        assert_eq!(camera.project(&-point), None);
    }

    #[test]
    fn absurd_values_are_named() {
        let refused = |width, height, change: fn(&mut Intrinsics)| {
            let mut intrinsics = INTRINSICS;
            change(&mut intrinsics);
            Camera::new(width, height, intrinsics).unwrap_err().key
        };
        assert_eq!(refused(0, 480, |_| ()), "width");
        assert_eq!(refused(640, 70000, |_| ()), "height");
        assert_eq!(refused(640, 480, |i| i.fx = -500.0), "fx");
        assert_eq!(refused(640, 480, |i| i.fy = f64::NAN), "fy");
        assert_eq!(refused(640, 480, |i| i.cx = 1000.0), "cx");
        assert_eq!(refused(640, 480, |i| i.cy = f64::INFINITY), "cy");
    }

    #[test]
    fn another_size_shows_the_same_width() {
        let intrinsics = Intrinsics {
            fx: 500.0,
            fy: 510.0,
            cx: 300.0,
            cy: 250.0,
        };
        let camera = Camera::new(640, 480, intrinsics).unwrap();
        let small = camera.resized(200, 100).unwrap();
        for (edge, small_edge) in [(-0.5, -0.5), (639.5, 199.5)] {
            let (a, b) = (camera.ray(edge, 0.0).x, small.ray(small_edge, 0.0).x);
            assert!((a - b).abs() <= 1e-12);
        }
        assert_eq!(camera.resized(640, 480).unwrap(), camera);
        assert!(camera.resized(0, 480).is_err());
    }
}
