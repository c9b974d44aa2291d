//! Frames of a run as camera, map and difference, as pictures that lie in the page.

use std::io;
use std::path::Path;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{self, FilterType};
use image::{ImageError, RgbImage};

use super::run_data::RunData;
use crate::pictures::{BEST, WORST};

/// So many frames at most.
const MAX_FRAMES: usize = 6;
const MAX_WIDTH: u32 = 400;
const JPEG_QUALITY: u8 = 85;
/// So many times the difference is shown, to be seen.
pub const DIFFERENCE_SCALE: u32 = 3;

/// A frame.
pub struct Photo {
    /// The name of its file.
    pub name: String,
    /// Camera, map and difference, as data URIs.
    pub pictures: [String; 3],
}

/// The pictures of a run: the worst and the best frame first. A file that is no picture is left out.
pub fn photos(run: &RunData) -> Vec<Photo> {
    let files = std::fs::read_dir(&run.pictures);
    let names = files.into_iter().flatten().filter_map(|file| {
        let name = file.ok()?.file_name().into_string().ok()?;
        Some(name.strip_suffix(".png")?.to_owned())
    });
    let mut names: Vec<String> = names.collect();
    let rank = |name: &str| [WORST, BEST].iter().position(|kind| name.starts_with(kind));
    names.sort_by_key(|name| (rank(name).unwrap_or(2), name.clone()));
    let photos = names.into_iter().filter_map(|name| {
        let pictures = read(&run.pictures.join(format!("{name}.png"))).ok()?;
        Some(Photo { name, pictures })
    });
    photos.take(MAX_FRAMES).collect()
}

/// A picture holds the camera's image on the left and the map's on the right.
fn read(path: &Path) -> Result<[String; 3], ImageError> {
    let picture = image::open(path)?.into_rgb8();
    let half = |left| {
        let (width, height) = (picture.width() / 2, picture.height());
        let half = imageops::crop_imm(&picture, left, 0, width, height).to_image();
        scaled(half)
    };
    let (camera, map) = (half(0), half(picture.width() / 2));
    let mut difference = camera.clone();
    for (value, map) in difference.iter_mut().zip(map.iter()) {
        let scaled = DIFFERENCE_SCALE * u32::from(value.abs_diff(*map));
        *value = scaled.min(255) as u8;
    }
    Ok([data_uri(&camera)?, data_uri(&map)?, data_uri(&difference)?])
}

fn scaled(picture: RgbImage) -> RgbImage {
    let (width, height) = picture.dimensions();
    if width <= MAX_WIDTH {
        return picture;
    }
    let height = (u64::from(height) * u64::from(MAX_WIDTH) / u64::from(width)).max(1);
    imageops::resize(&picture, MAX_WIDTH, height as u32, FilterType::Triangle)
}

fn data_uri(picture: &RgbImage) -> Result<String, ImageError> {
    let mut jpeg = io::Cursor::new(Vec::new());
    JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY).encode_image(picture)?;
    let bytes = BASE64_STANDARD.encode(jpeg.into_inner());
    Ok(format!("data:image/jpeg;base64,{bytes}"))
}
