//! Frames whose images are files of their own in a folder or an archive.

use std::io::Read;
use std::path::Path;

use fgs_data::{DataError, FrameImages, FrameSource, decode_color, decode_depth, image_size};
use fgs_geom::{Camera, Image, Intrinsics, depth_from_raw};
use image::{DynamicImage, ImageReader};
use lzfse_rust::LzfseRingDecoder;

use crate::fault::fault;
use crate::tree::Tree;
use crate::video::Video;
use crate::working_image::WorkingImage;

/// An encoded colour image of 100 megapixels at most, or depth of a few.
const MAX_IMAGE_BYTES: u64 = 512 * 1024 * 1024;

/// A hundred megapixels, as of any camera.
const MAX_PIXELS: usize = 100_000_000;

/// One frame's files.
pub(crate) struct TreeFrame {
    pub color: ColorFile,
    pub depth: String,
    pub confidence: Option<String>,
    /// Of its colour image as it comes, where frames have their own.
    pub intrinsics: Option<Intrinsics>,
}

/// Where a colour image is.
pub(crate) enum ColorFile {
    /// In a file of its own.
    Own(String),
    /// In the recording's video, so many frames after the first.
    InVideo(usize),
}

/// How depth is stored.
#[derive(Clone, Copy)]
pub(crate) enum DepthCoding {
    /// A PNG image of 16 bits; so many units are a metre.
    Png { units_per_m: f32 },
    /// Metres as 32-bit numbers, little-endian, row by row, in LZFSE or bare; and confidence in the same
    /// way, a byte each. The image's columns and rows.
    Numbers { size: (usize, usize) },
}

/// The frames of a recording.
pub(crate) struct TreeFrames {
    tree: Tree,
    /// Colour, where it is not in files of its own.
    video: Option<Video>,
    frames: Vec<TreeFrame>,
    depth_coding: DepthCoding,
    working: WorkingImage,
}

/// Columns and rows of an image, from its header.
pub(crate) fn size_of(tree: &Tree, name: &str) -> Result<(usize, usize), DataError> {
    let path = tree.shown(name);
    let (width, height) = image_size(tree.read(name, MAX_IMAGE_BYTES)?, &path)?;
    let size = (width as usize, height as usize);
    if size.0.saturating_mul(size.1) > MAX_PIXELS {
        return Err(fault(&path, "has more than 100 megapixels".into()));
    }
    Ok(size)
}

impl FrameSource for TreeFrames {
    fn read(&self, index: usize) -> Result<FrameImages, DataError> {
        let frame = self.frames.get(index).ok_or(DataError::NoSuchFrame {
            index,
            len: self.frames.len(),
        })?;
        let color = self.color(&frame.color)?;
        let mut depth_m = self.depth(&frame.depth)?;
        if let Some(name) = &frame.confidence {
            for (depth, confidence) in depth_m.data_mut().iter_mut().zip(self.confidence(name)?) {
                if confidence == 0 {
                    *depth = 0.0;
                }
            }
        }
        let own = frame.intrinsics.as_ref();
        Ok(self.working.images(&color, &depth_m, own))
    }
}

impl TreeFrames {
    /// Frames whose colour images are files of this size, and by it of these intrinsics. `path` is the file that
    /// says what the camera is.
    ///
    /// # Errors
    /// If they do not fit together, or the first frame's depth image cannot be read.
    pub(crate) fn new(
        tree: Tree,
        frames: Vec<TreeFrame>,
        depth_coding: DepthCoding,
        (width, height): (usize, usize),
        intrinsics: Intrinsics,
        path: &Path,
    ) -> Result<Self, DataError> {
        let depth_size = match (depth_coding, frames.first()) {
            (DepthCoding::Numbers { size }, _) => size,
            (DepthCoding::Png { .. }, Some(first)) => size_of(&tree, &first.depth)?,
            (DepthCoding::Png { .. }, None) => return Err(fault(path, "has no frame".into())),
        };
        let native =
            Camera::new(width, height, intrinsics).map_err(|source| DataError::Camera {
                path: path.into(),
                source,
            })?;
        let working = WorkingImage::new(&native, depth_size);
        Ok(Self {
            working: working.map_err(|message| fault(path, message))?,
            tree,
            video: None,
            frames,
            depth_coding,
        })
    }

    /// The same, whose colour images may be in a video.
    pub(crate) fn with_video(self, video: Option<Video>) -> Self {
        Self { video, ..self }
    }

