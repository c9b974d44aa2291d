//! Writes sequences to disk in the layouts of the TUM RGB-D and Replica data sets.
//!
//! A folder gets its final name only once it is complete, so a partial recording is never mistaken
//! for a whole one.

use std::io::{self, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use fgs_files::NewFolder;
use fgs_geom::{Image, RgbdFrame};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use thiserror::Error;

use crate::Sequence;

/// Depth scale of the TUM RGB-D data set, units per metre.
const TUM_DEPTH_SCALE: f64 = 5000.0;
/// Depth scale of the Replica data set, units per metre.
const REPLICA_DEPTH_SCALE: f64 = 6553.5;
/// JPEG quality of the colour images in the Replica layout.
const JPEG_QUALITY: u8 = 95;

/// Why a recording was not written. No partial output is left behind.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SynthError {
    /// The target exists already; existing files are never touched.
    #[error("{} exists already", path.display())]
    Exists {
        /// The folder that was to be written.
        path: PathBuf,
    },
    /// Writing failed (disk full, no permission, ...).
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// The file or folder concerned.
        path: PathBuf,
        /// The underlying error.
        source: io::Error,
    },
    /// The `progress` callback asked to stop.
    #[error("stopped after {frames} frames")]
    Stopped {
        /// Number of frames written by then.
        frames: usize,
    },
}

/// Writes a sequence in the layout of TUM RGB-D to the new folder `dir`: `rgb/*.png`,
/// `depth/*.png` (5000 units per metre), `rgb.txt`, `depth.txt`, `groundtruth.txt` and
/// `camera.toml`. `progress` is called after each frame with the number of frames done and may stop
/// the export.
///
/// # Errors
/// See [`SynthError`].
pub fn write_tum(
    sequence: &Sequence,
    dir: &Path,
    progress: impl FnMut(usize) -> ControlFlow<()>,
) -> Result<(), SynthError> {
    let recording = Recording::begin(dir)?;
    let mut rgb = String::from("# color images\n# timestamp filename\n");
    let mut depth = String::from("# depth maps\n# timestamp filename\n");
    let mut poses = String::from("# ground truth trajectory\n# timestamp tx ty tz qx qy qz qw\n");
    for_each_frame(sequence, progress, |frame| {
        let stamp = format!("{:.6}", frame.timestamp_secs);
        let (color_name, depth_name) = (format!("rgb/{stamp}.png"), format!("depth/{stamp}.png"));
        recording.write(&color_name, |file| encode_png_color(&frame.color, file))?;
        recording.write(&depth_name, |file| {
            encode_depth(&frame.depth_m, TUM_DEPTH_SCALE, file)
        })?;
        rgb += &format!("{stamp} {color_name}\n");
        depth += &format!("{stamp} {depth_name}\n");
        let pose = sequence.world_from_camera(frame.index.0);
        let (t, q) = (pose.translation, pose.rotation.coords);
        let numbers = [t.x, t.y, t.z, q.x, q.y, q.z, q.w].map(|x| format!("{x:.9}"));
        poses += &format!("{stamp} {}\n", numbers.join(" "));
        Ok(())
    })?;
    for (name, text) in [
        ("rgb.txt", rgb),
        ("depth.txt", depth),
        ("groundtruth.txt", poses),
    ] {
        recording.write_text(name, &text)?;
    }
    recording.write_text("camera.toml", &camera_toml(sequence, TUM_DEPTH_SCALE))?;
    recording.finish()
}

/// Writes a sequence in the layout of Replica to the new folder `dir`: `results/frameNNNNNN.jpg`,
/// `results/depthNNNNNN.png` (6553.5 units per metre), `traj.txt` (one camera-to-world matrix per
/// line, 16 numbers, row-major) and `camera.toml`. `progress` is called after each frame with the
/// number of frames done and may stop the export.
///
/// # Errors
/// See [`SynthError`].
pub fn write_replica(
    sequence: &Sequence,
    dir: &Path,
    progress: impl FnMut(usize) -> ControlFlow<()>,
) -> Result<(), SynthError> {
    let recording = Recording::begin(dir)?;
    let mut poses = String::new();
    for_each_frame(sequence, progress, |frame| {
        let index = frame.index.0;
        recording.write(&format!("results/frame{index:06}.jpg"), |file| {
            encode_jpeg(&frame.color, file)
        })?;
        recording.write(&format!("results/depth{index:06}.png"), |file| {
            encode_depth(&frame.depth_m, REPLICA_DEPTH_SCALE, file)
        })?;
        let rows = sequence.world_from_camera(index).matrix().transpose();
        let numbers: Vec<String> = rows.iter().map(|x| format!("{x:.9e}")).collect();
        poses += &format!("{}\n", numbers.join(" "));
        Ok(())
    })?;
    recording.write_text("traj.txt", &poses)?;
    recording.write_text("camera.toml", &camera_toml(sequence, REPLICA_DEPTH_SCALE))?;
    recording.finish()
}

