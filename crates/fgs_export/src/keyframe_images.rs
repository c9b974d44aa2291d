//! The keyframes' images, as COLMAP and nerfstudio read them.

use std::fs;
use std::io::{self, Write};
use std::ops::ControlFlow;
use std::path::Path;

use fgs_data::{Dataset, Trajectory};
use fgs_geom::{Image, Se3};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageError};

use crate::ExportError;
use crate::error::go_on;

/// A keyframe of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keyframe {
    /// Position of the frame in its recording.
    pub index: usize,
    /// Its pose.
    pub world_from_camera: Se3,
}

/// Where an exported keyframe's files lie, relative to the export's folder.
pub(crate) struct KeyframeFiles {
    pub image: String,
    /// White where the camera saw something; absent if it saw every pixel.
    pub mask: Option<String>,
    pub world_from_camera: Se3,
}

/// Writes `images/NNNNNN.png`, numbered by frame, and, where the camera did not see every pixel,
/// `masks/NNNNNN.png.png` (COLMAP's names). Images are free of lens distortion and rolling shutter, as
/// the map is.
///
/// # Errors
/// If an image cannot be read or written.
pub(crate) fn write_keyframe_images(
    folder: &Path,
    keyframes: &[Keyframe],
    dataset: &Dataset,
    trajectory: &Trajectory,
    on_image: &mut dyn FnMut() -> ControlFlow<()>,
) -> Result<Vec<KeyframeFiles>, ExportError> {
    keyframes
        .iter()
        .map(|keyframe| {
            let frame = dataset.frame(keyframe.index)?;
            let frame = trajectory.synchronized(&frame);
            let image = format!("images/{:06}.png", keyframe.index);
            write_png(folder, &image, &frame.color, ExtendedColorType::Rgb8)?;
            let mask = match frame.color_valid.as_deref() {
                Some(valid) if valid.data().contains(&false) => {
                    let name = format!("masks/{:06}.png.png", keyframe.index);
                    let white = valid.map(|valid| [if *valid { u8::MAX } else { 0 }]);
                    write_png(folder, &name, &white, ExtendedColorType::L8)?;
                    Some(name)
                }
                _ => None,
            };
            go_on(on_image())?;
            Ok(KeyframeFiles {
                image,
                mask,
                world_from_camera: keyframe.world_from_camera,
            })
        })
        .collect()
}

fn write_png<const N: usize>(
    folder: &Path,
    name: &str,
    image: &Image<[u8; N]>,
    color: ExtendedColorType,
) -> Result<(), ExportError> {
    let size = |pixels: usize| u32::try_from(pixels).map_err(io::Error::other);
    write_in(folder, name, |file| {
        let bytes = image.data().as_flattened();
        let (width, height) = (size(image.width())?, size(image.height())?);
        PngEncoder::new(file)
            .write_image(bytes, width, height, color)
            .map_err(|error| match error {
                ImageError::IoError(error) => error,
                other => io::Error::other(other),
            })
    })
}

/// Writes a file of a folder that is being filled, and the folders on the way to it.
///
/// # Errors
/// If writing fails.
pub(crate) fn write_in(
    folder: &Path,
    name: &str,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), ExportError> {
    let path = folder.join(name);
    let write = || {
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        let mut file = io::BufWriter::new(fs::File::create(&path)?);
        content(&mut file)?;
        file.flush()
    };
    write().map_err(|source| ExportError::Write {
        path: path.clone(),
        source,
    })
}
