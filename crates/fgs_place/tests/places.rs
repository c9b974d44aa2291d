//! Places in synthetic rooms, found again.

#![allow(clippy::unwrap_used)] // Clippy's leave for tests stops at statics and helpers.

use std::sync::{Arc, LazyLock};
use std::time::Instant;

use fgs_geom::{Camera, Image, KeyframeId, RgbdFrame};
use fgs_place::{PlaceDescriptor, PlaceIndex, Similar};
use fgs_synth::{FRAMES_PER_LOOP, SensorModel, Sequence, kinect_camera};

/// Frames from one keyframe to the next.
const STEP: usize = FRAMES_PER_LOOP / 12;

/// A loop through one room, which all tests share: it takes a second to furnish.
static ROOM: LazyLock<Sequence> = LazyLock::new(|| room(1));

fn room(seed: u64) -> Sequence {
    let camera = kinect_camera(80, 60).unwrap();
    Sequence::new(seed, FRAMES_PER_LOOP, camera, SensorModel::exact())
}

/// Twelve keyframes round the room.
fn keyframes() -> PlaceIndex {
    let mut index = PlaceIndex::default();
    for i in 0..12 {
        let descriptor = PlaceDescriptor::new(&ROOM.frame(i * STEP));
        index.add(KeyframeId(i as u32), &descriptor);
    }
    index
}

/// For each keyframe the frame by a real sensor, three frames later.
fn frames_near_keyframes() -> Vec<RgbdFrame> {
    let room = ROOM.with_sensor(SensorModel::kinect());
    (0..12).map(|i| room.frame(i * STEP + 3)).collect()
}

fn exposed(frame: &RgbdFrame, gain: f32, offset: f32) -> RgbdFrame {
    let mut frame = frame.clone();
    frame.color = (frame.color).map(|rgb| rgb.map(|c| (gain * f32::from(c) + offset) as u8));
    frame
}

fn without_depth(frame: &RgbdFrame) -> RgbdFrame {
    let mut frame = frame.clone();
    frame.depth_m.data_mut().fill(f32::NAN);
    frame
}

/// The columns from `from` of a frame.
fn cropped(frame: &RgbdFrame, from: usize, width: usize) -> RgbdFrame {
    let height = frame.camera.height;
    let mut cropped = frame.clone();
    cropped.camera = kinect_camera(width, height).unwrap();
    cropped.color = Image::from_fn(width, height, |u, v| frame.color.at(from + u, v));
    cropped.depth_m = Image::from_fn(width, height, |u, v| frame.depth_m.at(from + u, v));
    cropped.check().unwrap();
    cropped
}

fn most_similar(index: &PlaceIndex, frame: &RgbdFrame) -> Similar {
    index.most_similar(&PlaceDescriptor::new(frame), 1)[0]
}

/// How similar two frames are.
fn similarity(a: &RgbdFrame, b: &RgbdFrame) -> f64 {
    let mut index = PlaceIndex::default();
    index.add(KeyframeId(0), &PlaceDescriptor::new(a));
    most_similar(&index, b).similarity
}

#[test]
fn a_place_is_found_whatever_the_exposure() {
    let (index, frames) = (keyframes(), frames_near_keyframes());
    for (gain, offset) in [(1.0, 0.0), (0.6, 0.0), (1.3, 0.0), (0.8, 40.0)] {
        for (i, frame) in frames.iter().enumerate() {
            let found = most_similar(&index, &exposed(frame, gain, offset));
            assert_eq!(
                found.id,
                KeyframeId(i as u32),
                "gain {gain}, offset {offset}"
            );
            assert!(
                found.similarity > 0.3,
                "{found:?}: gain {gain}, offset {offset}"
            );
        }
    }
}

#[test]
fn a_place_is_found_without_depth() {
    let (index, frames) = (keyframes(), frames_near_keyframes());
    for (i, frame) in frames.iter().enumerate() {
        let found = most_similar(&index, &without_depth(frame));
        assert_eq!(found.id, KeyframeId(i as u32));
        assert!(found.similarity > 0.3, "{found:?}");
    }
    let blind = without_depth(&frames[0]);
    assert!(similarity(&blind, &blind) > 0.9);
}

#[test]
fn depth_tells_places_apart_that_look_the_same() {
    let near = ROOM.frame(0);
    let mut far = near.clone();
    far.depth_m = far.depth_m.map(|depth_m| 2.0 * depth_m);
    assert!(similarity(&near, &near) > 0.9);
    assert!((0.4..0.8).contains(&similarity(&near, &far)));
}

