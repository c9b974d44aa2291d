//! Brightness of a 3D point in an image and its Jacobian with respect to the pose.
//!
//! A point at `p` in the camera frame projects to `pi(p) = (fx x/z + cx, fy y/z + cy)`. A right
//! perturbation of the pose, `world_from_camera exp([omega, v])`, moves the point to `p - omega x p
//! - v` to first order.

use nalgebra::{Vector3, Vector6};

use crate::IntensityImage;

/// Points closer to the camera than this are skipped, metres.
const NEAR_M: f64 = 0.05;

/// Brightness of the image at the projection of the point, and its derivative with respect to the
/// pose; `None` if the point is not visible in the image.
#[inline]
pub(crate) fn brightness(
    image: &IntensityImage,
    point: &Vector3<f64>,
) -> Option<(f64, Vector6<f64>)> {
    if point.z < NEAR_M {
        return None;
    }
    let intrinsics = &image.camera.intrinsics;
    let per_z = 1.0 / point.z;
    let (x, y) = (point.x * per_z, point.y * per_z);
    let [value, du, dv] = image.sample(
        intrinsics.fx * x + intrinsics.cx,
        intrinsics.fy * y + intrinsics.cy,
    )?;
    let by_point = gradient_by_point(image, point, [du, dv]);
    Some((f64::from(value), by_pose(&by_point, point)))
}

/// The derivative of a point's brightness by its position in the camera frame, given that by pixels.
#[inline]
pub(crate) fn gradient_by_point(
    image: &IntensityImage,
    point: &Vector3<f64>,
    [du, dv]: [f32; 2],
) -> Vector3<f64> {
    let intrinsics = &image.camera.intrinsics;
    let per_z = 1.0 / point.z;
    let (gx, gy) = (
        f64::from(du) * intrinsics.fx * per_z,
        f64::from(dv) * intrinsics.fy * per_z,
    );
    Vector3::new(gx, gy, -(gx * point.x + gy * point.y) * per_z)
}

/// The derivative by the pose, given that by the point's position.
#[inline]
pub(crate) fn by_pose(by_point: &Vector3<f64>, point: &Vector3<f64>) -> Vector6<f64> {
    // by_point . (-omega x p) = omega . (by_point x p)
    let by_rotation = by_point.cross(point);
    Vector6::new(
        by_rotation.x,
        by_rotation.y,
        by_rotation.z,
        -by_point.x,
        -by_point.y,
        -by_point.z,
    )
}

/// Standard deviation of Gaussian noise whose absolute values have the median of these; 0 if there are
/// none. Changes their order.
pub(crate) fn noise_of(sizes: &mut [f64]) -> f64 {
    if sizes.is_empty() {
        return 0.0;
    }
    let middle = sizes.len() / 2;
    1.4826 * *sizes.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use fgs_geom::Image;
    use nalgebra::Vector3;
    use num_dual::Dual64;
    use rand::RngExt;

    use super::*;
    use crate::test_scene::{camera, image_of, rng};

    /// Brightness seen by a camera that moves along one coordinate of the tangent, with dual
    /// numbers.
    fn dual(pixels: &Image<f32>, point: &Vector3<f64>, coordinate: usize) -> Dual64 {
        let mut tangent = [Dual64::from(0.0); 6];
        tangent[coordinate].eps = 1.0;
        let [a, b, c, s, t, r] = tangent;
        let [x, y, z] = [point.x, point.y, point.z].map(Dual64::from_re);
        // p - omega x p - v
        let (x, y, z) = (
            x - (b * z - c * y) - s,
            y - (c * x - a * z) - t,
            z - (a * y - b * x) - r,
        );
        let k = camera().intrinsics;
        let (u, v) = (x / z * k.fx + k.cx, y / z * k.fy + k.cy);
        let (column, row) = (u.re.floor(), v.re.floor());
        let (a, b) = (u - column, v - row);
        let at =
            |du: usize, dv: usize| f64::from(pixels.at(column as usize + du, row as usize + dv));
        let one = Dual64::from(1.0);
        (one - a) * (one - b) * at(0, 0)
            + a * (one - b) * at(1, 0)
            + (one - a) * b * at(0, 1)
            + a * b * at(1, 1)
    }

    #[test]
    fn brightness_and_its_derivative_agree_with_dual_numbers() {
        let mut rng = rng(1);
        let camera = camera();
        let pixels = Image::from_fn(camera.width, camera.height, |_, _| {
            rng.random_range(0.0..1.0)
        });
        let image = image_of(&pixels);
        for _ in 0..200 {
            let (u, v) = (rng.random_range(1.0..30.0), rng.random_range(1.0..22.0));
            let point = camera.unproject(u, v, rng.random_range(0.3..4.0));
            let (value, jacobian) = brightness(&image, &point).unwrap();
            for i in 0..6 {
                let expected = dual(&pixels, &point, i);
                assert!((value - expected.re).abs() <= 1e-5);
                assert!(
                    (jacobian[i] - expected.eps).abs() <= 1e-5 * jacobian.amax(),
                    "{i}"
                );
            }
        }
        assert!(brightness(&image, &Vector3::new(0.0, 0.0, 0.01)).is_none());
        assert!(brightness(&image, &Vector3::new(0.0, 0.0, -1.0)).is_none());
        assert!(brightness(&image, &Vector3::new(9.0, 0.0, 1.0)).is_none());
    }
}
