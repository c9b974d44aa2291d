//! Decodes a colour or depth image (PNG or JPEG).
//!
//! Size and pixel type are checked before any pixel is decoded, so that memory is bounded by the
//! camera's size, whatever the file's header claims.

use std::io::{Cursor, Read};
use std::path::Path;

use fgs_geom::{Camera, Image};
use image::{ColorType, DynamicImage, ImageDecoder, ImageError, ImageReader};

use crate::DataError;

/// More than the largest camera's image (100 megapixels of four bytes) takes uncompressed.
const MAX_FILE_BYTES: u64 = 512 * 1024 * 1024;

/// An image's columns and rows, from its header.
pub(crate) fn read_size(path: &Path) -> Result<(u32, u32), DataError> {
    image_size(read_bytes(path)?, path)
}

/// An encoded image's columns and rows, from its header. `path` is only used in error messages.
///
/// # Errors
/// If it is no PNG or JPEG image.
pub fn image_size(bytes: Vec<u8>, path: &Path) -> Result<(u32, u32), DataError> {
    reader(bytes, path)?
        .into_dimensions()
        .map_err(|source| image_error(path, source))
}

/// A colour image with 8 bits a channel: grey is spread over the channels, alpha dropped.
pub(crate) fn read_color(path: &Path, camera: &Camera) -> Result<Image<[u8; 3]>, DataError> {
    decode_color(read_bytes(path)?, path, (camera.width, camera.height))
}

/// A depth image of one 16-bit channel, values as in the file.
pub(crate) fn read_depth(path: &Path, camera: &Camera) -> Result<Image<u16>, DataError> {
    decode_depth(read_bytes(path)?, path, (camera.width, camera.height))
}

/// Decodes a colour image with 8 bits a channel: grey is spread over the channels, alpha dropped.
/// `size` is the columns and rows that it must have; `path` is only used in error messages.
///
/// # Errors
/// If it is no PNG or JPEG image, or has another size or other channels.
pub fn decode_color(
    bytes: Vec<u8>,
    path: &Path,
    size: (usize, usize),
) -> Result<Image<[u8; 3]>, DataError> {
    let decoder = decoder(bytes, path)?;
    let (_, bits) = channels_and_bits(&decoder);
    if bits != 8 {
        return Err(DataError::ColorBits {
            path: path.into(),
            bits,
        });
    }
    if decoder.color_type() != ColorType::Rgb8 {
        let pixels = decode(decoder, path, size)?.into_rgb8().into_raw();
        return into_image(pixels.as_chunks().0.to_vec(), path, size);
    }
    // The usual case goes straight to where it stays.
    check_size(&decoder, path, size)?;
    let mut pixels = vec![[0; 3]; size.0 * size.1];
    decoder
        .read_image(pixels.as_flattened_mut())
        .map_err(|source| image_error(path, source))?;
    into_image(pixels, path, size)
}

/// Decodes a depth image of one 16-bit channel, values as they are; see [`decode_color`].
///
/// # Errors
/// If it is no such image, or has another size.
pub fn decode_depth(
    bytes: Vec<u8>,
    path: &Path,
    size: (usize, usize),
) -> Result<Image<u16>, DataError> {
    let decoder = decoder(bytes, path)?;
    let (channels, bits) = channels_and_bits(&decoder);
    if (channels, bits) != (1, 16) {
        return Err(DataError::DepthBits {
            path: path.into(),
            channels,
            bits,
        });
    }
    let pixels = decode(decoder, path, size)?.into_luma16().into_raw();
    into_image(pixels, path, size)
}

fn decoder(bytes: Vec<u8>, path: &Path) -> Result<impl ImageDecoder, DataError> {
    reader(bytes, path)?
        .into_decoder()
        .map_err(|source| image_error(path, source))
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, DataError> {
    let read = || {
        let file = fgs_files::open_regular(path)?;
        let len = file.metadata()?.len().min(MAX_FILE_BYTES);
        let mut bytes = Vec::with_capacity(len as usize + 1);
        file.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    let bytes: Vec<u8> = read().map_err(|source| io_error(path, source))?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(DataError::FileSize {
            path: path.into(),
            max_bytes: MAX_FILE_BYTES,
        });
    }
    Ok(bytes)
}

fn reader(bytes: Vec<u8>, path: &Path) -> Result<ImageReader<Cursor<Vec<u8>>>, DataError> {
    if bytes.starts_with(&[0xff, 0xd8]) && !is_complete_jpeg(&bytes) {
        return Err(DataError::Truncated(path.into()));
    }
    ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|source| io_error(path, source))
}

fn io_error(path: &Path, source: std::io::Error) -> DataError {
    DataError::Io {
        path: path.into(),
        source,
    }
}

/// Whether an end marker follows the last start of a scan. The JPEG decoder does not look: it
/// fills what is missing with grey. (Neither marker can occur inside a scan.)
fn is_complete_jpeg(bytes: &[u8]) -> bool {
    const START_OF_SCAN: [u8; 2] = [0xff, 0xda];
    const END_OF_IMAGE: [u8; 2] = [0xff, 0xd9];
    let mut markers = bytes
        .windows(2)
        .rev()
        .filter(|m| *m == START_OF_SCAN || *m == END_OF_IMAGE);
    markers.next().is_some_and(|last| last == END_OF_IMAGE)
}

fn channels_and_bits(decoder: &impl ImageDecoder) -> (u8, u16) {
    let color = decoder.color_type();
    let channels = color.channel_count();
    (channels, color.bits_per_pixel() / u16::from(channels))
}

fn decode(
    decoder: impl ImageDecoder,
    path: &Path,
    size: (usize, usize),
) -> Result<DynamicImage, DataError> {
    check_size(&decoder, path, size)?;
    DynamicImage::from_decoder(decoder).map_err(|source| image_error(path, source))
}

fn check_size(
    decoder: &impl ImageDecoder,
    path: &Path,
    size: (usize, usize),
) -> Result<(), DataError> {
    let (width, height) = decoder.dimensions();
    if (width as usize, height as usize) == size {
        Ok(())
    } else {
        Err(size_error((width, height), path, size))
    }
}

fn into_image<T>(pixels: Vec<T>, path: &Path, size: (usize, usize)) -> Result<Image<T>, DataError> {
    Image::new(size.0, size.1, pixels).map_err(|_| size_error((0, 0), path, size))
}

fn size_error((width, height): (u32, u32), path: &Path, expected: (usize, usize)) -> DataError {
    DataError::ImageSize {
        path: path.into(),
        width,
        height,
        camera_width: expected.0,
        camera_height: expected.1,
    }
}

fn image_error(path: &Path, error: ImageError) -> DataError {
    DataError::Image {
        path: path.into(),
        message: error.to_string(),
    }
}