    /// The camera of the frames as they are given out.
    pub(crate) fn camera(&self) -> Camera {
        *self.working.camera()
    }

    /// A colour image as it comes.
    fn color(&self, file: &ColorFile) -> Result<Image<[u8; 3]>, DataError> {
        let size = self.working.color_size();
        match (file, &self.video) {
            (ColorFile::Own(name), _) => {
                let bytes = self.tree.read(name, MAX_IMAGE_BYTES)?;
                decode_color(bytes, &self.tree.shown(name), size).map_err(plain_size)
            }
            (ColorFile::InVideo(place), Some(video)) => {
                let image = video.frame(*place)?;
                if (image.width(), image.height()) == size {
                    return Ok(image);
                }
                Err(fault(video.path(), "its images change their size".into()))
            }
            (ColorFile::InVideo(_), None) => {
                Err(fault(&self.tree.shown(""), "has no video".into()))
            }
        }
    }

    /// A depth image as it comes, metres.
    fn depth(&self, name: &str) -> Result<Image<f32>, DataError> {
        let (path, size) = (self.tree.shown(name), self.working.depth_size());
        let bytes = self.tree.read(name, MAX_IMAGE_BYTES)?;
        match self.depth_coding {
            DepthCoding::Png { units_per_m } => {
                let raw = decode_depth(bytes, &path, size).map_err(plain_size)?;
                Ok(depth_from_raw(&raw, units_per_m, 0))
            }
            DepthCoding::Numbers {
                size: (width, height),
            } => {
                let bytes = numbers(bytes, 4 * width * height, &path)?;
                let (values, _) = bytes.as_chunks();
                let values = values.iter().map(|bytes| f32::from_le_bytes(*bytes));
                // Not a number is what some recorders write for none.
                let metres = values.map(|depth| if depth.is_finite() { depth } else { 0.0 });
                Image::new(width, height, metres.collect())
                    .map_err(|error| fault(&path, error.to_string()))
            }
        }
    }

    /// How sure each pixel's depth is; 0 is the least of a few levels.
    fn confidence(&self, name: &str) -> Result<Vec<u8>, DataError> {
        let (path, (width, height)) = (self.tree.shown(name), self.working.depth_size());
        let bytes = self.tree.read(name, MAX_IMAGE_BYTES)?;
        match self.depth_coding {
            DepthCoding::Numbers { .. } => numbers(bytes, width * height, &path),
            DepthCoding::Png { .. } => {
                let refuse = |what: &str| fault(&path, what.to_owned());
                if image_size(bytes.clone(), &path)? != (width as u32, height as u32) {
                    return Err(refuse("confidence has another size than depth"));
                }
                let reader = ImageReader::new(std::io::Cursor::new(bytes));
                let reader = reader.with_guessed_format();
                let decoded = reader.map(ImageReader::decode);
                match decoded {
                    Ok(Ok(DynamicImage::ImageLuma8(image))) => Ok(image.into_raw()),
                    Ok(Ok(_)) => Err(refuse("confidence must be one channel of 8 bits")),
                    Ok(Err(error)) => Err(refuse(&error.to_string())),
                    Err(error) => Err(refuse(&error.to_string())),
                }
            }
        }
    }
}

/// `len` bytes, as they are or in LZFSE.
fn numbers(bytes: Vec<u8>, len: usize, path: &Path) -> Result<Vec<u8>, DataError> {
    if bytes.len() == len {
        return Ok(bytes);
    }
    let mut decoded = Vec::new();
    let mut decoder = LzfseRingDecoder::default();
    decoder
        .reader_bytes(&bytes)
        .take(len as u64 + 1)
        .read_to_end(&mut decoded)
        .map_err(|error| fault(path, format!("is no LZFSE data: {error}")))?;
    if decoded.len() != len {
        let found = if decoded.len() > len { "more" } else { "fewer" };
        return Err(fault(path, format!("holds {found} than {len} bytes")));
    }
    Ok(decoded)
}

/// The same in words that fit a recording whose images need not have the camera's size.
fn plain_size(error: DataError) -> DataError {
    match error {
        DataError::ImageSize {
            path,
            width,
            height,
            camera_width,
            camera_height,
        } => fault(
            &path,
            format!(
                "is {width}x{height}, but the recording's first is {camera_width}x{camera_height}"
            ),
        ),
        error => error,
    }
}
