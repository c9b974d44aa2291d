//! Whole recordings in each layout come out as they went in.

#![allow(clippy::unwrap_used)]

mod common;

use std::fs;
use std::path::Path;
use std::sync::Arc;

use common::*;
use fgs_data::{CameraFile, DataError, Dataset, Format, OpenOptions};
use fgs_geom::RgbdFrame;

fn open(path: &Path) -> Result<Dataset, DataError> {
    Dataset::open(path, &OpenOptions::default())
}

/// Colour and depth of a frame made by [`color`] and [`depth`] number `index`.
fn assert_frame_is(frame: &RgbdFrame, index: usize, color_tolerance: u8) {
    assert_eq!((frame.color.width(), frame.color.height()), (24, 16));
    let (made_color, made_depth) = (color(index), depth(index));
    for v in 0..16 {
        for u in 0..24 {
            let made = made_color.get_pixel(u as u32, v as u32).0;
            for (channel, value) in frame.color.at(u, v).iter().enumerate() {
                assert!(
                    made[channel].abs_diff(*value) <= color_tolerance,
                    "({u}, {v}) {channel}"
                );
            }
            let made = f64::from(made_depth.get_pixel(u as u32, v as u32).0[0]) / DEPTH_SCALE;
            let read = f64::from(frame.depth_m.at(u, v));
            if (u, v) != (4, 2) {
                assert!((read - made).abs() <= 1e-6, "({u}, {v}) {read} {made}");
            }
        }
    }
    assert_eq!(frame.depth_m.at(3, 2), 0.0);
}

fn assert_poses(dataset: &Dataset, start_secs: f64, without: &[usize]) {
    let poses = dataset.ground_truth().unwrap();
    assert_eq!(poses.poses().len(), dataset.len() - without.len());
    for (index, secs) in dataset.timestamps().enumerate() {
        match poses.at(secs) {
            Some(pose) => {
                let error = pose.inverse() * pose_at(secs - start_secs);
                assert!(error.log().amax() <= 1e-9, "frame {index}: {}", error.log());
            }
            None => assert!(without.contains(&index), "frame {index} has no pose"),
        }
    }
}

#[test]
fn tum_pairs_by_time_and_interpolates_poses() {
    let folder = tum(4);
    // Depth 2 was never taken: colour 2 has no partner.
    let list = fs::read_to_string(folder.path().join("depth.txt")).unwrap();
    let kept: Vec<_> = list
        .lines()
        .filter(|line| !line.ends_with("/2.png"))
        .collect();
    fs::write(folder.path().join("depth.txt"), kept.join("\n")).unwrap();
    let dataset = open(folder.path()).unwrap();
    assert_eq!(dataset.format(), Format::Tum);
    let times: Vec<_> = dataset.timestamps().collect();
    assert_eq!(times, [100.0, 100.033333, 100.1]);
    let camera = dataset.camera();
    assert_eq!(
        (camera.width, camera.height, camera.intrinsics.cy),
        (24, 16, 6.25)
    );
    for (position, made) in [0, 1, 3].into_iter().enumerate() {
        let frame = dataset.frame(position).unwrap();
        assert_eq!(
            (frame.index.0, frame.timestamp_secs),
            (position, times[position])
        );
        assert_frame_is(&frame, made, 0);
        assert_eq!(frame.depth_m.at(4, 2), 65535.0 / 5000.0);
    }
    assert_poses(&dataset, 100.0, &[]);
    let strict = OpenOptions {
        max_time_difference_secs: 0.01,
        ..OpenOptions::default()
    };
    assert!(matches!(
        Dataset::open(folder.path(), &strict),
        Err(DataError::NoOverlap { .. })
    ));
}

#[test]
fn tum_poses_reach_only_as_far_as_they_were_recorded() {
    let folder = tum(4);
    let path = folder.path().join("groundtruth.txt");
    let poses = fs::read_to_string(&path).unwrap();
    // Recorded until 100.065 s: frames 2 and 3 come later.
    let kept: Vec<_> = poses.lines().take(10).collect();
    fs::write(&path, kept.join("\n")).unwrap();
    assert_poses(&open(folder.path()).unwrap(), 100.0, &[2, 3]);
    fs::remove_file(&path).unwrap();
    assert_eq!(open(folder.path()).unwrap().ground_truth(), None);
}

