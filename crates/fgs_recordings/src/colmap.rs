//! A COLMAP model with a depth image for each colour image: `cameras` and `images`, as text or binary, in
//! `sparse/0/`, `sparse/` or beside `images/`; depth in `depth/` or `depths/` by the image's name, PNG,
//! millimetres.
//!
//! Poses are `camera_from_world` in our axes; the first pixel's centre is at 0.5, ours at 0.

use std::collections::HashMap;

use fgs_data::{DataError, Format, SourcedRecording, natural_order};
use fgs_geom::{Intrinsics, Se3};

use crate::camera_file::camera_file;
use crate::fault::fault;
use crate::intrinsics::{median, resized};
use crate::phone_poses::{assumed_times, trajectory};
use crate::tree::Tree;
use crate::tree_frames::{ColorFile, DepthCoding, TreeFrame, TreeFrames, size_of};

const FOLDERS: [&str; 3] = ["sparse/0/", "sparse/", ""];
const DEPTHS: [&str; 2] = ["depth", "depths"];
const IMAGES: &str = "images";

/// Millions of points that images saw are in the same file.
const MAX_BYTES: u64 = 1 << 30;

const UNITS_PER_M: f64 = 1000.0;

/// Names of camera models by their numbers, with how many parameters they have.
const MODELS: [(&str, usize); 5] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
];

struct Lens {
    size: (usize, usize),
    intrinsics: Intrinsics,
    distortion: [f64; 5],
}

struct Photograph {
    name: String,
    camera: u64,
    pose: Option<Se3>,
}

/// The folder of the model, if the tree has one, and depth beside it.
fn model_folder(tree: &Tree) -> Option<&'static str> {
    let has = |folder: &str, name: &str| {
        tree.has(&format!("{folder}{name}.bin")) || tree.has(&format!("{folder}{name}.txt"))
    };
    FOLDERS
        .into_iter()
        .find(|folder| has(folder, "cameras") && has(folder, "images"))
        .filter(|_| DEPTHS.iter().any(|depth| tree.has(depth)))
}

/// Whether a tree is such a recording.
pub(crate) fn is_one(tree: &Tree) -> bool {
    model_folder(tree).is_some()
}

/// Opens one.
///
/// # Errors
/// If the model is damaged, or no image has depth.
pub(crate) fn open(tree: Tree) -> Result<SourcedRecording, DataError> {
    let folder = model_folder(&tree).unwrap_or_default();
    let path = tree.shown(folder);
    let lenses = read_cameras(&tree, folder)?;
    let mut photographs = read_images(&tree, folder)?;
    // In the order in which they were taken, as their names say.
    photographs.sort_by(|a, b| natural_order(&a.name, &b.name));
    let (mut frames, mut poses, mut distortion) = (Vec::new(), Vec::new(), None);
    let mut color_size = None;
    for photograph in photographs {
        let color = format!("{IMAGES}/{}", photograph.name);
        let Some(depth) = depth_of(&tree, &photograph.name) else {
            continue;
        };
        let Some(lens) = lenses.get(&photograph.camera) else {
            let message = format!("{} has no camera {}", photograph.name, photograph.camera);
            return Err(fault(&path, message));
        };
        if *distortion.get_or_insert(lens.distortion) != lens.distortion {
            let message = "images with different lens distortions are not understood";
            return Err(fault(&path, message.into()));
        }
        let size = match color_size {
            Some(size) => size,
            None => *color_size.insert(size_of(&tree, &color)?),
        };
        frames.push(TreeFrame {
            color: ColorFile::Own(color),
            depth,
            confidence: None,
            intrinsics: Some(resized(&path, &lens.intrinsics, lens.size, size)?),
        });
        poses.push(photograph.pose);
    }
    let own: Vec<Intrinsics> = frames.iter().filter_map(|frame| frame.intrinsics).collect();
    let (Some(size), Some(common)) = (color_size, median(&own)) else {
        return Err(DataError::Empty {
            path,
            what: "image with a depth image",
        });
    };
    let depth_coding = DepthCoding::Png {
        units_per_m: UNITS_PER_M as f32,
    };
    let frames = TreeFrames::new(tree, frames, depth_coding, size, common, &path)?;
    let distortion = distortion.filter(|values| *values != [0.0; 5]);
    let timestamps = assumed_times(poses.len());
    Ok(SourcedRecording {
        format: Format::Colmap,
        camera: camera_file(frames.camera(), distortion, UNITS_PER_M, &path)?,
        device_poses: trajectory(&timestamps, poses.into_iter()),
        timestamps,
        source: Box::new(frames),
    })
}

fn depth_of(tree: &Tree, name: &str) -> Option<String> {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    DEPTHS
        .iter()
        .map(|folder| format!("{folder}/{stem}.png"))
        .find(|depth| tree.has(depth))
}

fn read_cameras(tree: &Tree, folder: &str) -> Result<HashMap<u64, Lens>, DataError> {
    let (bytes, name, is_text) = read(tree, folder, "cameras")?;
    let path = tree.shown(&name);
    let cameras = if is_text {
        lines(&bytes).map(camera_of_line).collect()
    } else {
        cameras_of(&mut Binary(&bytes))
    };
    cameras.ok_or_else(|| {
        let known = MODELS.map(|(name, _)| name).join(", ");
        fault(
            &path,
            format!("is damaged, or has other cameras than {known}"),
        )
    })
}

fn read_images(tree: &Tree, folder: &str) -> Result<Vec<Photograph>, DataError> {
    let (bytes, name, is_text) = read(tree, folder, "images")?;
    let images = if is_text {
        // Every other line has the points that the image saw, and may be empty.
        let text = lossless_lines(&bytes).filter(|line| !line.starts_with('#'));
        text.step_by(2)
            .filter(|line| !line.is_empty())
            .map(image_of_line)
            .collect()
    } else {
        images_of(&mut Binary(&bytes))
    };
    images.ok_or_else(|| fault(&tree.shown(&name), "is damaged".into()))
}

