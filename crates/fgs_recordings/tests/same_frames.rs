//! Each format gives the frames that were put into it, and those of a plain folder of the same images.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::path::Path;

use common::bag::Transport;
use common::{FRAMES, Walk};
use fgs_data::{Dataset, Format, OpenOptions, PoseOrigin};

fn open(path: &Path) -> Dataset {
    fgs_recordings::open(path, &OpenOptions::default()).unwrap()
}

/// Writes the walk plainly and otherwise, and compares all that is read of both.
fn compare(format: Format, name: &str, write: fn(&Walk, &Path)) {
    let folder = tempfile::tempdir().unwrap();
    let walk = Walk::new();
    let (plain, other) = (folder.path().join("plain"), folder.path().join(name));
    walk.write_plain(&plain);
    write(&walk, &other);
    let (plain, other) = (open(&plain), open(&other));
    assert_eq!((plain.format(), other.format()), (Format::Tum, format));
    assert_eq!(plain.camera(), other.camera());
    assert_eq!(other.len(), FRAMES);
    let origin = |dataset: &Dataset| dataset.pose_origin();
    assert_eq!(origin(&plain), PoseOrigin::GroundTruth);
    assert_eq!(origin(&other), PoseOrigin::Device);
    assert!(other.ground_truth_error().is_none());
    let poses = |dataset: &Dataset| dataset.ground_truth().map(|poses| poses.poses().to_vec());
    let (expected, poses) = (poses(&plain).unwrap(), poses(&other).unwrap_or_default());
    // Photographs have no times.
    let has_times = ![Format::Nerfstudio, Format::Colmap].contains(&format);
    let known = if format == Format::Mcap { 0 } else { FRAMES };
    assert_eq!(poses.len(), known);
    for (expected, pose) in expected.iter().zip(&poses) {
        assert!(!has_times || expected.timestamp_secs == pose.timestamp_secs);
        let difference = expected.world_from_camera.inverse() * pose.world_from_camera;
        assert!(difference.log().norm() < 1e-9, "{difference:?}");
    }
    for index in 0..FRAMES {
        let (a, b) = (plain.frame(index).unwrap(), other.frame(index).unwrap());
        assert!(!has_times || a.timestamp_secs == b.timestamp_secs);
        assert_eq!(a.color.data(), b.color.data(), "{index}");
        assert_eq!(a.depth_m.data(), b.depth_m.data(), "{index}");
        assert!(a.color_valid.is_none() && b.color_valid.is_none());
    }
}

#[test]
fn record3d() {
    compare(Format::Record3d, "walk.r3d", Walk::write_record3d);
}

#[test]
fn stray_scanner() {
    compare(Format::StrayScanner, "walk", Walk::write_stray);
}

#[test]
fn polycam() {
    compare(Format::Polycam, "walk", Walk::write_polycam);
}

#[test]
fn nerfstudio() {
    compare(Format::Nerfstudio, "walk", Walk::write_nerfstudio);
}

#[test]
fn colmap() {
    compare(Format::Colmap, "walk", |walk, folder| {
        walk.write_colmap(folder, true)
    });
    compare(Format::Colmap, "walk", |walk, folder| {
        walk.write_colmap(folder, false)
    });
}

#[test]
fn bags() {
    compare(Format::Mcap, "walk.mcap", |walk, path| {
        walk.write_bag(path, Transport::JpegAndRaw);
    });
    compare(Format::Mcap, "walk.bag", |walk, path| {
        walk.write_bag(path, Transport::RawBigEndian);
    });
    compare(Format::Mcap, "walk", |walk, path| {
        walk.write_bag(path, Transport::RawAndPng);
    });
}

/// A recorder starts another file when one is full; the tenth comes after the second.
#[test]
fn bags_in_parts() {
    compare(Format::Mcap, "walk", |walk, folder| {
        std::fs::create_dir(folder).unwrap();
        for (part, frames) in [(0, 0..5), (2, 5..6), (10, 6..FRAMES)] {
            let path = folder.join(format!("walk_{part}.mcap"));
            walk.write_bag_of(&path, Transport::JpegAndRaw, frames);
        }
    });
}
