//! Radial-tangential lens distortion (Brown-Conrady, OpenCV's convention) and how to remove it.

use nalgebra::Vector2;

use crate::{Camera, Image, PixelMap};

/// Distortion coefficients in OpenCV's order: k1, k2, p1, p2, k3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distortion {
    /// Radial coefficient of r^2.
    pub k1: f64,
    /// Radial coefficient of r^4.
    pub k2: f64,
    /// First tangential coefficient.
    pub p1: f64,
    /// Second tangential coefficient.
    pub p2: f64,
    /// Radial coefficient of r^6.
    pub k3: f64,
}

impl Distortion {
    /// From `[k1, k2, p1, p2, k3]`.
    pub fn from_array([k1, k2, p1, p2, k3]: [f64; 5]) -> Self {
        Self { k1, k2, p1, p2, k3 }
    }

    /// Maps an undistorted point (x/z, y/z) in normalised image coordinates to the distorted one.
    pub fn distort(&self, ideal: &Vector2<f64>) -> Vector2<f64> {
        let (x, y) = (ideal.x, ideal.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        Vector2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Where each pixel of the undistorted image lies in the distorted one. Both images have the same
    /// intrinsics.
    pub fn undistortion(&self, camera: &Camera) -> PixelMap {
        let k = camera.intrinsics;
        PixelMap::new(Image::from_fn(camera.width, camera.height, |u, v| {
            let ray = camera.ray(u as f64, v as f64);
            let bent = self.distort(&ray.xy());
            [(k.fx * bent.x + k.cx) as f32, (k.fy * bent.y + k.cy) as f32]
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;

    /// TUM fr1's colour camera.
    fn fr1() -> (Camera, Distortion) {
        let intrinsics = Intrinsics {
            fx: 517.3,
            fy: 516.5,
            cx: 318.6,
            cy: 255.3,
        };
        (
            Camera::new(640, 480, intrinsics).unwrap(),
            Distortion::from_array([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
        )
    }

    /// By hand from the model's definition; OpenCV's projectPoints gives the same.
    #[test]
    fn distorts_like_opencv() {
        let (_, distortion) = fr1();
        let bent = distortion.distort(&Vector2::new(0.3, -0.2));
        // r2 = 0.13; radial = 1 + 0.034112 - 0.01610739 + 0.00255577 = 1.02056038
        assert!((bent.x - (0.3 * 1.020560380 + 0.000648 + 0.000806)).abs() <= 1e-8);
        assert!((bent.y - (-0.2 * 1.020560380 - 0.001134 - 0.000312)).abs() <= 1e-8);
    }

    /// A smooth picture drawn through the lens comes back as the ideal picture.
    #[test]
    fn removes_what_the_lens_added() {
        let (camera, distortion) = fr1();
        let shade =
            |x: f64, y: f64| (127.0 + 60.0 * (8.0 * x).sin() + 60.0 * (9.0 * y).cos()) as u8;
        let ideal = Image::from_fn(640, 480, |u, v| {
            let ray = camera.ray(u as f64, v as f64);
            [shade(ray.x, ray.y); 3]
        });
        // The inverse lens by fixed-point iteration.
        let distorted = Image::from_fn(640, 480, |u, v| {
            let target = camera.ray(u as f64, v as f64).xy();
            let mut point = target;
            for _ in 0..50 {
                point += target - distortion.distort(&point);
            }
            [shade(point.x, point.y); 3]
        });
        let restored = (distortion.undistortion(&camera))
            .color(&distorted)
            .unwrap();
        let mut worst_before = 0;
        for v in 40..440 {
            for u in 40..600 {
                let difference =
                    |image: &Image<[u8; 3]>| image.at(u, v)[0].abs_diff(ideal.at(u, v)[0]);
                assert!(difference(&restored) <= 2, "({u}, {v})");
                worst_before = worst_before.max(difference(&distorted));
            }
        }
        assert!(worst_before >= 10, "the lens bends: {worst_before}");
    }

    #[test]
    fn what_lies_outside_the_distorted_image_is_not_valid() {
        let (camera, distortion) = fr1();
        let map = distortion.undistortion(&camera);
        let valid = map.color_valid();
        let white = map.color(&Image::filled(640, 480, [255; 3])).unwrap();
        let mut invalid = 0;
        for v in 0..480 {
            for u in 0..640 {
                let bent = distortion.distort(&camera.ray(u as f64, v as f64).xy());
                let x = camera.intrinsics.fx * bent.x + camera.intrinsics.cx;
                let y = camera.intrinsics.fy * bent.y + camera.intrinsics.cy;
                let inside = (0.0..=639.0).contains(&x) && (0.0..=479.0).contains(&y);
                // Single precision decides at the very border.
                let border = [x, x - 639.0, y, y - 479.0].iter().any(|d| d.abs() <= 1e-3);
                assert!(valid.at(u, v) == inside || border, "({u}, {v})");
                let shade = if valid.at(u, v) { 255 } else { 0 };
                assert_eq!(white.at(u, v), [shade; 3], "({u}, {v})");
                invalid += usize::from(!valid.at(u, v));
            }
        }
        assert!((5_000..30_000).contains(&invalid), "{invalid}");
    }

    #[test]
    fn depth_is_never_mixed() {
        let (camera, distortion) = fr1();
        let map = distortion.undistortion(&camera);
        let depth = Image::from_fn(640, 480, |u, _| if u < 300 { 1.0 } else { 3.0 });
        let restored = map.depth(&depth).unwrap();
        assert!(restored.data().iter().all(|d| [0.0, 1.0, 3.0].contains(d)));
        assert!(map.depth(&Image::filled(10, 10, 1.0)).is_none());
    }
}
