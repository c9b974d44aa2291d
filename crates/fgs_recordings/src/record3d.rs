//! Record3D: `.r3d`, a ZIP archive of `metadata` (JSON) and, for each frame N, `rgbd/N.jpg`,
//! `rgbd/N.depth` (32-bit metres, LZFSE) and `rgbd/N.conf` (a byte, 0 to 2, LZFSE).
//!
//! Colour and depth are stored upright as the app shows them; intrinsics are of images of `w` x `h`, and
//! poses `[qx, qy, qz, qw, tx, ty, tz]` of the camera so turned, y up.

use std::path::Path;

use fgs_data::{DataError, Format, SourcedRecording, Trajectory};
use fgs_geom::{Intrinsics, Se3};
use serde::Deserialize;

use crate::camera_file::pinhole;
use crate::fault::fault;
use crate::intrinsics::{median, resized};
use crate::phone_poses::{from_y_up, trajectory};
use crate::tree::Tree;
use crate::tree_frames::{ColorFile, DepthCoding, TreeFrame, TreeFrames, size_of};

const METADATA: &str = "metadata";
const IMAGES: &str = "rgbd";

/// An hour of 60 frames a second has 30 MB of metadata.
const MAX_METADATA_BYTES: u64 = 128 * 1024 * 1024;

/// Depth of more numbers is none of a phone's.
const MAX_DEPTH_PIXELS: usize = 16_000_000;

/// The app's rate, where metadata does not say another.
const FRAME_RATE_HZ: f64 = 60.0;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Metadata {
    w: Option<usize>,
    h: Option<usize>,
    dw: Option<usize>,
    dh: Option<usize>,
    fps: Option<f64>,
    /// Column by column.
    #[serde(rename = "K")]
    k: Option<Vec<f64>>,
    #[serde(default)]
    poses: Vec<Vec<f64>>,
    /// fx, fy, cx, cy.
    #[serde(default)]
    per_frame_intrinsic_coeffs: Vec<Vec<f64>>,
    #[serde(default)]
    frame_timestamps: Vec<f64>,
}

/// Whether a tree is such a recording.
pub(crate) fn is_one(tree: &Tree) -> bool {
    tree.has(METADATA) && tree.has(IMAGES)
}

/// Opens one.
///
/// # Errors
/// If its metadata or first frame is damaged, or no frame is complete.
pub(crate) fn open(tree: Tree) -> Result<SourcedRecording, DataError> {
    let path = tree.shown(METADATA);
    let metadata = Metadata::read(&tree, &path)?;
    let numbers = frame_numbers(&tree)?;
    let (Some(first), Some(last)) = (numbers.first(), numbers.last()) else {
        return Err(DataError::Empty {
            path: tree.shown(IMAGES),
            what: "frame of a colour and a depth image",
        });
    };
    let count = last.saturating_add(1);
    let color_size = size_of(&tree, &color_name(*first))?;
    let described = match (metadata.w, metadata.h) {
        (Some(width), Some(height)) => (width, height),
        _ => color_size,
    };
    let of_images = |k: &Intrinsics| resized(&path, k, described, color_size);
    let own = metadata.frame_intrinsics(&numbers, count);
    let own: Vec<Intrinsics> = own
        .iter()
        .flatten()
        .map(of_images)
        .collect::<Result<_, _>>()?;
    let common = match median(&own) {
        Some(common) => common,
        None => of_images(&metadata.intrinsics(&path)?)?,
    };
    let frame = |(place, number): (usize, &usize)| TreeFrame {
        color: ColorFile::Own(color_name(*number)),
        depth: format!("{IMAGES}/{number}.depth"),
        confidence: Some(format!("{IMAGES}/{number}.conf")).filter(|name| tree.has(name)),
        intrinsics: own.get(place).copied(),
    };
    let frames: Vec<TreeFrame> = numbers.iter().enumerate().map(frame).collect();
    let depth_coding = DepthCoding::Numbers {
        size: metadata.depth_size(&path, color_size)?,
    };
    let frames = TreeFrames::new(tree, frames, depth_coding, color_size, common, &path)?;
    let timestamps = metadata.timestamps(&numbers, count);
    let device_poses = metadata.poses(&path, &timestamps, &numbers, count);
    Ok(SourcedRecording {
        format: Format::Record3d,
        camera: pinhole(frames.camera(), &path)?,
        timestamps,
        device_poses,
        source: Box::new(frames),
    })
}

