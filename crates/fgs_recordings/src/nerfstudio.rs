//! nerfstudio's `transforms.json`: for each frame its image, its depth image and `transform_matrix`.
//!
//! The first pixel's centre is at 0.5 there, ours at 0. Camera axes are OpenGL's. Depth is in millimetres,
//! if `depth_unit_scale_factor` or `integer_depth_scale` (metres a unit) does not say otherwise.

use std::path::Path;

use fgs_data::{DataError, Format, SourcedRecording, natural_order};
use fgs_geom::{Intrinsics, Se3};
use nalgebra::Matrix4;
use serde::Deserialize;

use crate::camera_file::camera_file;
use crate::fault::fault;
use crate::intrinsics::{median, resized};
use crate::phone_poses::{assumed_times, from_y_up, trajectory};
use crate::tree::Tree;
use crate::tree_frames::{ColorFile, DepthCoding, TreeFrame, TreeFrames, size_of};

const TRANSFORMS: &str = "transforms.json";

/// A hundred thousand frames.
const MAX_BYTES: u64 = 128 * 1024 * 1024;

#[derive(Deserialize)]
struct Transforms {
    #[serde(flatten)]
    lens: Lens,
    camera_model: Option<String>,
    depth_unit_scale_factor: Option<f64>,
    integer_depth_scale: Option<f64>,
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    #[serde(alias = "depth_path")]
    depth_file_path: Option<String>,
    transform_matrix: Option<Vec<Vec<f64>>>,
    #[serde(flatten)]
    lens: Lens,
}

/// What may be said for all frames or for each.
#[derive(Clone, Deserialize)]
struct Lens {
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// Whether a tree is such a recording, with depth.
pub(crate) fn is_one(tree: &Tree) -> bool {
    tree.has(TRANSFORMS)
}

/// Opens one.
///
/// # Errors
/// If `transforms.json` is damaged, or no frame has depth.
pub(crate) fn open(tree: Tree) -> Result<SourcedRecording, DataError> {
    let path = tree.shown(TRANSFORMS);
    let bytes = tree.read(TRANSFORMS, MAX_BYTES)?;
    let transforms: Transforms =
        serde_json::from_slice(&bytes).map_err(|error| fault(&path, error.to_string()))?;
    let mut listed: Vec<Frame> = transforms.frames;
    listed.retain(|frame| frame.depth_file_path.is_some());
    // In the order in which they were taken, as their names say; the list may be in another.
    listed.sort_by(|a, b| natural_order(&a.file_path, &b.file_path));
    let Some(first) = listed.first() else {
        return Err(fault(&path, "no frame has depth (depth_file_path)".into()));
    };
    let color_size = size_of(&tree, plain_name(&first.file_path))?;
    let mut frames = Vec::new();
    for frame in &listed {
        frames.push(TreeFrame {
            color: ColorFile::Own(plain_name(&frame.file_path).into()),
            depth: plain_name(frame.depth_file_path.as_deref().unwrap_or_default()).into(),
            confidence: None,
            intrinsics: Some(
                frame
                    .lens
                    .or(&transforms.lens)
                    .intrinsics(&path, color_size)?,
            ),
        });
    }
    let distortion = distortion(&path, &transforms.lens, &listed, transforms.camera_model)?;
    let own: Vec<Intrinsics> = frames.iter().filter_map(|frame| frame.intrinsics).collect();
    let Some(common) = median(&own) else {
        return Err(fault(&path, "has no frame".into()));
    };
    let metres = transforms
        .depth_unit_scale_factor
        .or(transforms.integer_depth_scale)
        .unwrap_or(1e-3);
    if !(1e-6..=1.0).contains(&metres) {
        let message = "depth_unit_scale_factor must be metres a unit, 0.000001 to 1";
        return Err(fault(&path, message.into()));
    }
    // Back to the whole number that was meant.
    let units_per_m = (1e6 / metres).round() / 1e6;
    let depth_coding = DepthCoding::Png {
        units_per_m: units_per_m as f32,
    };
    let frames = TreeFrames::new(tree, frames, depth_coding, color_size, common, &path)?;
    let timestamps = assumed_times(listed.len());
    let poses = listed.iter().map(Frame::pose);
    Ok(SourcedRecording {
        format: Format::Nerfstudio,
        camera: camera_file(frames.camera(), distortion, units_per_m, &path)?,
        device_poses: trajectory(&timestamps, poses),
        timestamps,
        source: Box::new(frames),
    })
}

fn plain_name(name: &str) -> &str {
    name.strip_prefix("./").unwrap_or(name)
}

/// The lens distortion of all frames; `None` without.
fn distortion(
    path: &Path,
    common: &Lens,
    frames: &[Frame],
    model: Option<String>,
) -> Result<Option<[f64; 5]>, DataError> {
    let of = |lens: &Lens| {
        [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3].map(|value| value.unwrap_or(0.0))
    };
    let mut all = frames.iter().map(|frame| of(&frame.lens.or(common)));
    let Some(distortion) = all.next() else {
        return Ok(None);
    };
    if all.any(|other| other != distortion) {
        let message = "frames with different lens distortions are not understood";
        return Err(fault(path, message.into()));
    }
    match model.as_deref() {
        None | Some("OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "RADIAL" | "SIMPLE_RADIAL") => {
            Ok(Some(distortion).filter(|values| *values != [0.0; 5]))
        }
        Some(model) => Err(fault(
            path,
            format!("the camera model {model:?} is not understood"),
        )),
    }
}

impl Frame {
    fn pose(&self) -> Option<Se3> {
        let rows = self.transform_matrix.as_ref()?;
        let values: Vec<f64> = rows.iter().flatten().copied().collect();
        let matrix = (values.len() == 16).then(|| Matrix4::from_row_slice(&values))?;
        Se3::from_matrix(&matrix).map(from_y_up)
    }
}

impl Lens {
    /// What is not said here is as in `other`.
    fn or(&self, other: &Self) -> Self {
        Self {
            w: self.w.or(other.w),
            h: self.h.or(other.h),
            fl_x: self.fl_x.or(other.fl_x),
            fl_y: self.fl_y.or(other.fl_y),
            cx: self.cx.or(other.cx),
            cy: self.cy.or(other.cy),
            k1: self.k1.or(other.k1),
            k2: self.k2.or(other.k2),
            k3: self.k3.or(other.k3),
            p1: self.p1.or(other.p1),
            p2: self.p2.or(other.p2),
        }
    }

    /// Those of images of `size`, whose first pixel's centre is at 0.
    fn intrinsics(&self, path: &Path, size: (usize, usize)) -> Result<Intrinsics, DataError> {
        let fx = self.fl_x.filter(|fx| *fx > 1.0);
        let Some(fx) = fx else {
            return Err(fault(
                path,
                "fl_x must be the focal length in pixels".into(),
            ));
        };
        let (width, height) = (size.0 as f64, size.1 as f64);
        let described = (self.w.unwrap_or(width), self.h.unwrap_or(height));
        let own = Intrinsics {
            fx,
            fy: self.fl_y.unwrap_or(fx),
            cx: self.cx.unwrap_or(described.0 / 2.0) - 0.5,
            cy: self.cy.unwrap_or(described.1 / 2.0) - 0.5,
        };
        let is_size = |size: f64| (1.0..1e6).contains(&size);
        if !is_size(described.0) || !is_size(described.1) {
            return Err(fault(path, "w and h must be the images' size".into()));
        }
        let described = (described.0 as usize, described.1 as usize);
        resized(path, &own, described, size)
    }
}
