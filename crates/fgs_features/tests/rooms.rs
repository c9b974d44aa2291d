//! Relative poses of rendered frames, from the pixels on.

#![allow(clippy::unwrap_used)]

use std::sync::{Arc, LazyLock};

use fgs_features::{Features, RelativePose, match_features, relative_pose};
use fgs_geom::{Camera, FrameIndex, Image, RgbdFrame, Se3};
use fgs_synth::{FRAMES_PER_LOOP, SensorModel, Sequence, kinect_camera};

/// Frames of two rooms, seen by a Kinect with noise in colour and depth.
static ROOMS: LazyLock<[Sequence; 2]> = LazyLock::new(|| {
    let camera = kinect_camera(640, 480).unwrap();
    [0, 1].map(|seed| Sequence::new(seed, FRAMES_PER_LOOP, camera, SensorModel::kinect()))
});

fn pose_between(a: &RgbdFrame, b: &RgbdFrame) -> Option<RelativePose> {
    let (a, b) = (Features::detect(a), Features::detect(b));
    relative_pose(&a, &b, &match_features(&a, &b), 1)
}

/// The index of a frame turned by about `degrees` against the frame of another index.
fn turned(room: &Sequence, from: usize, degrees: f64) -> usize {
    let angle = |to: usize| a_from_b(room, from, to).rotation.angle().to_degrees();
    (from..).find(|to| angle(*to) >= degrees).unwrap()
}

fn a_from_b(room: &Sequence, a: usize, b: usize) -> Se3 {
    room.world_from_camera(a).inverse() * room.world_from_camera(b)
}

fn assert_near(found: Option<RelativePose>, truth: &Se3, what: &str) {
    let found = found.unwrap_or_else(|| panic!("no answer: {what}"));
    let error = truth.inverse() * found.a_from_b;
    let (distance_m, degrees) = (
        error.translation.norm(),
        error.rotation.angle().to_degrees(),
    );
    assert!(
        distance_m <= 0.05 && degrees <= 2.0,
        "{what}: {distance_m} m, {degrees} deg, {} inliers",
        found.inliers
    );
}

/// The frame with another brightness.
fn exposed(frame: &RgbdFrame, gain: f32, offset: f32) -> RgbdFrame {
    let mut frame = frame.clone();
    frame.color = frame
        .color
        .map(|rgb| rgb.map(|value| (gain * f32::from(value) + offset).round() as u8));
    frame
}

/// The frame with its colours averaged along rows, as by a camera that turns while it exposes.
fn smeared(frame: &RgbdFrame, length: usize) -> RgbdFrame {
    let mut smeared = frame.clone();
    smeared.color = Image::from_fn(frame.camera.width, frame.camera.height, |u, v| {
        let first = u.saturating_sub(length / 2);
        let row = &frame.color.row(v)[first..(first + length).min(frame.camera.width)];
        std::array::from_fn(|channel| {
            let sum: usize = row.iter().map(|rgb| usize::from(rgb[channel])).sum();
            (sum / row.len()) as u8
        })
    });
    smeared
}

#[test]
fn frames_turned_by_5_to_30_degrees() {
    for (room, sequence) in ROOMS.iter().enumerate() {
        for degrees in [5.0, 15.0, 30.0] {
            let b = turned(sequence, 40, degrees);
            let found = pose_between(&sequence.frame(40), &sequence.frame(b));
            let what = format!("room {room}, {degrees} degrees");
            assert_near(found, &a_from_b(sequence, 40, b), &what);
        }
    }
}

#[test]
fn another_exposure_and_blur() {
    let room = &ROOMS[0];
    let b = turned(room, 10, 12.0);
    let (first, second) = (room.frame(10), room.frame(b));
    let truth = a_from_b(room, 10, b);
    let dim = exposed(&second, 0.6, 30.0);
    assert_near(pose_between(&first, &dim), &truth, "exposure");
    let dark = exposed(&second, 0.25, 0.0);
    assert_near(
        pose_between(&first, &dark),
        &truth,
        "a quarter of the light",
    );
    let blurred = smeared(&second, 9);
    assert_near(pose_between(&first, &blurred), &truth, "blur of 9 pixels");
}

#[test]
fn different_rooms_are_refused() {
    let features = ROOMS
        .each_ref()
        .map(|room| [0, 60, 120, 180].map(|index| Features::detect(&room.frame(index))));
    for a in &features[0] {
        for b in &features[1] {
            assert!(relative_pose(a, b, &match_features(a, b), 1).is_none());
        }
    }
}

#[test]
fn frames_without_corners_or_depth_are_refused() {
    let frame = ROOMS[0].frame(0);
    assert!(pose_between(&frame, &frame).is_some());
    let plain = exposed(&frame, 0.0, 128.0);
    assert!(Features::detect(&plain).all.is_empty());
    assert!(pose_between(&frame, &plain).is_none());
    for none in [0.0, f32::NAN, f32::INFINITY] {
        let mut blind = frame.clone();
        blind.depth_m.data_mut().fill(none);
        let features = Features::detect(&blind);
        assert!(!features.all.is_empty() && features.all.iter().all(|f| f.point.is_none()));
        assert!(pose_between(&blind, &frame).is_none());
    }
    for (width, height) in [(1, 1), (33, 1), (32, 40), (33, 33), (50, 34)] {
        let camera = Camera {
            width,
            height,
            ..frame.camera
        };
        let color = Image::from_fn(width, height, |u, v| [(91 * u * u + 57 * v * u) as u8; 3]);
        let depth_m = Image::filled(width, height, 1.0);
        let tiny = RgbdFrame::new(FrameIndex(0), 0.0, color, depth_m, camera).unwrap();
        assert!(pose_between(&tiny, &frame).is_none());
    }
}

#[test]
fn unseen_colours_give_no_features() {
    let mut frame = ROOMS[0].frame(0);
    let all = Features::detect(&frame).all.len();
    let valid = Image::from_fn(640, 480, |u, v| u >= 200 && v < 300);
    frame.color_valid = Some(Arc::new(valid));
    let seen = Features::detect(&frame).all;
    assert!(seen.len() >= all / 8, "{} of {all}", seen.len());
    for feature in &seen {
        // The patch is 16 pixels of its image to each side.
        let reach = 16.0 * feature.scale;
        assert!(feature.pixel.x - reach >= 198.0 && feature.pixel.y + reach <= 302.0);
    }
}

#[test]
fn the_same_frames_give_the_same_bits() {
    let (first, second) = (ROOMS[0].frame(0), ROOMS[0].frame(12));
    let features = Features::detect(&first);
    assert!(features.all.len() > 300 && features.all.len() <= 1000);
    assert_eq!(features.all, Features::detect(&first).all);
    assert_eq!(pose_between(&first, &second), pose_between(&first, &second));
}