/// A file of the model, its name, and whether it is text.
fn read(tree: &Tree, folder: &str, what: &str) -> Result<(Vec<u8>, String, bool), DataError> {
    let binary = format!("{folder}{what}.bin");
    let is_text = !tree.has(&binary);
    let name = if is_text {
        format!("{folder}{what}.txt")
    } else {
        binary
    };
    Ok((tree.read(&name, MAX_BYTES)?, name, is_text))
}

/// Lines of UTF-8; others are empty.
fn lossless_lines(bytes: &[u8]) -> impl Iterator<Item = &str> {
    let lines = bytes.split(|byte| *byte == b'\n');
    lines.map(|line| str::from_utf8(line).unwrap_or_default().trim())
}

/// Those that are neither empty nor comments.
fn lines(bytes: &[u8]) -> impl Iterator<Item = &str> {
    lossless_lines(bytes).filter(|line| !line.is_empty() && !line.starts_with('#'))
}

/// `CAMERA_ID MODEL WIDTH HEIGHT PARAMS...`
fn camera_of_line(line: &str) -> Option<(u64, Lens)> {
    let mut words = line.split_whitespace();
    let id = words.next()?.parse().ok()?;
    let model = words.next()?;
    let size = (words.next()?.parse().ok()?, words.next()?.parse().ok()?);
    let parameters: Option<Vec<f64>> = words.map(|word| word.parse().ok()).collect();
    Some((id, Lens::new(model, size, &parameters?)?))
}

/// `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`
fn image_of_line(line: &str) -> Option<Photograph> {
    let words: Vec<&str> = line.splitn(10, ' ').collect();
    let [_, pose @ .., camera, name] = words.as_slice() else {
        return None;
    };
    let pose: Option<Vec<f64>> = pose.iter().map(|word| word.parse().ok()).collect();
    Some(Photograph {
        name: (*name).to_owned(),
        camera: camera.parse().ok()?,
        pose: pose_of(pose?.try_into().ok()?),
    })
}

fn pose_of([qw, qx, qy, qz, tx, ty, tz]: [f64; 7]) -> Option<Se3> {
    Some(Se3::from_wxyz([qw, qx, qy, qz], [tx, ty, tz])?.inverse())
}

/// Little-endian numbers, one after another.
struct Binary<'a>(&'a [u8]);

impl<'a> Binary<'a> {
    fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    fn u32(&mut self) -> Option<u32> {
        self.bytes().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.bytes().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Option<f64> {
        self.bytes().map(f64::from_le_bytes)
    }

    /// Text that ends with a zero.
    fn text(&mut self) -> Option<&'a str> {
        let end = self.0.iter().position(|byte| *byte == 0)?;
        let text = str::from_utf8(&self.0[..end]).ok()?;
        self.0 = &self.0[end + 1..];
        Some(text)
    }

    fn skip(&mut self, count: usize) -> Option<()> {
        self.0 = self.0.get(count..)?;
        Some(())
    }
}

fn cameras_of(binary: &mut Binary<'_>) -> Option<HashMap<u64, Lens>> {
    let count = binary.u64()?;
    let camera = |_| {
        let id = u64::from(binary.u32()?);
        let (name, parameters) = *MODELS.get(binary.u32()? as usize)?;
        let size = (binary.u64()? as usize, binary.u64()? as usize);
        let parameters: Option<Vec<f64>> = (0..parameters).map(|_| binary.f64()).collect();
        Some((id, Lens::new(name, size, &parameters?)?))
    };
    // Ends with the bytes, whatever is claimed.
    (0..count).map(camera).collect()
}

fn images_of(binary: &mut Binary<'_>) -> Option<Vec<Photograph>> {
    let count = binary.u64()?;
    let image = |_| {
        let _id = binary.u32()?;
        let mut pose = [0.0; 7];
        for value in &mut pose {
            *value = binary.f64()?;
        }
        let camera = u64::from(binary.u32()?);
        let name = binary.text()?.to_owned();
        let points = binary.u64()?;
        // Two coordinates and a number each.
        binary.skip(usize::try_from(points).ok()?.checked_mul(24)?)?;
        Some(Photograph {
            name,
            camera,
            pose: pose_of(pose),
        })
    };
    (0..count).map(image).collect()
}

impl Lens {
    fn new(model: &str, size: (usize, usize), parameters: &[f64]) -> Option<Self> {
        let (fx, fy, cx, cy, distortion) = match (model, parameters) {
            ("SIMPLE_PINHOLE", &[f, cx, cy]) => (f, f, cx, cy, [0.0; 5]),
            ("PINHOLE", &[fx, fy, cx, cy]) => (fx, fy, cx, cy, [0.0; 5]),
            ("SIMPLE_RADIAL", &[f, cx, cy, k1]) => (f, f, cx, cy, [k1, 0.0, 0.0, 0.0, 0.0]),
            ("RADIAL", &[f, cx, cy, k1, k2]) => (f, f, cx, cy, [k1, k2, 0.0, 0.0, 0.0]),
            ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
                (fx, fy, cx, cy, [k1, k2, p1, p2, 0.0])
            }
            _ => return None,
        };
        let intrinsics = Intrinsics {
            fx,
            fy,
            cx: cx - 0.5,
            cy: cy - 0.5,
        };
        (size.0 > 0 && size.1 > 0).then_some(Self {
            size,
            intrinsics,
            distortion,
        })
    }
}
