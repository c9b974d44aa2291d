//! A camera along a flat wall with posters: depth alone says nothing of motion along the wall, the
//! posters do.

#![allow(clippy::unwrap_used)]

use fgs_geom::{Camera, FrameIndex, Image, Intrinsics, RgbdFrame, Se3};
use fgs_slam::{Execution, Slam, SlamConfig, model_settings};
use fgs_splat::CpuModel;
use nalgebra::{Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const WALL_Z_M: f64 = 1.5;
const FRAMES: usize = 300;

fn camera() -> Camera {
    let intrinsics = Intrinsics {
        fx: 165.0,
        fy: 165.0,
        cx: 99.5,
        cy: 74.5,
    };
    Camera::new(200, 150, intrinsics).unwrap()
}

/// To and fro along the wall by 60 cm and up and down by 20 cm, a centimetre a frame at most, while
/// the camera turns.
fn pose(index: usize) -> Se3 {
    let phase = std::f64::consts::TAU * index as f64 / 200.0;
    let position = Vector3::new(0.3 * phase.sin(), 0.1 * (2.0 * phase).sin(), 0.0);
    let turn = Vector3::new(0.05 * (2.0 * phase).sin(), 0.08 * phase.sin(), 0.0);
    let turn = Se3::exp(&Vector6::new(turn.x, turn.y, turn.z, 0.0, 0.0, 0.0));
    Se3::new(turn.rotation, position)
}

/// Sheets of 12 cm by 9 cm in shades of grey, with lines of print.
fn poster(x: f64, y: f64) -> f64 {
    let (column, row) = ((x / 0.12).floor(), (y / 0.09).floor());
    let mixed = (column * 12.9898 + row * 78.233).sin() * 43758.5453;
    let shade = 0.25 + 0.5 * (mixed - mixed.floor());
    let print = (x / 0.018).sin() * (y / 0.013).sin();
    shade + 0.12 * print
}

/// What a Kinect sees of the wall: noise of 3 mm at 1.5 m, and of a step and a half of colour.
fn frame(index: usize) -> RgbdFrame {
    let (camera, pose) = (camera(), pose(index));
    let mut rng = Pcg64Mcg::seed_from_u64(index as u64);
    let mut normal = || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
    let mut depth_m = Image::filled(camera.width, camera.height, 0.0);
    let color = Image::from_fn(camera.width, camera.height, |u, v| {
        let ray = pose.rotation * camera.ray(u as f64, v as f64);
        let depth = (WALL_Z_M - pose.translation.z) / ray.z;
        let point = pose.translation + depth * ray;
        depth_m.set(u, v, (depth + 0.003 * normal()) as f32);
        let level = 255.0 * poster(point.x, point.y) + 1.5 * normal();
        [level.round().clamp(0.0, 255.0) as u8; 3]
    });
    let seconds = index as f64 / 30.0;
    RgbdFrame::new(FrameIndex(index), seconds, color, depth_m, camera).unwrap()
}

/// Root mean square of the position's error, the first pose being right, metres; infinite if a frame
/// is lost.
fn error_m(color: bool) -> f64 {
    let mut config = SlamConfig::default();
    config.tracking.color = color;
    config.tracking.grid_stride_px = Some(2);
    config.mapping.iterations_per_frame = 0.1;
    let model = CpuModel::new(model_settings(&config.mapping));
    let mut slam = Slam::new(&camera(), &config, Execution::Lockstep, Box::new(model)).unwrap();
    for index in 0..FRAMES {
        slam.push(frame(index)).unwrap();
    }
    let first_from_world = pose(0).inverse();
    let squared = slam.finish().frames.into_iter().map(|frame| {
        let truth = first_from_world * pose(frame.index.0);
        let found = frame.world_from_camera.map(|pose| pose.translation);
        found.map_or(f64::INFINITY, |found| {
            (found - truth.translation).norm_squared()
        })
    });
    (squared.sum::<f64>() / FRAMES as f64).sqrt()
}

#[test]
fn posters_hold_the_camera_where_geometry_slides() {
    let (with, without) = (error_m(true), error_m(false));
    assert!(with <= 0.003, "{with} m");
    assert!(without >= 0.1, "{without} m");
}
