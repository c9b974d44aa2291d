//! PNG pictures of what the map looks like, alone or beside the camera's image.

use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use fgs_data::Dataset;
use fgs_files::StagedFolder;
use fgs_geom::{Image, RgbdFrame, View};
use fgs_splat::{Gaussians, Rasterizer};
use png::{ColorType, Compression, Encoder, Filter, Writer};

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

/// Pixels that are rendered at a time, about 30 bytes each: all of a usual picture, and enough for bands
/// of a large one that projecting the map for each costs little.
const BAND_PIXELS: usize = 4 << 20;

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
            let picture = side_by_side(&frame, &pass.rendered().color_bytes());
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
    let mut png = begin_png(writer, picture.width(), picture.height())?;
    let mut rows = png.stream_writer()?;
    rows.write_all(picture.data().as_flattened())?;
    rows.finish()?;
    Ok(png.finish()?)
}

/// Renders a view and encodes it as PNG, some rows at a time: pictures of any size take little memory.
/// Once `stop` is set it ends with an error.
///
/// # Errors
/// If writing fails.
pub fn render_png(
    rasterizer: &mut Rasterizer,
    gaussians: &Gaussians,
    view: &View,
    writer: impl Write,
    stop: &AtomicBool,
) -> io::Result<()> {
    let mut png = begin_png(writer, view.camera.width, view.camera.height)?;
    let mut rows = png.stream_writer()?;
    rasterizer.render_bands(gaussians, view, BAND_PIXELS, |band| {
        if stop.load(Ordering::Relaxed) {
            return Err(io::ErrorKind::Interrupted.into());
        }
        rows.write_all(band.color_bytes().data().as_flattened())
    })?;
    rows.finish()?;
    Ok(png.finish()?)
}

/// To take a picture's rows from top to bottom.
fn begin_png<W: Write>(writer: W, width: usize, height: usize) -> io::Result<Writer<W>> {
    let size = |pixels: usize| u32::try_from(pixels).map_err(io::Error::other);
    let mut encoder = Encoder::new(writer, size(width)?, size(height)?);
    encoder.set_color(ColorType::Rgb);
    encoder.set_compression(Compression::Fast);
    encoder.set_filter(Filter::Adaptive);
    Ok(encoder.write_header()?)
}
