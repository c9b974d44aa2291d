//! The rational lens model of OpenCV, as Azure Kinect and Orbbec cameras have it.
//!
//! Radially a point moves by `(1 + k1 r2 + k2 r4 + k3 r6) / (1 + k4 r2 + k5 r4 + k6 r6)`, r2 its squared
//! distance from the axis. No polynomial, as camera files have it, comes within a pixel of that at an Azure
//! Kinect's corners: so such images are straightened here.

use fgs_geom::{Camera, Distortion, Image, PixelMap};

/// Where each pixel of the straight image lies in the one that the lens drew; both have the same
/// intrinsics. Coefficients are `[k1, k2, p1, p2, k3, k4, k5, k6]`.
pub(crate) fn undistortion(d: &[f64; 8], camera: &Camera) -> PixelMap {
    let [k1, k2, p1, p2, k3, k4, k5, k6] = *d;
    let tangential = Distortion::from_array([0.0, 0.0, p1, p2, 0.0]);
    let k = camera.intrinsics;
    PixelMap::new(Image::from_fn(camera.width, camera.height, |u, v| {
        let ideal = camera.ray(u as f64, v as f64).xy();
        let r2 = ideal.norm_squared();
        let above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let bent = tangential.distort(&ideal) + ideal * (above / below - 1.0);
        [(k.fx * bent.x + k.cx) as f32, (k.fy * bent.y + k.cy) as f32]
    }))
}

#[cfg(test)]
mod tests {
    use fgs_geom::Intrinsics;

    use super::*;

    fn camera() -> Camera {
        let intrinsics = Intrinsics {
            fx: 60.0,
            fy: 61.0,
            cx: 31.0,
            cy: 24.5,
        };
        Camera::new(64, 48, intrinsics).unwrap()
    }

    fn picture() -> Image<[u8; 3]> {
        Image::from_fn(64, 48, |u, v| [3 * u as u8, 5 * v as u8, (u * v) as u8])
    }

    #[test]
    fn without_a_denominator_it_is_the_usual_lens() {
        let d = [0.1, -0.2, 0.003, -0.002, 0.05, 0.0, 0.0, 0.0];
        let usual = Distortion::from_array([0.1, -0.2, 0.003, -0.002, 0.05]);
        let (expected, found) = (usual.undistortion(&camera()), undistortion(&d, &camera()));
        assert_eq!(expected.color(&picture()), found.color(&picture()));
        assert_eq!(expected.color_valid(), found.color_valid());
    }

    /// A pixel that is 3/4 to the right of the axis: by hand, as OpenCV's documentation has it.
    #[test]
    fn the_denominator_divides() {
        let intrinsics = Intrinsics {
            fx: 64.0,
            fy: 64.0,
            cx: 8.0,
            cy: 24.0,
        };
        let camera = Camera::new(64, 48, intrinsics).unwrap();
        let d = [0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0];
        // r2 = 0.5625, so the factor is 1 / 1.1125, and 48 pixels become 43.146.
        let depth = Image::from_fn(64, 48, |u, _| 1.0 + u as f32);
        let straight = undistortion(&d, &camera).depth(&depth).unwrap();
        assert_eq!(straight.at(56, 24), 1.0 + 51.0);
    }
}
