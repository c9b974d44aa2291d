//! The messages of ROS 2 that a camera sends: `sensor_msgs/msg/Image`, `CompressedImage`, `CameraInfo`.

use std::path::Path;

use fgs_data::{DataError, decode_color, decode_depth, image_size};
use fgs_geom::{Image, depth_from_raw};

use crate::cdr::{CdrReader, NotCdr};
use crate::fault::fault;

/// A hundred megapixels, as of any camera.
const MAX_PIXELS: usize = 100_000_000;

/// OpenCV's longest list of coefficients.
const MAX_COEFFICIENTS: u32 = 14;

/// What `compressed_depth_image_transport` puts before its image: what it is, and two numbers.
const DEPTH_HEADER_BYTES: usize = 12;

/// Units a metre of 16-bit depth (REP 118).
const UNITS_PER_M: f32 = 1000.0;

/// When and where a message was measured.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Header {
    pub secs: f64,
    pub frame: String,
}

/// An image, still encoded.
pub(crate) struct RosImage<'a> {
    pub header: Header,
    pub encoding: Encoding<'a>,
    data: &'a [u8],
}

/// How an image's pixels are stored.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Encoding<'a> {
    /// Pixel by pixel, by ROS's name for it.
    Raw {
        width: usize,
        height: usize,
        name: &'a str,
        is_big_endian: bool,
        /// Bytes a row.
        step: usize,
    },
    /// A PNG or JPEG image, by the transport's name for it.
    Compressed(&'a str),
}

/// A camera's calibration.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CameraInfo {
    pub header: Header,
    pub width: usize,
    pub height: usize,
    pub distortion_model: String,
    pub d: Vec<f64>,
    /// Of images as they come, row by row.
    pub k: [f64; 9],
    /// Of rectified images, row by row.
    pub p: [f64; 12],
}

impl Header {
    pub fn read(reader: &mut CdrReader<'_>) -> Result<Self, NotCdr> {
        let (seconds, nanoseconds) = (reader.i32()?, reader.u32()?);
        Ok(Self {
            secs: f64::from(seconds) + f64::from(nanoseconds) / 1e9,
            frame: reader.string()?.to_owned(),
        })
    }
}

impl CameraInfo {
    pub fn read(message: &[u8]) -> Result<Self, NotCdr> {
        let reader = &mut CdrReader::new(message)?;
        let header = Header::read(reader)?;
        let (height, width) = (reader.u32()? as usize, reader.u32()? as usize);
        let distortion_model = reader.string()?.to_owned();
        let d = reader.f64_sequence(MAX_COEFFICIENTS)?;
        let k = reader.f64s()?;
        let _rectification: [f64; 9] = reader.f64s()?;
        Ok(Self {
            header,
            width,
            height,
            distortion_model,
            d,
            k,
            p: reader.f64s()?,
        })
    }
}

impl<'a> RosImage<'a> {
    pub fn read(message: &'a [u8]) -> Result<Self, NotCdr> {
        let reader = &mut CdrReader::new(message)?;
        let header = Header::read(reader)?;
        let (height, width) = (reader.u32()? as usize, reader.u32()? as usize);
        let name = reader.string()?;
        let is_big_endian = reader.u8()? != 0;
        let step = reader.u32()? as usize;
        Ok(Self {
            header,
            encoding: Encoding::Raw {
                width,
                height,
                name,
                is_big_endian,
                step,
            },
            data: reader.bytes()?,
        })
    }

    pub fn read_compressed(message: &'a [u8]) -> Result<Self, NotCdr> {
        let reader = &mut CdrReader::new(message)?;
        Ok(Self {
            header: Header::read(reader)?,
            encoding: Encoding::Compressed(reader.string()?),
            data: reader.bytes()?,
        })
    }

    /// Whether it holds depth; `None` if it is neither depth nor a colour image that is understood.
    pub fn is_depth(&self) -> Option<bool> {
        match self.encoding {
            Encoding::Raw { name, .. } => match name {
                "16UC1" | "mono16" | "32FC1" => Some(true),
                name => color_channels(name).map(|_| false),
            },
            Encoding::Compressed(format) => {
                let is_depth = format.starts_with("16UC1") || format.starts_with("32FC1");
                Some(is_depth || format.contains("compressedDepth"))
            }
        }
    }

    /// Whether its colour is grey.
    pub fn is_grey(&self) -> bool {
        match self.encoding {
            Encoding::Raw { name, .. } => name == "mono8" || name == "8UC1",
            Encoding::Compressed(format) => format.starts_with("mono"),
        }
    }

    /// Columns and rows. `path` is for messages.
    pub fn size(&self, path: &Path) -> Result<(usize, usize), DataError> {
        let size = match self.encoding {
            Encoding::Raw { width, height, .. } => (width, height),
            Encoding::Compressed(_) => {
                let (width, height) = image_size(self.picture().to_vec(), path)?;
                (width as usize, height as usize)
            }
        };
        if size.0.saturating_mul(size.1) > MAX_PIXELS {
            return Err(fault(path, "an image has more than 100 megapixels".into()));
        }
        Ok(size)
    }

