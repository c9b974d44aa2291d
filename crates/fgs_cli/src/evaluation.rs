//! Scores a finished run (Sec. IV): the trajectory against the known poses, and the final map,
//! rendered at each tracked frame's estimated pose, against the frame.
//!
//! Means are over frames. Frames are read again as a stream, a few at a time, so memory does not
//! grow with the recording.

use std::sync::atomic::{AtomicBool, Ordering};

use fgs_data::Dataset;
use fgs_eval::{EvalError, ate, depth_error, image_quality, rpe};
use fgs_geom::{Camera, Image, RgbdFrame, Se3, View};
use fgs_splat::{Gaussians, Rasterizer, Rendered};
use rayon::prelude::*;

use crate::console::Console;
use crate::frame_log::FrameRow;
use crate::run_result::RunResult;

/// So many frames are in memory and scored side by side: enough for the cores of a desktop.
const FRAMES_AT_ONCE: usize = 16;

/// Fills in the trajectory's errors where poses are known.
///
/// # Errors
/// If a pose is beyond all bounds.
pub fn score_trajectory(result: &mut RunResult, dataset: &Dataset) -> anyhow::Result<()> {
    let Some(truth) = dataset.ground_truth() else {
        return Ok(());
    };
    let poses = result.trajectory.poses().iter();
    let (estimated, reference): (Vec<Se3>, Vec<Se3>) = poses
        .filter_map(|pose| Some((pose.world_from_camera, truth.at(pose.timestamp_secs)?)))
        .unzip();
    if let Some(ate) = unless_too_few(ate(&estimated, &reference))? {
        result.metrics.ate_rmse_m = Some(ate.translation_m.rmse);
        result.metrics.ate_mean_m = Some(ate.translation_m.mean);
    }
    if let Some(rpe) = unless_too_few(rpe(&estimated, &reference, 1))? {
        result.metrics.rpe_mean_m = Some(rpe.translation_m.mean);
    }
    Ok(())
}

/// A few poses are no failure: their error is just not defined.
fn unless_too_few<T>(scored: Result<T, EvalError>) -> Result<Option<T>, EvalError> {
    match scored {
        Err(EvalError::TooFewPoses { .. }) => Ok(None),
        scored => scored.map(Some),
    }
}

/// Fills in the image metrics of every tracked frame and their means. `false` if it was stopped;
/// then nothing is changed.
///
/// # Errors
/// If a picture cannot be compared, for example because it is smaller than SSIM's window.
pub fn score_images(
    result: &mut RunResult,
    dataset: &Dataset,
    console: Console,
    stop: &AtomicBool,
) -> anyhow::Result<bool> {
    let (Some(first), Some(last)) = (result.rows.first(), result.rows.last()) else {
        return Ok(true);
    };
    let bar = console.progress(result.rows.len(), "evaluation");
    let mut frames = dataset
        .frames(first.index..last.index + 1)
        .zip(&result.rows);
    let mut rows = Vec::with_capacity(result.rows.len());
    loop {
        if stop.load(Ordering::Relaxed) {
            bar.finish_and_clear();
            return Ok(false);
        }
        let batch: Vec<_> = frames.by_ref().take(FRAMES_AT_ONCE).collect();
        if batch.is_empty() {
            break;
        }
        let scored: Vec<FrameRow> = batch
            .par_iter()
            .map_init(Rasterizer::default, |rasterizer, (frame, row)| {
                match (frame, result.pose(row)) {
                    (Ok(frame), Some(pose)) => {
                        score_frame(row, frame, pose, &result.gaussians, rasterizer)
                    }
                    _ => Ok((*row).clone()),
                }
            })
            .collect::<Result<_, EvalError>>()?;
        bar.inc(scored.len() as u64);
        rows.extend(scored);
    }
    bar.finish_and_clear();
    result.rows = rows;
    fill_means(result);
    Ok(true)
}

fn score_frame(
    row: &FrameRow,
    frame: &RgbdFrame,
    world_from_camera: Se3,
    gaussians: &Gaussians,
    rasterizer: &mut Rasterizer,
) -> Result<FrameRow, EvalError> {
    let rendered = render(rasterizer, gaussians, &frame.camera, world_from_camera);
    let color_valid = frame.color_valid.as_deref();
    let quality = image_quality(&rendered.color, &frame.color, &frame.depth_m, color_valid)?;
    let depth_m = Image::from_fn(frame.depth_m.width(), frame.depth_m.height(), |u, v| {
        rendered.surface_depth_m(u, v)
    });
    let depth = depth_error(&depth_m, &rendered.alpha, &frame.depth_m)?;
    Ok(FrameRow {
        psnr_valid_depth_db: quality.psnr_valid_depth_db,
        psnr_db: Some(quality.psnr_db),
        psnr_paper_db: Some(quality.psnr_paper_db),
        ssim: Some(quality.ssim),
        depth_l1_m: depth.map(|depth| depth.l1_m),
        ..row.clone()
    })
}

/// The map as seen from a place.
pub fn render(
    rasterizer: &mut Rasterizer,
    gaussians: &Gaussians,
    camera: &Camera,
    world_from_camera: Se3,
) -> Rendered {
    let view = View {
        camera: *camera,
        world_from_camera,
    };
    rasterizer.render(gaussians, &view).rendered().clone()
}

fn fill_means(result: &mut RunResult) {
    let rows = &result.rows;
    let mean = |value: fn(&FrameRow) -> Option<f64>| mean(rows.iter().filter_map(value));
    let metrics = &mut result.metrics;
    metrics.psnr_valid_depth_db = mean(|row| row.psnr_valid_depth_db);
    metrics.psnr_db = mean(|row| row.psnr_db);
    metrics.psnr_paper_db = mean(|row| row.psnr_paper_db);
    metrics.ssim = mean(|row| row.ssim);
    metrics.depth_l1_m = mean(|row| row.depth_l1_m);
    metrics.psnr_heldout_db = mean(|row| match row.keyframe {
        None => row.psnr_valid_depth_db,
        Some(_) => None,
    });
}

/// `None` of nothing.
pub fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), x| (sum + x, count + 1));
    (count > 0).then(|| sum / count as f64)
}
