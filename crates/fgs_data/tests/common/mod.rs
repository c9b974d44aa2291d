//! Small recordings in each layout, written without the crate under test.

// Each test file uses its own part of this.
#![allow(dead_code)]
#![allow(clippy::unwrap_used)]

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use fgs_geom::Se3;
use image::{ImageBuffer, Luma, Rgb, RgbImage};
use nalgebra::Vector6;
use tempfile::TempDir;

pub const WIDTH: u32 = 24;
pub const HEIGHT: u32 = 16;
pub const DEPTH_SCALE: f64 = 5000.0;
pub const CAMERA: &str =
    "width = 24\nheight = 16\nfx = 20.0\nfy = 21.0\ncx = 12.5\ncy = 6.25\ndepth_scale = 5000\n";

pub type DepthImage = ImageBuffer<Luma<u16>, Vec<u16>>;

/// Smooth, so that JPEG keeps it; another one for each frame.
pub fn color(index: usize) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |u, v| {
        Rgb([5 * u as u8, 9 * v as u8, 20 * (index % 12) as u8])
    })
}

/// Two pixels of row 2 are special: column 3 is 0, column 4 the largest value.
pub fn depth(index: usize) -> DepthImage {
    DepthImage::from_fn(WIDTH, HEIGHT, |u, v| {
        Luma([match (u, v) {
            (3, 2) => 0,
            (4, 2) => u16::MAX,
            _ => 5000 + (100 * index as u16) + (10 * u + v) as u16,
        }])
    })
}

/// A screw about an oblique axis: interpolation along it is exact.
pub fn pose_at(secs: f64) -> Se3 {
    let start = Se3::exp(&Vector6::new(0.3, -0.2, 0.5, 1.0, -2.0, 0.5));
    start * Se3::exp(&(Vector6::new(0.4, 0.3, -0.6, 0.2, 0.1, -0.3) * secs))
}

/// `tx ty tz qx qy qz qw`.
pub fn tum_pose(pose: &Se3) -> String {
    let (t, q) = (pose.translation, pose.rotation);
    format!("{} {} {} {} {} {} {}", t.x, t.y, t.z, q.i, q.j, q.k, q.w)
}

/// Sixteen numbers, `columns` of them a line.
pub fn matrix_lines(pose: &Se3, columns: usize) -> String {
    let numbers: Vec<_> = pose
        .matrix()
        .transpose()
        .iter()
        .map(f64::to_string)
        .collect();
    let lines: Vec<_> = numbers.chunks(columns).map(|line| line.join(" ")).collect();
    lines.join("\n") + "\n"
}

pub fn save_color(path: &Path, index: usize) {
    color(index).save(path).unwrap();
}

pub fn save_depth(path: &Path, index: usize) {
    depth(index).save(path).unwrap();
}

/// Colour at 100 s + i / 30 s, depth 11 ms later, poses at 100 Hz from before to after.
pub fn tum(frames: usize) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    fs::create_dir_all(root.join("rgb")).unwrap();
    fs::create_dir_all(root.join("depth")).unwrap();
    let (mut rgb, mut depth) = ("# colour\n".to_string(), "# depth\n".to_string());
    for i in 0..frames {
        let secs = 100.0 + i as f64 / 30.0;
        save_color(&root.join(format!("rgb/{i}.png")), i);
        save_depth(&root.join(format!("depth/{i}.png")), i);
        writeln!(rgb, "{secs:.6} rgb/{i}.png").unwrap();
        writeln!(depth, "{:.6} depth/{i}.png", secs + 0.011).unwrap();
    }
    let mut poses = "# timestamp tx ty tz qx qy qz qw\n".to_string();
    for i in 0..frames * 4 + 4 {
        let secs = -0.015 + i as f64 * 0.01;
        writeln!(poses, "{} {}", 100.0 + secs, tum_pose(&pose_at(secs))).unwrap();
    }
    fs::write(root.join("rgb.txt"), rgb).unwrap();
    fs::write(root.join("depth.txt"), depth).unwrap();
    fs::write(root.join("groundtruth.txt"), poses).unwrap();
    fs::write(root.join("camera.toml"), CAMERA).unwrap();
    folder
}

/// A room in a folder, with `cam_params.json` above it.
pub fn replica(frames: usize) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let results = folder.path().join("room/results");
    fs::create_dir_all(&results).unwrap();
    let mut poses = String::new();
    for i in 0..frames {
        save_color(&results.join(format!("frame{i:06}.jpg")), i);
        save_depth(&results.join(format!("depth{i:06}.png")), i);
        poses += &matrix_lines(&pose_at(i as f64 / 30.0), 16);
    }
    fs::write(folder.path().join("room/traj.txt"), poses).unwrap();
    let camera = r#"{"camera": {"w": 24, "h": 16, "fx": 20.0, "fy": 21.0, "cx": 12.5, "cy": 6.25, "scale": 5000.0}}"#;
    fs::write(folder.path().join("cam_params.json"), camera).unwrap();
    folder
}

/// Frame 1 has no pose.
pub fn seven_scenes(frames: usize) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for i in 0..frames {
        let path = |kind: &str| folder.path().join(format!("frame-{i:06}.{kind}"));
        save_color(&path("color.png"), i);
        save_depth(&path("depth.png"), i);
        if i != 1 {
            fs::write(path("pose.txt"), matrix_lines(&pose_at(i as f64 / 30.0), 4)).unwrap();
        }
    }
    fs::write(folder.path().join("camera.toml"), CAMERA).unwrap();
    folder
}

/// Names whose order as text (`10` before `9`) is not their order.
pub fn folders(frames: usize) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir_all(folder.path().join("images")).unwrap();
    fs::create_dir_all(folder.path().join("depth")).unwrap();
    for i in 0..frames {
        let number = i + 8;
        save_color(&folder.path().join(format!("images/{number}.png")), i);
        save_depth(&folder.path().join(format!("depth/d_{number}.png")), i);
    }
    fs::write(folder.path().join("camera.toml"), CAMERA).unwrap();
    folder
}