    /// The colour image, which must have this size.
    pub fn color(&self, path: &Path, size: (usize, usize)) -> Result<Image<[u8; 3]>, DataError> {
        let Encoding::Raw { name, .. } = self.encoding else {
            return decode_color(self.data.to_vec(), path, size);
        };
        let Some((channels, places)) = color_channels(name) else {
            return Err(not_understood(path, name));
        };
        let rows = self.rows(path, size, channels)?;
        let pixels = rows.flat_map(|row| row.chunks_exact(channels));
        let pixels = pixels.map(|pixel| places.map(|place| pixel[place]));
        into_image(pixels.collect(), path, size)
    }

    /// The depth image in metres, which must have this size.
    pub fn depth_m(&self, path: &Path, size: (usize, usize)) -> Result<Image<f32>, DataError> {
        match self.encoding {
            Encoding::Raw {
                name: "16UC1" | "mono16",
                is_big_endian,
                ..
            } => {
                let rows = self.rows(path, size, 2)?;
                let values = rows.flat_map(|row| row.as_chunks().0).map(|bytes| {
                    if is_big_endian {
                        u16::from_be_bytes(*bytes)
                    } else {
                        u16::from_le_bytes(*bytes)
                    }
                });
                let raw = into_image(values.collect(), path, size)?;
                Ok(depth_from_raw(&raw, UNITS_PER_M, 0))
            }
            Encoding::Raw {
                name: "32FC1",
                is_big_endian,
                ..
            } => {
                let rows = self.rows(path, size, 4)?;
                let values = rows.flat_map(|row| row.as_chunks().0).map(|bytes| {
                    if is_big_endian {
                        f32::from_be_bytes(*bytes)
                    } else {
                        f32::from_le_bytes(*bytes)
                    }
                });
                into_image(values.map(measured).collect(), path, size)
            }
            Encoding::Raw { name, .. } => Err(not_understood(path, name)),
            Encoding::Compressed(format) => {
                let raw = decode_depth(self.picture().to_vec(), path, size)?;
                Ok(match self.inverse_depth(format) {
                    None => depth_from_raw(&raw, UNITS_PER_M, 0),
                    Some([a, b]) => raw.map(|&value| match value {
                        0 => 0.0,
                        value => measured(a / (f32::from(value) - b)),
                    }),
                })
            }
        }
    }

    /// The PNG or JPEG image in a compressed one.
    fn picture(&self) -> &'a [u8] {
        match self.encoding {
            Encoding::Compressed(format) if format.contains("compressedDepth") => {
                self.data.get(DEPTH_HEADER_BYTES..).unwrap_or_default()
            }
            _ => self.data,
        }
    }

    /// `a` and `b` of depth that is stored as `a / depth + b`; `None` if it is stored as it is.
    fn inverse_depth(&self, format: &str) -> Option<[f32; 2]> {
        let is_inverse = format.starts_with("32FC1") && format.contains("compressedDepth");
        let [_, a, b]: [[u8; 4]; 3] = self.data.as_chunks().0.get(..3)?.try_into().ok()?;
        is_inverse.then(|| [a, b].map(f32::from_le_bytes))
    }

    /// The rows of a raw image without what pads them.
    fn rows(
        &self,
        path: &Path,
        size: (usize, usize),
        bytes_per_pixel: usize,
    ) -> Result<impl Iterator<Item = &'a [u8]>, DataError> {
        let Encoding::Raw {
            width,
            height,
            step,
            ..
        } = self.encoding
        else {
            return Err(fault(path, "an image is not raw".into()));
        };
        if (width, height) != size {
            return Err(fault(
                path,
                format!(
                    "an image is {width}x{height}, but the first is {}x{}",
                    size.0, size.1
                ),
            ));
        }
        let used = width.saturating_mul(bytes_per_pixel);
        if used == 0 || step < used || self.data.len() / step < height {
            return Err(fault(path, "an image has fewer bytes than pixels".into()));
        }
        let rows = self.data.chunks_exact(step).take(height);
        Ok(rows.map(move |row| &row[..used]))
    }
}

/// Bytes a pixel of a colour encoding, and where red, green and blue are among them.
fn color_channels(name: &str) -> Option<(usize, [usize; 3])> {
    match name {
        "rgb8" => Some((3, [0, 1, 2])),
        "bgr8" | "8UC3" => Some((3, [2, 1, 0])),
        "rgba8" => Some((4, [0, 1, 2])),
        "bgra8" | "8UC4" => Some((4, [2, 1, 0])),
        "mono8" | "8UC1" => Some((1, [0; 3])),
        _ => None,
    }
}

/// None is not a number, or infinite, in floating-point depth (REP 117).
fn measured(depth_m: f32) -> f32 {
    if depth_m.is_finite() { depth_m } else { 0.0 }
}

fn into_image<T>(pixels: Vec<T>, path: &Path, size: (usize, usize)) -> Result<Image<T>, DataError> {
    Image::new(size.0, size.1, pixels).map_err(|error| fault(path, error.to_string()))
}

fn not_understood(path: &Path, name: &str) -> DataError {
    fault(
        path,
        format!("images encoded as {name:?} are not understood"),
    )
}
