//! Recordings on disk: the files, their contents, and that no partial recording stays behind.

#![allow(clippy::unwrap_used)] // Clippy's leave for tests stops at statics and helpers.

use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use fgs_synth::{SensorModel, Sequence, SynthError, kinect_camera, write_replica, write_tum};

static SEQUENCE: LazyLock<Sequence> = LazyLock::new(|| {
    let camera = kinect_camera(40, 30).unwrap();
    Sequence::new(3, 3, camera, SensorModel::exact())
});

fn go_on(_: usize) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// All files under a folder, as sorted relative paths.
fn files(dir: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![PathBuf::new()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(dir.join(&folder)).unwrap() {
            let name = folder.join(entry.unwrap().file_name());
            if dir.join(&name).is_dir() {
                folders.push(name);
            } else {
                found.push(name.to_string_lossy().into_owned());
            }
        }
    }
    found.sort();
    found
}

/// Asserts that the depth file holds the frame's depth, rounded to the nearest unit.
fn check_depth(path: &Path, index: usize, scale: f64) {
    let units = image::open(path).unwrap().into_luma16();
    let depth = SEQUENCE.frame(index).depth_m;
    assert_eq!(units.dimensions(), (40, 30));
    for (units, depth) in units.as_raw().iter().zip(depth.data()) {
        assert!((f64::from(*units) - f64::from(*depth) * scale).abs() <= 0.501);
    }
}

fn numbers(line: &str) -> Vec<f64> {
    line.split(' ').map(|word| word.parse().unwrap()).collect()
}

#[test]
fn tum_layout() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("room");
    let mut told = Vec::new();
    let progress = |frames| {
        told.push(frames);
        ControlFlow::Continue(())
    };
    write_tum(&SEQUENCE, &dir, progress).unwrap();
    assert_eq!(told, [1, 2, 3]);
    let stamps = ["0.000000", "0.033333", "0.066667"];
    let mut expected: Vec<String> = ["camera.toml", "depth.txt", "groundtruth.txt", "rgb.txt"]
        .map(String::from)
        .to_vec();
    for stamp in stamps {
        expected.extend([format!("rgb/{stamp}.png"), format!("depth/{stamp}.png")]);
    }
    expected.sort();
    assert_eq!(files(&dir), expected);
    assert_eq!(
        files(parent.path()).len(),
        expected.len(),
        "nothing beside it"
    );

    let color = image::open(dir.join("rgb/0.033333.png"))
        .unwrap()
        .into_rgb8();
    assert_eq!(
        color.as_raw().as_slice(),
        SEQUENCE.frame(1).color.data().as_flattened()
    );
    check_depth(&dir.join("depth/0.033333.png"), 1, 5000.0);
    let text = |name: &str| fs::read_to_string(dir.join(name)).unwrap();
    assert!(text("rgb.txt").ends_with("0.066667 rgb/0.066667.png\n"));
    assert!(text("depth.txt").ends_with("0.066667 depth/0.066667.png\n"));
    assert!(text("camera.toml").contains("width = 40\nheight = 30\nfx = 32.8125\n"));
    assert!(text("camera.toml").contains("depth_scale = 5000.0\n"));
    let poses = text("groundtruth.txt");
    let n = numbers(poses.lines().nth(3).unwrap());
    let pose = fgs_geom::Se3::from_wxyz([n[7], n[4], n[5], n[6]], [n[1], n[2], n[3]]).unwrap();
    let error = pose.inverse() * SEQUENCE.world_from_camera(1);
    assert!(error.log().amax() <= 1e-8);
}

#[test]
fn replica_layout() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("room");
    write_replica(&SEQUENCE, &dir, go_on).unwrap();
    let mut expected = vec!["camera.toml".to_string(), "traj.txt".to_string()];
    for i in 0..3 {
        expected.extend([
            format!("results/frame{i:06}.jpg"),
            format!("results/depth{i:06}.png"),
        ]);
    }
    expected.sort();
    assert_eq!(files(&dir), expected);

    let color = image::open(dir.join("results/frame000002.jpg"))
        .unwrap()
        .into_rgb8();
    let truth = SEQUENCE.frame(2).color;
    let differences = (color.as_raw().iter().zip(truth.data().as_flattened()))
        .map(|(a, b)| f64::from(a.abs_diff(*b)));
    assert!(differences.sum::<f64>() / color.as_raw().len() as f64 <= 8.0);
    check_depth(&dir.join("results/depth000002.png"), 2, 6553.5);
    let trajectory = fs::read_to_string(dir.join("traj.txt")).unwrap();
    let row_major = numbers(trajectory.lines().nth(2).unwrap());
    let matrix = nalgebra::Matrix4::from_row_slice(&row_major);
    assert!((matrix - SEQUENCE.world_from_camera(2).matrix()).amax() <= 1e-8);
}

#[test]
fn existing_folders_are_left_alone() {
    let parent = tempfile::tempdir().unwrap();
    let error = write_tum(&SEQUENCE, parent.path(), go_on).unwrap_err();
    assert!(matches!(error, SynthError::Exists { .. }), "{error}");
    assert!(
        error
            .to_string()
            .contains(&*parent.path().to_string_lossy())
    );
    let error = write_replica(&SEQUENCE, Path::new(".."), go_on).unwrap_err();
    assert!(matches!(error, SynthError::Exists { .. }), "{error}");
}

#[test]
fn nothing_stays_of_a_stopped_or_failed_recording() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("room");
    let stop = |frames| {
        assert_eq!(
            fs::read_dir(parent.path()).unwrap().count(),
            2,
            "work goes on beside it, under a lock"
        );
        if frames == 2 {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    };
    let error = write_replica(&SEQUENCE, &dir, stop).unwrap_err();
    assert!(
        matches!(error, SynthError::Stopped { frames: 2 }),
        "{error}"
    );
    assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);

    // The folder is deleted while the export is running.
    let sabotage = |_| {
        for entry in fs::read_dir(parent.path()).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                fs::remove_dir_all(path).unwrap();
            }
        }
        ControlFlow::Continue(())
    };
    let error = write_tum(&SEQUENCE, &dir, sabotage).unwrap_err();
    assert!(matches!(&error, SynthError::Io { path, .. } if path.ends_with("rgb/0.033333.png")));
    assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);

    let missing = parent.path().join("missing").join("room");
    let error = write_tum(&SEQUENCE, &missing, go_on).unwrap_err();
    assert!(matches!(error, SynthError::Io { .. }), "{error}");
    assert!(error.to_string().contains("missing"), "{error}");
}