fn for_each_frame(
    sequence: &Sequence,
    mut progress: impl FnMut(usize) -> ControlFlow<()>,
    mut write: impl FnMut(&RgbdFrame) -> Result<(), SynthError>,
) -> Result<(), SynthError> {
    for frame in sequence.frames() {
        write(&frame)?;
        let frames = frame.index.0 + 1;
        if progress(frames).is_break() {
            return Err(SynthError::Stopped { frames });
        }
    }
    Ok(())
}

fn camera_toml(sequence: &Sequence, depth_scale: f64) -> String {
    let camera = sequence.camera();
    let k = camera.intrinsics;
    format!(
        "width = {}\nheight = {}\nfx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}\ndepth_scale = {:?}\n\
         depth_delay_secs = 0.0\ncolor_readout_secs = 0.0\ndepth_readout_secs = 0.0\n",
        camera.width, camera.height, k.fx, k.fy, k.cx, k.cy, depth_scale
    )
}

fn encode_png_color(color: &Image<[u8; 3]>, file: &mut dyn Write) -> image::ImageResult<()> {
    encode_png(
        color.data().as_flattened(),
        [color.width(), color.height()],
        ExtendedColorType::Rgb8,
        file,
    )
}

/// Depths that exceed 16 bits (65535 units) are written as 0, that is, missing. A room is smaller.
fn encode_depth(depth_m: &Image<f32>, scale: f64, file: &mut dyn Write) -> image::ImageResult<()> {
    let units = |depth: &f32| {
        let units = (f64::from(*depth) * scale).round();
        if units <= 65535.0 { units as u16 } else { 0 }
    };
    // The encoder expects 16-bit values in native byte order.
    let bytes: Vec<u8> = (depth_m.data().iter())
        .flat_map(|depth| units(depth).to_ne_bytes())
        .collect();
    let size = [depth_m.width(), depth_m.height()];
    encode_png(&bytes, size, ExtendedColorType::L16, file)
}

fn encode_png(
    bytes: &[u8],
    [width, height]: [usize; 2],
    color: ExtendedColorType,
    file: &mut dyn Write,
) -> image::ImageResult<()> {
    PngEncoder::new_with_quality(file, CompressionType::Fast, FilterType::Adaptive).write_image(
        bytes,
        width as u32,
        height as u32,
        color,
    )
}

fn encode_jpeg(color: &Image<[u8; 3]>, file: &mut dyn Write) -> image::ImageResult<()> {
    JpegEncoder::new_with_quality(file, JPEG_QUALITY).write_image(
        color.data().as_flattened(),
        color.width() as u32,
        color.height() as u32,
        ExtendedColorType::Rgb8,
    )
}

/// A recording in progress: written to a temporary folder beside `target`.
struct Recording<'a> {
    target: &'a Path,
    folder: NewFolder,
}

impl<'a> Recording<'a> {
    fn begin(target: &'a Path) -> Result<Self, SynthError> {
        let folder = NewFolder::begin(target).map_err(|source| refusal(target, source))?;
        Ok(Self { target, folder })
    }

    fn write(
        &self,
        name: &str,
        encode: impl FnOnce(&mut dyn Write) -> image::ImageResult<()>,
    ) -> Result<(), SynthError> {
        let written = self.folder.write(name, |file| encode(file));
        written.map_err(|error| SynthError::Io {
            path: self.target.join(name),
            source: match error {
                image::ImageError::IoError(source) => source,
                other => io::Error::other(other),
            },
        })
    }

    fn write_text(&self, name: &str, text: &str) -> Result<(), SynthError> {
        self.write(name, |file| Ok(file.write_all(text.as_bytes())?))
    }

    fn finish(self) -> Result<(), SynthError> {
        let target = self.target;
        self.folder
            .finish()
            .map_err(|source| refusal(target, source))
    }
}

fn refusal(target: &Path, source: io::Error) -> SynthError {
    let path = target.to_owned();
    match source.kind() {
        io::ErrorKind::AlreadyExists => SynthError::Exists { path },
        _ => SynthError::Io { path, source },
    }
}
