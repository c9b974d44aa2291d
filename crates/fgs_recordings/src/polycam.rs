//! Polycam's raw data: `keyframes/` with, for each time T in microseconds, `images/T.jpg`,
//! `cameras/T.json`, `depth/T.png` (millimetres) and `confidence/T.png` (0 is the least).
//!
//! `corrected_images` and `corrected_cameras` are there when Polycam has optimised the poses and taken out
//! the lens distortion; they are taken if they are. Camera axes are ARKit's.

use std::path::Path;

use fgs_data::{DataError, Format, SourcedRecording};
use fgs_geom::{Intrinsics, Se3};
use nalgebra::Matrix4;
use serde::Deserialize;

use crate::camera_file::pinhole;
use crate::fault::fault;
use crate::intrinsics::{median, resized};
use crate::phone_poses::{from_y_up, trajectory};
use crate::tree::Tree;
use crate::tree_frames::{ColorFile, DepthCoding, TreeFrame, TreeFrames, size_of};

const KEYFRAMES: &str = "keyframes";
const DEPTH: &str = "keyframes/depth";
const CONFIDENCE: &str = "keyframes/confidence";

/// Folders of images and of cameras, the better first.
const KINDS: [(&str, &str); 2] = [
    ("keyframes/corrected_images", "keyframes/corrected_cameras"),
    ("keyframes/images", "keyframes/cameras"),
];

/// A camera is twenty numbers.
const MAX_CAMERA_BYTES: u64 = 64 * 1024;

/// More than a phone can hold.
const MAX_FRAMES: usize = 100_000;

#[derive(Deserialize)]
struct Camera {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    width: usize,
    height: usize,
    t_00: f64,
    t_01: f64,
    t_02: f64,
    t_03: f64,
    t_10: f64,
    t_11: f64,
    t_12: f64,
    t_13: f64,
    t_20: f64,
    t_21: f64,
    t_22: f64,
    t_23: f64,
}

/// Whether a tree is such a recording.
pub(crate) fn is_one(tree: &Tree) -> bool {
    tree.has(KEYFRAMES) && tree.has(DEPTH)
}

/// Opens one.
///
/// # Errors
/// If a camera is damaged, or no frame is complete.
pub(crate) fn open(tree: Tree) -> Result<SourcedRecording, DataError> {
    let path = tree.shown(KEYFRAMES);
    let kind = KINDS
        .into_iter()
        .find(|(images, cameras)| tree.has(images) && tree.has(cameras));
    let Some((images, cameras)) = kind else {
        return Err(fault(&path, "has no images with cameras".into()));
    };
    let has_confidence = tree.has(CONFIDENCE);
    let (mut frames, mut timestamps, mut poses) = (Vec::new(), Vec::new(), Vec::new());
    let mut color_size = None;
    for microseconds in times(&tree)? {
        let color = format!("{images}/{microseconds}.jpg");
        let name = format!("{cameras}/{microseconds}.json");
        if !tree.has(&color) || !tree.has(&name) {
            continue;
        }
        let camera = Camera::read(&tree, &name)?;
        let size = match color_size {
            Some(size) => size,
            None => *color_size.insert(size_of(&tree, &color)?),
        };
        let confidence = format!("{CONFIDENCE}/{microseconds}.png");
        frames.push(TreeFrame {
            color: ColorFile::Own(color),
            depth: format!("{DEPTH}/{microseconds}.png"),
            confidence: Some(confidence).filter(|name| has_confidence && tree.has(name)),
            intrinsics: Some(camera.intrinsics(&tree.shown(&name), size)?),
        });
        timestamps.push(microseconds as f64 / 1e6);
        poses.push(camera.pose());
    }
    let own: Vec<Intrinsics> = frames.iter().filter_map(|frame| frame.intrinsics).collect();
    let (Some(size), Some(common)) = (color_size, median(&own)) else {
        return Err(DataError::Empty {
            path,
            what: "frame of an image, a camera and a depth image",
        });
    };
    let depth_coding = DepthCoding::Png {
        units_per_m: 1000.0,
    };
    let frames = TreeFrames::new(tree, frames, depth_coding, size, common, &path)?;
    Ok(SourcedRecording {
        format: Format::Polycam,
        camera: pinhole(frames.camera(), &path)?,
        device_poses: trajectory(&timestamps, poses.into_iter()),
        timestamps,
        source: Box::new(frames),
    })
}

/// The times of depth images, microseconds, increasing.
fn times(tree: &Tree) -> Result<Vec<u64>, DataError> {
    let names = tree.names_in(DEPTH)?;
    let mut times: Vec<u64> = names
        .iter()
        .filter_map(|name| name.strip_suffix(".png")?.parse().ok())
        .take(MAX_FRAMES)
        .collect();
    times.sort_unstable();
    // As seconds they are to differ too.
    times.dedup_by_key(|time| *time as f64 / 1e6);
    Ok(times)
}

impl Camera {
    fn read(tree: &Tree, name: &str) -> Result<Self, DataError> {
        let bytes = tree.read(name, MAX_CAMERA_BYTES)?;
        serde_json::from_slice(&bytes).map_err(|error| fault(&tree.shown(name), error.to_string()))
    }

    /// Those of images of `size`.
    fn intrinsics(&self, path: &Path, size: (usize, usize)) -> Result<Intrinsics, DataError> {
        let (fx, fy, cx, cy) = (self.fx, self.fy, self.cx, self.cy);
        if self.width == 0 || self.height == 0 || !(fx > 1.0 && fy > 1.0) {
            return Err(fault(path, "describes no camera".into()));
        }
        let own = Intrinsics { fx, fy, cx, cy };
        resized(path, &own, (self.width, self.height), size)
    }

    fn pose(&self) -> Option<Se3> {
        #[rustfmt::skip]
        let matrix = Matrix4::new(
            self.t_00, self.t_01, self.t_02, self.t_03,
            self.t_10, self.t_11, self.t_12, self.t_13,
            self.t_20, self.t_21, self.t_22, self.t_23,
            0.0, 0.0, 0.0, 1.0,
        );
        Se3::from_matrix(&matrix).map(from_y_up)
    }
}
