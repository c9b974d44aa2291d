//! Masks of the Fourier segmentation against those of OpenCV and NumPy.
//!
//! `tests/golden/frequency` holds drawn images with their masks and the script that made both.

#![allow(clippy::print_stdout, reason = "a test prints")]
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

use fgs_geom::Image;
use fgs_slam::frequency::{FrequencySegmenter, FrequencySettings};

/// Single precision moves a pixel across the threshold now and then.
const MIN_IOU: f64 = 0.995;

fn read_gray(path: &Path) -> Image<u8> {
    let image = image::open(path).unwrap().into_luma8();
    let (width, height) = image.dimensions();
    Image::new(width as usize, height as usize, image.into_raw()).unwrap()
}

fn intersection_over_union(a: &Image<bool>, b: &Image<u8>) -> f64 {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let count = |both: fn(bool, bool) -> bool| {
        let pairs = a.data().iter().zip(b.data());
        pairs.filter(|&(&a, &b)| both(a, b > 0)).count() as f64
    };
    count(|a, b| a && b) / count(|a, b| a || b)
}

/// Compares every `gray_NAME.png` of a folder with its masks; returns how many masks there were.
fn compare_folder(folder: &Path) -> usize {
    let mut compared = 0;
    for entry in folder.read_dir().unwrap() {
        let file = entry.unwrap().file_name().into_string().unwrap();
        let Some(name) = file.strip_prefix("gray_") else {
            continue;
        };
        let gray = read_gray(&folder.join(&file));
        for (kind, clahe) in [("plain", false), ("clahe", true)] {
            let mask_path = folder.join(format!("mask_{kind}_{name}"));
            if mask_path.exists() {
                let settings = FrequencySettings { clahe };
                let mask = FrequencySegmenter::new(gray.width(), gray.height(), settings)
                    .segment_gray(&gray);
                let iou = intersection_over_union(&mask, &read_gray(&mask_path));
                println!("{name} {kind}: intersection over union {iou:.5}");
                assert!(iou >= MIN_IOU, "{name} {kind}: {iou}");
                compared += 1;
            }
        }
    }
    compared
}

#[test]
fn drawn_images() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/frequency");
    assert_eq!(compare_folder(&folder), 12);
}

/// Masks of camera images, which cannot be part of the project.
#[test]
fn camera_images() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .map(|ancestor| ancestor.join("shared/data/golden/frequency"))
        .find(|folder: &PathBuf| folder.is_dir());
    match folder {
        Some(folder) => assert!(compare_folder(&folder) > 0),
        None => println!("skipped: no shared/data/golden/frequency beside the project"),
    }
}
