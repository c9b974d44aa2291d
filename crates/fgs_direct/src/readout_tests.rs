//! Both readouts, in a painted corner of three walls, and their derivatives.

use std::sync::Arc;

use fgs_geom::{FrameIndex, Image, Intrinsics, RgbdFrame};
use nalgebra::SMatrix;
use rand::RngExt;

use super::*;
use crate::test_scene::rng;
use crate::{ColorPair, DepthPair, IntensityImage, Patch, PatchGrid, color_readout, depth_readout};

const PAIRS: usize = 60;
const CELL_PX: usize = 4;

/// Normals and distances from the origin.
const WALLS: [([f64; 3], f64); 3] = [
    ([0.0, 0.0, -1.0], 2.2),
    ([0.0, -1.0, 0.0], 0.35),
    ([-0.8, 0.0, -0.6], 1.3),
];

fn camera() -> Camera {
    let intrinsics = Intrinsics {
        fx: 130.0,
        fy: 131.0,
        cx: 79.0,
        cy: 61.5,
    };
    Camera::new(160, 120, intrinsics).unwrap()
}

/// About 1 rad/s and 0.4 m/s, about and along all axes.
fn walk(t: f64) -> Se3 {
    Se3::exp(&Vector6::new(
        0.15 * (4.0 * t).sin(),
        0.20 * (4.6 * t).sin(),
        0.15 * (3.9 * t).sin(),
        0.15 * (2.5 * t).sin(),
        0.10 * (3.1 * t).sin(),
        0.10 * (2.9 * t).sin(),
    ))
}

fn velocity(path: &dyn Fn(f64) -> Se3, t: f64) -> Vector6<f64> {
    (path(t - 1e-4).inverse() * path(t + 1e-4)).log() / 2e-4
}

/// A pixel's point and normal in the camera's axes when its row was read, and its brightness.
fn see(path: &dyn Fn(f64) -> Se3, t: f64, u: usize, v: usize, readout: f64) -> (Patch, f64) {
    let camera = camera();
    let pose = path(t + row_delay_secs(v, camera.height, readout));
    let ray = camera.ray(u as f64, v as f64);
    let direction = pose.rotation * ray;
    let meet = |(normal, distance): ([f64; 3], f64)| {
        let normal = Vector3::from(normal);
        let depth = -(distance + normal.dot(&pose.translation)) / normal.dot(&direction);
        (depth, normal)
    };
    let walls = WALLS.map(meet).into_iter().filter(|wall| wall.0 > 0.0);
    let (depth, normal) = walls.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
    let p = pose.translation + depth * direction;
    let paint = (9.0 * p.x + 4.0 * p.z).sin() + (11.0 * p.y - 5.0 * p.z + 3.0 * p.x).cos();
    let patch = Patch {
        point: depth * ray,
        normal: pose.rotation.inverse() * normal,
        row: v,
    };
    (patch, 120.0 + 50.0 * paint)
}

/// Pairs of images nine frames apart, and what is known of their motions, with noise.
fn pairs(path: &dyn Fn(f64) -> Se3, readout: f64) -> (Vec<ColorPair>, Vec<DepthPair>) {
    pairs_with(path, &|t| velocity(path, t), readout)
}

fn pairs_with(
    path: &dyn Fn(f64) -> Se3,
    velocity: &dyn Fn(f64) -> Vector6<f64>,
    readout: f64,
) -> (Vec<ColorPair>, Vec<DepthPair>) {
    let camera = camera();
    let mut random = rng(3);
    let mut noise = |size: f64| size * random.random_range(-1.0..1.0);
    let mut frame = |t: f64| {
        let color = Image::from_fn(camera.width, camera.height, |u, v| {
            [(see(path, t, u, v, readout).1 + noise(3.0)).round() as u8; 3]
        });
        let patches = Image::from_fn(camera.width / CELL_PX, camera.height / CELL_PX, |u, v| {
            let (mut patch, _) = see(path, t, CELL_PX * u + 2, CELL_PX * v + 2, readout);
            patch.point *= 1.0 + noise(0.003);
            Some(patch)
        });
        let depth_m = Image::filled(camera.width, camera.height, 1.0);
        let frame = RgbdFrame::new(FrameIndex(0), t, color, depth_m, camera).unwrap();
        let grid = PatchGrid {
            camera,
            cell_px: CELL_PX,
            patches,
        };
        (IntensityImage::of_frame(&frame), Arc::new(grid))
    };
    let pair = |i: usize| {
        let times = [i as f64 * 0.1, i as f64 * 0.1 + 0.3];
        let [(first, first_patches), (second, second_patches)] = times.map(&mut frame);
        let velocities = times.map(velocity);
        let error = Se3::exp(&Vector6::repeat(0.004));
        let start = error * path(times[1]).inverse() * path(times[0]);
        let patches = first_patches.patches.data().iter().flatten();
        let points: Vec<_> = patches.map(|patch| patch.point).collect();
        (
            ColorPair::new(&first, Arc::new(second), &points, start, velocities),
            DepthPair::new(first_patches, second_patches, start, velocities),
        )
    };
    (0..PAIRS).map(pair).unzip()
}

