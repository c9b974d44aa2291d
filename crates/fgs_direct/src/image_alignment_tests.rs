use fgs_geom::{Camera, FrameIndex, Image, Intrinsics, RgbdFrame};
use num_dual::Dual64;

use super::*;
use crate::normal_equations::MIN_POINTS;

fn camera() -> Camera {
    let intrinsics = Intrinsics {
        fx: 150.0,
        fy: 154.0,
        cx: 78.0,
        cy: 62.0,
    };
    Camera::new(160, 120, intrinsics).unwrap()
}

/// Two planes that meet at an edge. Without depth variation, a rotation could be mistaken for a
/// translation.
fn depth(ray: &Vector3<f64>, origin: &Vector3<f64>) -> f64 {
    [Vector3::new(0.5, 0.1, 1.0), Vector3::new(-0.4, -0.2, 1.0)]
        .map(|normal| (2.0 - normal.dot(origin)) / normal.dot(ray))
        .into_iter()
        .filter(|depth| *depth > 0.0)
        .fold(f64::INFINITY, f64::min)
}

/// The image seen from a pose and the points visible in it, in the camera frame.
fn picture(world_from_camera: &Se3, light: f64) -> (IntensityPyramid, Vec<Vector3<f64>>) {
    let camera = camera();
    let point = |u: usize, v: usize| {
        let ray = camera.ray(u as f64, v as f64);
        let direction = world_from_camera.rotation * ray;
        ray * depth(&direction, &world_from_camera.translation)
    };
    let color = Image::from_fn(camera.width, camera.height, |u, v| {
        let p = world_from_camera.transform(&point(u, v));
        let pattern = (9.0 * p.x + 2.0 * p.y).sin() + (11.0 * p.y - 3.0 * p.x).cos();
        [(light * (120.0 + 40.0 * pattern)).round() as u8; 3]
    });
    let depth_m = Image::filled(camera.width, camera.height, 1.0);
    let frame = RgbdFrame::new(FrameIndex(0), 0.0, color, depth_m, camera).unwrap();
    let places = (2..118)
        .step_by(4)
        .flat_map(|v| (2..158).step_by(4).map(move |u| (u, v)));
    let points = places.map(|(u, v)| point(u, v)).collect();
    (IntensityPyramid::of_frame(&frame, 4), points)
}

/// About 10 pixels.
fn motion() -> Se3 {
    Se3::exp(&Vector6::new(0.03, -0.04, 0.05, 0.03, -0.02, 0.04))
}

#[test]
fn a_motion_of_ten_pixels_and_another_exposure() {
    let (first, points) = picture(&Se3::identity(), 1.0);
    for light in [1.0, 0.8] {
        let (second, _) = picture(&motion(), light);
        let found = align_images(&first, &second, &points, &Se3::identity()).unwrap();
        let error = (found.second_from_first * motion()).log();
        // A twentieth of a pixel.
        assert!(error.fixed_rows::<3>(0).amax() <= 3e-4, "{error}");
        assert!(error.fixed_rows::<3>(3).amax() <= 6e-4, "{error}");
        assert!(found.noise <= 3.0 / 255.0, "{}", found.noise);
    }
}

#[test]
fn wrong_points_do_not_matter() {
    let (first, mut points) = picture(&Se3::identity(), 1.0);
    let (second, _) = picture(&motion(), 1.0);
    // A tenth of the points are outliers: their depth is wrong.
    points
        .iter_mut()
        .step_by(10)
        .for_each(|point| point.z *= 0.7);
    points
        .iter_mut()
        .skip(10)
        .step_by(20)
        .for_each(|point| point.z *= 1.5);
    let found = align_images(&first, &second, &points, &Se3::identity()).unwrap();
    let error = (found.second_from_first * motion()).log();
    // A few tenths of a pixel.
    assert!(error.amax() <= 2.5e-3, "{error}");
}

#[test]
fn pictures_that_tell_nothing() {
    let (first, points) = picture(&Se3::identity(), 1.0);
    let (dark, _) = picture(&motion(), 0.0);
    let start = Se3::identity();
    assert!(align_images(&first, &dark, &points, &start).is_none());
    assert!(align_images(&dark, &first, &points, &start).is_none());
    let few: Vec<_> = points.iter().step_by(12).copied().collect();
    assert!(align_images(&first, &first, &few, &start).is_some());
    assert!(align_images(&first, &first, &few[..MIN_POINTS - 1], &start).is_none());
    let away = Se3::exp(&Vector6::new(0.0, 3.0, 0.0, 0.0, 0.0, 0.0));
    assert!(align_images(&first, &first, &points, &away).is_none());
    let nan = vec![Vector3::repeat(f64::NAN); 100];
    assert!(align_images(&first, &first, &nan, &start).is_none());
}

#[test]
fn derivatives_are_those_of_dual_numbers() {
    let (second, points) = picture(&motion(), 1.0);
    let second = &second.levels[0];
    let state = State {
        second_from_first: motion().inverse(),
        gain: 0.9,
        offset: 0.05,
    };
    let mut compared = 0;
    for point in points.iter().step_by(7) {
        let Some((residual, jacobian)) = row(point, 0.4, second, &state) else {
            continue;
        };
        compared += 1;
        let y = state.second_from_first.transform(point);
        let pixel = second.camera.project(&y).unwrap();
        let [value, du, dv] = second.sample(pixel.x, pixel.y).unwrap().map(f64::from);
        for axis in 0..8 {
            let delta: [Dual64; 8] = std::array::from_fn(|i| {
                let zero = Dual64::from(0.0);
                if i == axis { zero.derivative() } else { zero }
            });
            let [wx, wy, wz, x, y_, z, gain, offset] = delta;
            let moved = [
                wy * y.z - wz * y.y + x + y.x,
                wz * y.x - wx * y.z + y_ + y.y,
                wx * y.y - wy * y.x + z + y.z,
            ];
            // The image is linearised around the pixel.
            let k = second.camera.intrinsics;
            let u = moved[0] / moved[2] * k.fx + k.cx - pixel.x;
            let v = moved[1] / moved[2] * k.fy + k.cy - pixel.y;
            let brightness = u * du + v * dv + value;
            let expected = brightness - (gain + state.gain) * 0.4 - (offset + state.offset);
            assert!((residual - expected.re).abs() <= 1e-12);
            let size = 1.0 + expected.eps.abs();
            assert!(
                (jacobian[axis] - expected.eps).abs() <= 1e-10 * size,
                "{axis}"
            );
        }
    }
    assert!(compared >= 50);
}