fn color_name(number: usize) -> String {
    format!("{IMAGES}/{number}.jpg")
}

/// The numbers of the frames that have colour and depth, increasing.
fn frame_numbers(tree: &Tree) -> Result<Vec<usize>, DataError> {
    let names = tree.names_in(IMAGES)?;
    let number = |name: &String| -> Option<usize> {
        let number = name.strip_suffix(".jpg")?.parse().ok()?;
        tree.has(&format!("{IMAGES}/{number}.depth"))
            .then_some(number)
    };
    let mut numbers: Vec<usize> = names.iter().filter_map(number).collect();
    numbers.sort_unstable();
    numbers.dedup();
    Ok(numbers)
}

impl Metadata {
    fn read(tree: &Tree, path: &Path) -> Result<Self, DataError> {
        let bytes = tree.read(METADATA, MAX_METADATA_BYTES)?;
        serde_json::from_slice(&bytes).map_err(|error| fault(path, error.to_string()))
    }

    fn intrinsics(&self, path: &Path) -> Result<Intrinsics, DataError> {
        match self.k.as_deref() {
            Some(&[fx, _, _, _, fy, _, cx, cy, _]) => Ok(Intrinsics { fx, fy, cx, cy }),
            _ => Err(fault(path, "K must be a matrix of 9 numbers".into())),
        }
    }

    /// The value of frame `number` in a list that has one for each of `count` frames; `None` if the list
    /// is of another length.
    fn of_frame<T>(list: &[T], number: usize, count: usize) -> Option<&T> {
        list.get(number).filter(|_| list.len() >= count)
    }

    /// All or none: a frame without would be seen through another lens.
    fn frame_intrinsics(&self, numbers: &[usize], count: usize) -> Option<Vec<Intrinsics>> {
        let list = &self.per_frame_intrinsic_coeffs;
        let of_frame = |&number: &usize| match Self::of_frame(list, number, count)?.as_slice() {
            // What is no focal length is damaged.
            &[fx, fy, cx, cy, ..] if fx > 1.0 && fy > 1.0 => Some(Intrinsics { fx, fy, cx, cy }),
            _ => None,
        };
        numbers.iter().map(of_frame).collect()
    }

    /// As recorded, or by the rate where that is unusable. Times begin at the first frame of the file.
    fn timestamps(&self, numbers: &[usize], count: usize) -> Vec<f64> {
        let list = &self.frame_timestamps;
        let of_frame = |&number: &usize| Self::of_frame(list, number, count).copied();
        let recorded: Option<Vec<f64>> = numbers.iter().map(of_frame).collect();
        recorded
            .filter(|times| times.is_sorted_by(|a, b| a < b))
            .unwrap_or_else(|| {
                let rate = self.fps.filter(|fps| (1e-3..1e6).contains(fps));
                let rate = rate.unwrap_or(FRAME_RATE_HZ);
                numbers.iter().map(|&number| number as f64 / rate).collect()
            })
    }

    fn poses(
        &self,
        path: &Path,
        timestamps: &[f64],
        numbers: &[usize],
        count: usize,
    ) -> Result<Option<Trajectory>, DataError> {
        if self.poses.is_empty() {
            return Ok(None);
        }
        let pose = |&number: &usize| match Self::of_frame(&self.poses, number, count)?.as_slice() {
            &[qx, qy, qz, qw, tx, ty, tz] => {
                Se3::from_wxyz([qw, qx, qy, qz], [tx, ty, tz]).map(from_y_up)
            }
            _ => None,
        };
        let poses: Vec<_> = numbers.iter().map(pose).collect();
        if poses.iter().all(Option::is_none) {
            let message = "poses must be 7 numbers for each frame: qx qy qz qw tx ty tz";
            return Err(fault(path, message.into()));
        }
        trajectory(timestamps, poses.into_iter())
    }

    /// Columns and rows of depth: as metadata says, or those of colour in files that do not.
    fn depth_size(
        &self,
        path: &Path,
        color_size: (usize, usize),
    ) -> Result<(usize, usize), DataError> {
        let size = match (self.dw, self.dh) {
            (Some(width), Some(height)) => (width, height),
            _ => color_size,
        };
        if size.0.saturating_mul(size.1) > MAX_DEPTH_PIXELS {
            return Err(fault(path, "dw and dh are no phone's".into()));
        }
        Ok(size)
    }
}