#[test]
fn tum_with_associations_only() {
    let folder = tum(2);
    fs::remove_file(folder.path().join("rgb.txt")).unwrap();
    let associations = "100 rgb/1.png 100.5 depth/0.png\n100.1 rgb/0.png 100.1 depth/1.png\n";
    fs::write(folder.path().join("associations.txt"), associations).unwrap();
    let dataset = open(folder.path()).unwrap();
    assert_eq!(dataset.timestamps().collect::<Vec<_>>(), [100.0, 100.1]);
    let frame = dataset.frame(0).unwrap();
    assert_eq!(frame.color.at(0, 0)[2], 20, "colour of frame 1");
    assert!(
        (frame.depth_m.at(0, 0) - 1.0).abs() <= 1e-6,
        "depth of frame 0"
    );
}

#[test]
fn replica_with_its_camera_above_or_inside() {
    let folder = replica(3);
    let room = folder.path().join("room");
    let dataset = open(&room).unwrap();
    assert_eq!((dataset.format(), dataset.len()), (Format::Replica, 3));
    assert_poses(&dataset, 0.0, &[]);
    for i in 0..3 {
        let frame = dataset.frame(i).unwrap();
        assert_eq!(frame.timestamp_secs, i as f64 / 30.0);
        assert_frame_is(&frame, i, 8);
    }
    let camera = folder.path().join("cam_params.json");
    fs::rename(&camera, room.join("cam_params.json")).unwrap();
    assert_eq!(open(&room).unwrap().camera(), dataset.camera());
}

#[test]
fn seven_scenes_with_its_mark_for_no_depth() {
    let folder = seven_scenes(3);
    let dataset = open(folder.path()).unwrap();
    assert_eq!((dataset.format(), dataset.len()), (Format::SevenScenes, 3));
    assert_poses(&dataset, 0.0, &[1]);
    for i in 0..3 {
        let frame = dataset.frame(i).unwrap();
        assert_frame_is(&frame, i, 0);
        assert_eq!(frame.depth_m.at(4, 2), 0.0);
    }
}

#[test]
fn folders_in_the_order_of_their_numbers() {
    let folder = folders(4);
    let dataset = open(folder.path()).unwrap();
    assert_eq!((dataset.format(), dataset.len()), (Format::Folders, 4));
    assert_eq!(dataset.ground_truth(), None);
    for (i, frame) in dataset.frames(0..4).enumerate() {
        assert_frame_is(&frame.unwrap(), i, 0);
    }
    let matrices: String = (0..4)
        .map(|i| matrix_lines(&pose_at(i as f64 / 30.0), 16))
        .collect();
    fs::write(folder.path().join("traj.txt"), matrices).unwrap();
    assert_poses(&open(folder.path()).unwrap(), 0.0, &[]);
    fs::remove_file(folder.path().join("traj.txt")).unwrap();
    let lines: String = (0..3)
        .map(|i| {
            format!(
                "{} {}\n",
                i as f64 / 30.0,
                tum_pose(&pose_at(i as f64 / 30.0))
            )
        })
        .collect();
    fs::write(folder.path().join("groundtruth.txt"), lines).unwrap();
    assert_poses(&open(folder.path()).unwrap(), 0.0, &[3]);
}

