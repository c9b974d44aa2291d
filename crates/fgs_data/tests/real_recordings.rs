//! Recordings of full size, where there are any: in the folder `FGS_SHARED`, or `../shared` beside
//! the workspace.

#![allow(clippy::print_stdout, reason = "a test says what it skips")]
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

use fgs_data::{CameraFile, Dataset, OpenOptions};
use fgs_geom::has_depth;

fn recording(name: &str) -> Option<PathBuf> {
    let shared = std::env::var_os("FGS_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let path = shared.join("data").join(name);
    if !path.is_dir() {
        println!("skipped: there is no {}", path.display());
        return None;
    }
    Some(path)
}

/// The share of pixels with depth over the first frames.
fn share_with_depth(dataset: &Dataset, frames: usize) -> f64 {
    let shares = dataset.frames(0..frames).map(|frame| {
        let depth = frame.unwrap().depth_m;
        let measured = depth
            .data()
            .iter()
            .filter(|depth| has_depth(**depth))
            .count();
        measured as f64 / depth.data().len() as f64
    });
    shares.sum::<f64>() / frames as f64
}

#[test]
fn a_kinect_recording_in_tums_layout() {
    let Some(path) = recording("redkitchen") else {
        return;
    };
    let dataset = Dataset::open(&path, &OpenOptions::default()).unwrap();
    assert_eq!(dataset.len(), 500);
    assert_eq!(dataset.ground_truth().unwrap().poses().len(), 500);
    let share = share_with_depth(&dataset, 5);
    assert!((0.6..0.8).contains(&share), "{share}");
}

#[test]
fn a_rendering_in_replicas_layout() {
    let Some(path) = recording("kitchen") else {
        return;
    };
    let camera = "width = 1200\nheight = 680\nfx = 600\nfy = 600\ncx = 599.5\ncy = 339.5\n\
                  depth_scale = 6553.5";
    let options = OpenOptions {
        camera: Some(CameraFile::parse(camera, Path::new("test")).unwrap()),
        ..OpenOptions::default()
    };
    let dataset = Dataset::open(&path, &options).unwrap();
    assert_eq!(dataset.len(), dataset.ground_truth().unwrap().poses().len());
    let share = share_with_depth(&dataset, 5);
    assert!((0.9..0.99).contains(&share), "{share}");
}
