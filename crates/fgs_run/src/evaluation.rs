//! Scores a finished run (Sec. IV): the trajectory against the ground truth, and the final map,
//! rendered at each tracked frame's estimated pose, against the frame.
//!
//! Frames are read again as a stream, a few at a time, so memory does not grow with the recording.

use std::sync::atomic::{AtomicBool, Ordering};

use fgs_data::{Dataset, Trajectory};
use fgs_eval::{EvalError, ate, depth_error, image_quality, rpe};
use fgs_geom::{Image, RgbdFrame, Se3, View};
use fgs_splat::{Gaussians, Rasterizer};
use rayon::prelude::*;

use crate::error::RunError;
use crate::frame_log::FrameRow;
use crate::observer::{RunEvent, RunObserver};
use crate::run_result::RunResult;
use crate::scores::{FrameErrors, Scores, TrajectoryErrors};

/// So many frames are in memory and scored side by side: enough for the cores of a desktop.
const FRAMES_AT_ONCE: usize = 16;

impl RunResult {
    /// Fills in the trajectory's errors where the recording has ground truth.
    ///
    /// # Errors
    /// If a pose is too large to compute with.
    pub fn score_trajectory(&mut self, dataset: &Dataset) -> Result<(), RunError> {
        let Some(truth) = dataset.ground_truth() else {
            return Ok(());
        };
        let poses = self.trajectory.poses().iter();
        let (estimated, reference): (Vec<Se3>, Vec<Se3>) = poses
            .filter_map(|pose| Some((pose.world_from_camera, truth.at(pose.timestamp_secs)?)))
            .unzip();
        self.metrics.scores.set_trajectory(&TrajectoryErrors {
            ate: unless_too_few(ate(&estimated, &reference))?,
            rpe: unless_too_few(rpe(&estimated, &reference, 1))?,
        });
        Ok(())
    }

    /// Fills in every tracked frame's scores and their means. `false` if it was stopped; then
    /// nothing is changed.
    ///
    /// # Errors
    /// If a frame cannot be compared, for example because it is smaller than SSIM's window.
    pub fn score_images(
        &mut self,
        dataset: &Dataset,
        observer: &mut dyn RunObserver,
        stop: &AtomicBool,
    ) -> Result<bool, RunError> {
        let (rows, trajectory) = (&mut self.rows, &self.trajectory);
        let done = score_images(rows, trajectory, &self.gaussians, dataset, observer, stop)?;
        if done {
            self.metrics.scores.set_means(&self.rows);
        }
        Ok(done)
    }
}

/// Too few poses are no failure: their error is just not defined.
fn unless_too_few<T>(scored: Result<T, EvalError>) -> Result<Option<T>, EvalError> {
    match scored {
        Err(EvalError::TooFewPoses { .. }) => Ok(None),
        scored => scored.map(Some),
    }
}

/// Renders the map at the pose of each row, found in `trajectory` by its time stamp, and compares it
/// with the frame of the recording. Rows are of successive frames; those without a pose, or whose
/// frame cannot be read, are left as they are. `false` if it was stopped; then no row is changed.
///
/// # Errors
/// If a frame cannot be compared, for example because it is smaller than SSIM's window.
pub fn score_images(
    rows: &mut [FrameRow],
    trajectory: &Trajectory,
    gaussians: &Gaussians,
    dataset: &Dataset,
    observer: &mut dyn RunObserver,
    stop: &AtomicBool,
) -> Result<bool, RunError> {
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else {
        return Ok(true);
    };
    let mut frames = dataset.frames(first.index..last.index + 1).zip(rows.iter());
    let mut scores: Vec<Option<Scores>> = Vec::with_capacity(rows.len());
    while scores.len() < rows.len() {
        if stop.load(Ordering::Relaxed) {
            return Ok(false);
        }
        let batch: Vec<_> = frames.by_ref().take(FRAMES_AT_ONCE).collect();
        if batch.is_empty() {
            break;
        }
        let scored: Vec<_> = batch
            .par_iter()
            .map_init(Rasterizer::default, |rasterizer, (frame, row)| {
                let pose = row.timestamp_secs.and_then(|secs| trajectory.at(secs));
                match (frame, pose) {
                    (Ok(frame), Some(pose)) => {
                        score_frame(frame, pose, gaussians, rasterizer).map(Some)
                    }
                    _ => Ok(None),
                }
            })
            .collect::<Result<_, EvalError>>()?;
        scores.extend(scored);
        observer.on(&RunEvent::Scored {
            done: scores.len(),
            total: rows.len(),
        });
    }
    drop(frames);
    for (row, scores) in rows.iter_mut().zip(scores) {
        if let Some(scores) = scores {
            row.scores = scores;
        }
    }
    Ok(true)
}

fn score_frame(
    frame: &RgbdFrame,
    world_from_camera: Se3,
    gaussians: &Gaussians,
    rasterizer: &mut Rasterizer,
) -> Result<Scores, EvalError> {
    let view = View {
        camera: frame.camera,
        world_from_camera,
    };
    let pass = rasterizer.render(gaussians, &view);
    let rendered = pass.rendered();
    let depth_m = Image::from_fn(frame.depth_m.width(), frame.depth_m.height(), |u, v| {
        rendered.surface_depth_m(u, v)
    });
    Ok(Scores::of_frame(&FrameErrors {
        image: image_quality(
            &rendered.color,
            &frame.color,
            &frame.depth_m,
            frame.color_valid.as_deref(),
        )?,
        depth: depth_error(&depth_m, &rendered.alpha, &frame.depth_m)?,
    }))
}
