//! PNG pictures of what the map looks like, alone or beside the camera's image.

use std::io::{self, Write};

use fgs_data::Dataset;
use fgs_files::StagedFolder;
use fgs_geom::{Image, RgbdFrame, View};
use fgs_splat::Rasterizer;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageError};

use crate::error::RunError;
use crate::frame_log::FrameRow;
use crate::run_folder::{PICTURES, write};
use crate::run_result::RunResult;

/// What the name of the worst frame's picture begins with.
pub const WORST: &str = "worst-frame";
/// What the name of the best frame's picture begins with.
pub const BEST: &str = "best-frame";

/// How many pictures show the run, from its first to its last tracked frame.
const SAMPLES: usize = 5;

/// Writes pictures of a run, the camera's image on the left and the render on the right: some evenly
/// spread over it and, if it was scored, those of its worst and its best frame.
///
/// # Errors
/// If writing fails.
pub fn write_samples(
    result: &RunResult,
    dataset: &Dataset,
    results: &StagedFolder<'_>,
) -> Result<(), RunError> {
    let mut rasterizer = Rasterizer::default();
    for (row, name) in choose(result) {
        // A frame that cannot be read again has no picture.
        if let (Ok(frame), Some(pose)) = (dataset.frame(row.index), result.pose(row)) {
            let view = View {
                camera: frame.camera,
                world_from_camera: pose,
            };
            let pass = rasterizer.render(&result.gaussians, &view);
            let frame = result.trajectory.synchronized(&frame);
            let picture = side_by_side(&frame, &png_bytes(&pass.rendered().color));
            write(results, &format!("{PICTURES}/{name}.png"), |file| {
                write_png(&picture, file)
            })?;
        }
    }
    Ok(())
}

/// Rows with poses and names for their pictures.
fn choose(result: &RunResult) -> Vec<(&FrameRow, String)> {
    let tracked: Vec<_> = result
        .rows
        .iter()
        .filter(|row| result.pose(row).is_some())
        .collect();
    let count = SAMPLES.min(tracked.len());
    let mut chosen: Vec<_> = (0..count)
        .map(|i| {
            let row = tracked[i * (tracked.len() - 1) / (count - 1).max(1)];
            (row, format!("frame-{:06}", row.index))
        })
        .collect();
    let psnr = |row: &FrameRow| {
        let scores = &row.scores;
        scores.get("psnr_valid_depth_db").or(scores.get("psnr_db"))
    };
    let scored = tracked.iter().filter_map(|row| Some((psnr(row)?, *row)));
    let worst = scored.clone().min_by(|a, b| a.0.total_cmp(&b.0));
    let best = scored.max_by(|a, b| a.0.total_cmp(&b.0));
    for (kind, frame) in [(WORST, worst), (BEST, best)] {
        chosen.extend(frame.map(|(_, row)| (row, format!("{kind}-{:06}", row.index))));
    }
    chosen
}

/// Rendered colour, nominally 0 to 1, as bytes.
pub fn png_bytes(color: &Image<[f32; 3]>) -> Image<[u8; 3]> {
    color.map(|pixel| pixel.map(|value| (255.0 * value.clamp(0.0, 1.0)).round() as u8))
}

fn side_by_side(frame: &RgbdFrame, render: &Image<[u8; 3]>) -> Image<[u8; 3]> {
    let width = frame.color.width();
    Image::from_fn(2 * width, frame.color.height(), |u, v| {
        if u < width {
            frame.color.at(u, v)
        } else {
            render.at(u - width, v)
        }
    })
}

/// Encodes a picture as PNG.
///
/// # Errors
/// If writing fails.
pub fn write_png(picture: &Image<[u8; 3]>, writer: impl Write) -> io::Result<()> {
    let size = |pixels: usize| u32::try_from(pixels).map_err(io::Error::other);
    let (width, height) = (size(picture.width())?, size(picture.height())?);
    let bytes = picture.data().as_flattened();
    PngEncoder::new(writer)
        .write_image(bytes, width, height, ExtendedColorType::Rgb8)
        .map_err(|error| match error {
            ImageError::IoError(error) => error,
            other => io::Error::other(other),
        })
}
