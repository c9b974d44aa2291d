//! A recording of any kind written as a plain folder: in TUM's layout, which keeps times.
//!
//! `rgb/NNNNNN.png`, `depth/NNNNNN.png`, `rgb.txt`, `depth.txt`, `camera.toml`, and `groundtruth.txt` or, of
//! a device's own poses, `device_poses.txt`. The folder gets its name once it is complete.

use std::fmt::Write as _;
use std::io::{self, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use fgs_data::{DataError, Dataset, PoseOrigin};
use fgs_files::NewFolder;
use fgs_geom::Image;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageError};
use thiserror::Error;

/// Why a plain folder was not written. Nothing is left behind.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum WriteError {
    /// Existing files are never touched.
    #[error("{} exists already", .0.display())]
    Exists(PathBuf),
    /// The operating system's refusal.
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// No frame could be read; the first one's error.
    #[error("no frame can be read: {0}")]
    NoFrame(DataError),
    /// It was asked to stop.
    #[error("stopped")]
    Stopped,
}

/// Writes a recording as a plain folder, which must not exist, and returns how many frames it holds.
/// Images are as the lens drew them; `camera.toml` says how it bends them. Depth is in whole units of
/// `1 / depth_scale` metres of the recording's camera; what has no 16 bits is left out.
///
/// `progress` is called after each frame with its index and, if it cannot be read and is left out, why;
/// it may stop the work.
///
/// # Errors
/// See [`WriteError`].
pub fn write_plain(
    dataset: &Dataset,
    out: &Path,
    mut progress: impl FnMut(usize, Option<&DataError>) -> ControlFlow<()>,
) -> Result<usize, WriteError> {
    let folder = Folder::begin(out)?;
    let scale = dataset.camera_file().depth_scale();
    let [mut colors, mut depths] =
        ["color images", "depth maps"].map(|what| format!("# {what}\n# timestamp filename\n"));
    let (mut count, mut first_error) = (0, None);
    for (index, secs) in dataset.timestamps().enumerate() {
        match dataset.images(index) {
            Ok(images) => {
                let [color, depth] = ["rgb", "depth"].map(|kind| format!("{kind}/{index:06}.png"));
                folder.write(&color, |file| encode_color(&images.color, file))?;
                folder.write(&depth, |file| encode_depth(&images.depth_m, scale, file))?;
                // Writing to text cannot fail.
                let _ = writeln!(colors, "{secs} {color}");
                let _ = writeln!(depths, "{secs} {depth}");
                count += 1;
                if progress(index, None).is_break() {
                    return Err(WriteError::Stopped);
                }
            }
            Err(error) => {
                if progress(index, Some(&error)).is_break() {
                    return Err(WriteError::Stopped);
                }
                first_error.get_or_insert(error);
            }
        }
    }
    if let Some(error) = first_error.filter(|_| count == 0) {
        return Err(WriteError::NoFrame(error));
    }
    let camera = toml::to_string(dataset.camera_file()).unwrap_or_default();
    for (name, text) in [
        ("rgb.txt", colors),
        ("depth.txt", depths),
        ("camera.toml", camera),
    ] {
        folder.write(name, |file| Ok(file.write_all(text.as_bytes())?))?;
    }
    if let Some(poses) = dataset.ground_truth() {
        let name = match dataset.pose_origin() {
            PoseOrigin::GroundTruth => "groundtruth.txt",
            PoseOrigin::Device => "device_poses.txt",
        };
        folder.write(name, |mut file| Ok(poses.encode(&mut file)?))?;
    }
    folder.finish()?;
    Ok(count)
}

/// The folder in progress.
struct Folder<'a> {
    target: &'a Path,
    folder: NewFolder,
}

impl<'a> Folder<'a> {
    fn begin(target: &'a Path) -> Result<Self, WriteError> {
        let folder = NewFolder::begin(target).map_err(|source| refusal(target, source))?;
        Ok(Self { target, folder })
    }

    fn write(
        &self,
        name: &str,
        encode: impl FnOnce(&mut dyn Write) -> Result<(), ImageError>,
    ) -> Result<(), WriteError> {
        let written = self.folder.write(name, |file| encode(file));
        written.map_err(|error| WriteError::Io {
            path: self.target.join(name),
            source: match error {
                ImageError::IoError(source) => source,
                other => io::Error::other(other),
            },
        })
    }

    fn finish(self) -> Result<(), WriteError> {
        let target = self.target;
        self.folder
            .finish()
            .map_err(|source| refusal(target, source))
    }
}

fn refusal(path: &Path, source: io::Error) -> WriteError {
    let path = path.to_owned();
    match source.kind() {
        io::ErrorKind::AlreadyExists => WriteError::Exists(path),
        _ => WriteError::Io { path, source },
    }
}

fn encode_color(color: &Image<[u8; 3]>, file: &mut dyn Write) -> Result<(), ImageError> {
    let size = (color.width(), color.height());
    let pixels = color.data().as_flattened();
    encode(pixels, size, ExtendedColorType::Rgb8, file)
}

fn encode_depth(depth_m: &Image<f32>, scale: f64, file: &mut dyn Write) -> Result<(), ImageError> {
    let units = |depth: &f32| {
        let units = (f64::from(*depth) * scale).round();
        if units <= 65535.0 { units as u16 } else { 0 }
    };
    // The encoder expects 16-bit values in native byte order.
    let bytes: Vec<u8> = (depth_m.data().iter())
        .flat_map(|depth| units(depth).to_ne_bytes())
        .collect();
    let size = (depth_m.width(), depth_m.height());
    encode(&bytes, size, ExtendedColorType::L16, file)
}

fn encode(
    bytes: &[u8],
    (width, height): (usize, usize),
    color: ExtendedColorType,
    file: &mut dyn Write,
) -> Result<(), ImageError> {
    PngEncoder::new_with_quality(file, CompressionType::Fast, FilterType::Adaptive).write_image(
        bytes,
        width as u32,
        height as u32,
        color,
    )
}