#[test]
fn the_users_camera_comes_before_the_folders_and_that_before_replicas() {
    let folder = replica(1);
    let room = folder.path().join("room");
    let fx = |options: &OpenOptions| {
        let dataset = Dataset::open(&room, options).unwrap();
        dataset.camera().intrinsics.fx
    };
    assert_eq!(fx(&OpenOptions::default()), 20.0);
    let with_fx = |fx: &str| CAMERA.replace("fx = 20.0", &format!("fx = {fx}"));
    fs::write(room.join("camera.toml"), with_fx("22.0")).unwrap();
    assert_eq!(fx(&OpenOptions::default()), 22.0);
    let camera = CameraFile::parse(&with_fx("23.0"), Path::new("mine.toml")).unwrap();
    let options = OpenOptions {
        camera: Some(camera),
        ..OpenOptions::default()
    };
    assert_eq!(fx(&options), 23.0);
}

#[test]
fn grey_becomes_colour_and_alpha_is_dropped() {
    let folder = tum(2);
    let grey = image::DynamicImage::from(color(0)).to_luma8();
    grey.save(folder.path().join("rgb/0.png")).unwrap();
    let mut transparent = image::DynamicImage::from(color(1)).to_rgba8();
    transparent.pixels_mut().for_each(|pixel| pixel.0[3] = 7);
    transparent.save(folder.path().join("rgb/1.png")).unwrap();
    let dataset = open(folder.path()).unwrap();
    let frame = dataset.frame(0).unwrap();
    assert_eq!(frame.color.at(9, 5), [grey.get_pixel(9, 5).0[0]; 3]);
    assert_frame_is(&dataset.frame(1).unwrap(), 1, 0);
}

#[test]
fn lens_distortion_is_removed() {
    let folder = tum(1);
    let raw = open(folder.path()).unwrap().frame(0).unwrap();
    let lens = format!("{CAMERA}distortion = [0.3, -0.2, 0.01, -0.02, 0.1]\n");
    fs::write(folder.path().join("camera.toml"), &lens).unwrap();
    let frame = open(folder.path()).unwrap().frame(0).unwrap();
    let file = CameraFile::parse(&lens, Path::new("camera.toml")).unwrap();
    let map = file.distortion().unwrap().undistortion(file.camera());
    assert_ne!(frame.color, raw.color);
    assert_ne!(frame.depth_m, raw.depth_m);
    let valid = map.color_valid();
    assert!(valid.data().contains(&true) && valid.data().contains(&false));
    assert_eq!(frame.color_valid.as_deref(), Some(&valid));
    assert_eq!(raw.color_valid, None);
    assert_eq!(Some(frame.color), map.color(&raw.color));
    assert_eq!(Some(frame.depth_m), map.depth(&raw.depth_m));
}

#[test]
fn the_frames_of_a_recording_share_one_mask() {
    let folder = tum(3);
    let with_lens = |lens: &str| {
        let text = format!("{CAMERA}distortion = {lens}\n");
        fs::write(folder.path().join("camera.toml"), text).unwrap();
        let dataset = open(folder.path()).unwrap();
        let frames: Vec<_> = dataset.frames(0..3).map(Result::unwrap).collect();
        frames
    };
    let frames = with_lens("[0.3, -0.2, 0.01, -0.02, 0.1]");
    let first = frames[0].color_valid.as_ref().unwrap();
    for frame in &frames {
        assert!(Arc::ptr_eq(frame.color_valid.as_ref().unwrap(), first));
    }
    // A lens that only draws the image together shows every pixel.
    let frames = with_lens("[-0.3, 0.0, 0.0, 0.0, 0.0]");
    assert!(frames.iter().all(|frame| frame.color_valid.is_none()));
}

/// Times of two sensors differ; numbers of frames do not.
#[test]
fn folders_pair_times_by_order() {
    let folder = tum(3);
    for name in ["rgb.txt", "depth.txt"] {
        fs::remove_file(folder.path().join(name)).unwrap();
    }
    for (kind, offset) in [("rgb", 101), ("depth", 105)] {
        for index in 0..3 {
            let place = folder.path().join(kind);
            let name = format!("1305031102.{}.png", offset + 33 * index);
            fs::rename(place.join(format!("{index}.png")), place.join(name)).unwrap();
        }
    }
    fs::remove_file(folder.path().join("groundtruth.txt")).unwrap();
    assert_eq!(open(folder.path()).unwrap().len(), 3);
}