#[test]
fn unrelated_rooms_are_not_similar() {
    let index = keyframes();
    let mut similarities = Vec::new();
    for strangers in [11, 12].map(room) {
        for i in 0..12 {
            let stranger = PlaceDescriptor::new(&strangers.frame(i * STEP));
            similarities.extend((index.most_similar(&stranger, 12).iter()).map(|s| s.similarity));
        }
    }
    let mean = similarities.iter().sum::<f64>() / similarities.len() as f64;
    let largest = similarities.iter().copied().fold(0.0, f64::max);
    assert!(mean < 0.05 && largest < 0.25, "{mean} {largest}");
}

#[test]
fn a_turned_camera_is_recognised_and_how_far() {
    let wide = ROOM.with_camera(kinect_camera(100, 60).unwrap());
    for i in [0, 40, 80] {
        let (keyframe, right) = (wide.frame(i), 12);
        let mut index = PlaceIndex::default();
        index.add(
            KeyframeId(0),
            &PlaceDescriptor::new(&cropped(&keyframe, 0, 80)),
        );
        let found = most_similar(&index, &cropped(&keyframe, right, 80));
        assert_eq!(found.shift, [-(right as f64) / 80.0, 0.0]);
        assert!(found.similarity > 0.3, "{found:?}");
    }
}

#[test]
fn the_resolution_does_not_matter() {
    let frame = ROOM.frame(0);
    let mut large = frame.clone();
    large.camera = kinect_camera(160, 120).unwrap();
    large.color = Image::from_fn(160, 120, |u, v| frame.color.at(u / 2, v / 2));
    large.depth_m = Image::from_fn(160, 120, |u, v| frame.depth_m.at(u / 2, v / 2));
    assert_eq!(PlaceDescriptor::new(&frame), PlaceDescriptor::new(&large));
}

#[test]
fn what_the_camera_did_not_see_does_not_matter() {
    let frame = ROOM.frame(0);
    let seen = Arc::new(Image::from_fn(80, 60, |u, _| u < 50));
    let mut other = frame.clone();
    for v in 0..60 {
        (50..80).for_each(|u| other.color.set(u, v, [(u + v) as u8; 3]));
    }
    let [frame, other] = [frame, other].map(|frame| frame.with_color_valid(seen.clone()).unwrap());
    assert_eq!(PlaceDescriptor::new(&frame), PlaceDescriptor::new(&other));
    assert!(similarity(&frame, &ROOM.frame(0)) > 0.4);
}

#[test]
fn frames_that_show_nothing_are_similar_to_nothing() {
    let frame = ROOM.frame(0);
    let unseen = Arc::new(Image::filled(80, 60, false));
    let mut nothing = vec![
        frame.clone().with_color_valid(unseen).unwrap(),
        exposed(&frame, 0.0, 255.0),
    ];
    for (width, height) in [(1, 1), (2, 1), (1, 300)] {
        let camera = Camera {
            width,
            height,
            ..frame.camera
        };
        let mut tiny = frame.clone();
        tiny.camera = camera;
        tiny.color = Image::filled(width, height, [90, 120, 7]);
        tiny.depth_m = Image::filled(width, height, 1.5);
        tiny.check().unwrap();
        nothing.push(tiny);
    }
    for blank in &nothing {
        assert_eq!(similarity(blank, blank), 0.0);
        assert_eq!(similarity(blank, &frame), 0.0);
        assert_eq!(similarity(&frame, blank), 0.0);
    }
}

#[test]
fn extreme_depths_do_no_harm() {
    let mut frame = ROOM.frame(0);
    for (i, depth_m) in frame.depth_m.data_mut().iter_mut().enumerate() {
        *depth_m = [f32::MAX, f32::MIN_POSITIVE, f32::INFINITY, f32::NAN][i % 4];
    }
    assert!(similarity(&frame, &frame) > 0.9);
}

#[test]
fn a_thousand_keyframes_are_compared_quickly() {
    let descriptor = PlaceDescriptor::new(&ROOM.frame(0));
    let mut index = PlaceIndex::default();
    for id in 0..1000 {
        index.add(KeyframeId(id), &descriptor);
    }
    let start = Instant::now();
    let found = index.most_similar(&descriptor, 5);
    // A few milliseconds: far below what a busy machine could make of them.
    assert!(start.elapsed().as_secs_f64() < 0.5);
    assert!(
        found.iter().map(|s| s.id.0).eq(0..5),
        "of equals, the older first"
    );
}
