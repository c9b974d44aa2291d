//! Readers of other programs' recordings.

use std::fs;
use std::path::Path;

use fgs_data::OpenOptions;
use image::{ImageBuffer, Luma, RgbImage};

use crate::readers::in_folder;

/// The files of small recordings of one frame: a byte string of [`phone`] replaces one of them.
const FILES: [(&str, &str, &[u8]); 14] = [
    (
        "record3d",
        "metadata",
        br#"{"w": 8, "h": 6, "dw": 4, "dh": 3, "fps": 30, "K": [8, 0, 0, 0, 8, 0, 3.5, 2.5, 1],
            "poses": [[0, 0, 0, 1, 0, 0, 0]], "perFrameIntrinsicCoeffs": [[8, 8, 3.5, 2.5]],
            "frameTimestamps": [0.5]}"#,
    ),
    ("record3d", "rgbd/0.depth", &[1; 48]),
    ("record3d", "rgbd/0.conf", &[1; 12]),
    (
        "stray",
        "odometry.csv",
        b"timestamp, frame, x, y, z, qx, qy, qz, qw\n0.5, 000000, 0, 0, 0, 0, 0, 0, 1\n",
    ),
    ("stray", "camera_matrix.csv", b"8, 0, 3.5\n0, 8, 2.5\n0, 0, 1\n"),
    ("stray", "confidence/000000.png", b""),
    (
        "polycam",
        "keyframes/cameras/500000.json",
        br#"{"fx": 8, "fy": 8, "cx": 3.5, "cy": 2.5, "width": 8, "height": 6, "t_00": 1, "t_01": 0,
            "t_02": 0, "t_03": 0, "t_10": 0, "t_11": 1, "t_12": 0, "t_13": 0, "t_20": 0, "t_21": 0,
            "t_22": 1, "t_23": 0}"#,
    ),
    ("polycam", "keyframes/confidence/500000.png", b""),
    (
        "nerfstudio",
        "transforms.json",
        br#"{"w": 8, "h": 6, "fl_x": 8, "fl_y": 8, "cx": 4, "cy": 3, "frames": [{"file_path": "0.png",
            "depth_file_path": "1.png", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0],
            [0, 0, 0, 1]]}]}"#,
    ),
    ("record3d", "rgbd/0.jpg", b""),
    (
        "colmap",
        "sparse/0/cameras.txt",
        b"1 OPENCV 8 6 8 8 4 3 0.01 0 0 0\n",
    ),
    (
        "colmap",
        "sparse/0/images.txt",
        b"1 1 0 0 0 0 0 0 1 0.png\n\n",
    ),
    ("colmap", "sparse/0/cameras.bin", b""),
    ("colmap", "sparse/0/images.bin", b""),
];

/// Images of 8x6 and depth of 4x3 pixels.
const IMAGES: [(&str, &str, &str); 5] = [
    ("record3d", "rgbd/0.jpg", ""),
    ("stray", "rgb/000000.png", "depth/000000.png"),
    (
        "polycam",
        "keyframes/images/500000.jpg",
        "keyframes/depth/500000.png",
    ),
    ("nerfstudio", "0.png", "1.png"),
    ("colmap", "images/0.png", "depth/0.png"),
];

fn write_all(folder: &Path) {
    let file = |kind: &str, name: &str| {
        let path = folder.join(kind).join(name);
        fs::create_dir_all(path.parent().unwrap_or(folder)).unwrap();
        path
    };
    for (kind, color, depth) in IMAGES {
        RgbImage::new(8, 6).save(file(kind, color)).unwrap();
        if !depth.is_empty() {
            let image = ImageBuffer::<Luma<u16>, Vec<u16>>::from_pixel(4, 3, Luma([2000]));
            image.save(file(kind, depth)).unwrap();
        }
    }
    for (kind, name, bytes) in FILES {
        if !bytes.is_empty() {
            fs::write(file(kind, name), bytes).unwrap();
        }
    }
}

/// Opens what is there and reads its first frame.
fn open(path: &Path) {
    match fgs_recordings::open(path, &OpenOptions::default()) {
        Ok(dataset) => {
            let _ = dataset.ground_truth_error().map(ToString::to_string);
            if let Ok(frame) = dataset.frame(0) {
                frame.check().unwrap();
            }
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// One file of a phone's recording or a nerfstudio folder: the first byte says which.
pub fn phone(bytes: &[u8]) {
    let Some((which, bytes)) = bytes.split_first() else {
        return;
    };
    let (kind, name, _) = FILES[usize::from(*which) % FILES.len()];
    in_folder(write_all, "phone", |folder| {
        let path = folder.join(kind).join(name);
        fs::create_dir_all(path.parent().unwrap_or(folder)).unwrap();
        let before = fs::read(&path).ok();
        fs::write(&path, bytes).unwrap();
        open(&folder.join(kind));
        match before {
            Some(before) => fs::write(&path, before).unwrap(),
            None => fs::remove_file(&path).unwrap(),
        }
    });
}

/// A ZIP archive of a recording.
pub fn archive(bytes: &[u8]) {
    open_file("walk.r3d", bytes);
}

/// A ROS 2 bag.
pub fn bag(bytes: &[u8]) {
    open_file("walk.mcap", bytes);
}

fn open_file(name: &'static str, bytes: &[u8]) {
    in_folder(
        |_| (),
        name,
        |folder| {
            let path = folder.join(name);
            fs::write(&path, bytes).unwrap();
            open(&path);
        },
    );
}