#[test]
fn readouts_are_found() {
    for readout in [0.03, 0.0, -0.02] {
        let (mut color, mut depth) = pairs(&walk, readout);
        let found = [
            color_readout(&mut color, 0.0).unwrap(),
            depth_readout(&mut depth, 0.0).unwrap(),
        ];
        for found in found {
            let error = found.secs - readout;
            assert!(error.abs() <= 6e-4, "{readout} {found:?}");
            assert!(found.standard_error_secs <= 5e-4, "{found:?}");
            assert!(
                found
                    .thirds_secs
                    .unwrap()
                    .iter()
                    .all(|third| (third - readout).abs() <= 2e-3)
            );
        }
        // The motions are those between the middle rows.
        let error = |i: usize, second_from_first: Se3| {
            let t = i as f64 * 0.1;
            (second_from_first * walk(t).inverse() * walk(t + 0.3))
                .log()
                .amax()
        };
        let mean = |errors: f64| errors / PAIRS as f64;
        let of_color = (0..PAIRS).map(|i| error(i, color[i].second_from_first()));
        let of_depth = (0..PAIRS).map(|i| error(i, depth[i].second_from_first()));
        let errors = [mean(of_color.sum()), mean(of_depth.sum())];
        assert!(errors[0] <= 2e-3 && errors[1] <= 1.2e-3, "{errors:?}");
    }
}

#[test]
fn a_camera_at_rest_and_few_pairs_do_not_show_it() {
    let rest = |_: f64| Se3::identity();
    let (mut color, mut depth) = pairs(&rest, 0.03);
    assert!(color_readout(&mut color, 0.0).is_none());
    assert!(depth_readout(&mut depth, 0.0).is_none());
    let (mut color, mut depth) = pairs(&walk, 0.03);
    let few = MIN_MEASUREMENTS - 1;
    assert!(color_readout(&mut color[..few], 0.0).is_none());
    assert!(depth_readout(&mut depth[..few], 0.0).is_none());
    assert!(depth_readout(&mut depth[..=few], 0.0).is_some());
}

#[test]
fn pairs_with_numbers_that_are_none_do_not_count() {
    let lost = |t: f64| Vector6::repeat(if t < 1.0 { f64::NAN } else { 0.0 }) + velocity(&walk, t);
    let (mut color, mut depth) = pairs_with(&walk, &lost, 0.03);
    for found in [
        color_readout(&mut color, 0.0).unwrap(),
        depth_readout(&mut depth, 0.0).unwrap(),
    ] {
        assert!((found.secs - 0.03).abs() <= 1e-3, "{found:?}");
    }
}

/// The residual `n . q` of a point after a step of the motion and of the readout.
fn distance(motion: &RollingMotion, step: &SVector<f64, 7>, points: [Vector3<f64>; 2]) -> f64 {
    let [point, normal] = points;
    let readout = 0.03 + step[6];
    let [first, second] = motion
        .velocities
        .map(|velocity| Row::all(120, &velocity, readout));
    let second_from_first =
        Se3::exp(&step.fixed_rows::<6>(0).into_owned()) * motion.second_from_first;
    normal.dot(&second[95].of_middle(&second_from_first.transform(&first[10].in_middle(&point))))
}

#[test]
fn derivatives_are_those_of_differences() {
    let motion = RollingMotion {
        second_from_first: Se3::exp(&Vector6::new(0.3, -0.2, 0.1, 0.4, -0.5, 0.2)),
        velocities: [
            Vector6::new(0.7, -1.1, 0.4, 0.3, 0.9, -0.2),
            Vector6::new(-0.3, 0.8, 0.6, -0.5, 0.1, 1.2),
        ],
    };
    let points = [Vector3::new(0.3, -0.4, 1.5), Vector3::new(0.6, 0.0, -0.8)];
    let [first, second] = motion
        .velocities
        .map(|velocity| Row::all(120, &velocity, 0.03));
    let middle = motion
        .second_from_first
        .transform(&first[10].in_middle(&points[0]));
    let velocity = motion.first_velocity_in_second();
    let found = motion.jacobian([&first[10], &second[95]], &velocity, &middle, &points[1]);
    for axis in 0..7 {
        let step = 1e-5 * SMatrix::<f64, 7, 7>::identity().column(axis);
        let [after, before] = [1.0, -1.0].map(|side| distance(&motion, &(side * step), points));
        let expected = (after - before) / 2e-5;
        let found = found
            .by_motion
            .iter()
            .chain([&found.by_readout])
            .nth(axis)
            .unwrap();
        assert!(
            (found - expected).abs() <= 1e-8,
            "{axis}: {found} {expected}"
        );
        assert!(expected.abs() >= 1e-3);
    }
}

#[test]
fn a_point_is_seen_by_the_row_that_it_appears_in() {
    let camera = camera();
    let rows = Row::all(120, &Vector6::new(1.5, -1.0, 0.5, 0.3, 0.4, 0.2), 0.03);
    for (u, v) in [(20.0, 10.0), (80.0, 60.0), (140.0, 100.0)] {
        let middle = camera.unproject(u, v, 1.5);
        let found = pixel(&middle, &rows, &camera).unwrap();
        let row = &rows[nearest_row(found.y, 120)];
        let expected = camera.project(&row.of_middle(&middle)).unwrap();
        assert!((found - expected).amax() <= 1e-9, "{found} {expected}");
    }
}
