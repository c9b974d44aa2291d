//! Scores a finished run (Sec. IV): the trajectory against the ground truth, and the map,
//! rendered at each tracked frame's estimated pose, against the frame. A render is that of a global
//! shutter; so is what it is compared with, as it is free of lens distortion too.
//!
//! Frames are read again as a stream, a few at a time, so memory does not grow with the recording.

use std::iter;
use std::sync::atomic::{AtomicBool, Ordering};

use fgs_data::{Dataset, PoseOrigin, Trajectory};
use fgs_eval::{EvalError, ate, depth_error, image_quality, rpe};
use fgs_geom::{Camera, Image, RgbdFrame, Se3, View};
use fgs_splat::{Gaussians, Rasterizer};
use rayon::prelude::*;

use crate::error::RunError;
use crate::frame_log::FrameRow;
use crate::observer::{RunEvent, RunObserver};
use crate::run_result::RunResult;
use crate::score_values::Scores;
use crate::scores::{FrameErrors, TrajectoryErrors};

/// So many frames are in memory and scored side by side: enough for the cores of a desktop.
const FRAMES_AT_ONCE: usize = 16;

/// The most pixels in memory at once, where frames are large: with what a frame's scores take, some
/// hundred bytes a pixel, half a gigabyte.
const PIXELS_AT_ONCE: usize = 5_000_000;

impl RunResult {
    /// Fills in the trajectory's errors where the recording has poses, and says whether they are the truth.
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
        self.metrics.reference_is_device = dataset.pose_origin() == PoseOrigin::Device;
        self.metrics.scores.set_trajectory(&TrajectoryErrors {
            ate: unless_too_few(ate(&estimated, &reference))?,
            rpe: unless_too_few(rpe(&estimated, &reference, 1))?,
        });
        Ok(())
    }

    /// Fills in every tracked frame's scores and their means; of the refined map, if there is one, only
    /// the means. `false` if it was stopped; then nothing is changed.
    ///
    /// # Errors
    /// If a frame cannot be compared, for example because it is smaller than SSIM's window.
    pub fn score_images(
        &mut self,
        dataset: &Dataset,
        observer: &mut dyn RunObserver,
        stop: &AtomicBool,
    ) -> Result<bool, RunError> {
        let (rows, trajectory, metrics) = (&mut self.rows, &self.trajectory, &mut self.metrics);
        let maps: Vec<&Gaussians> = iter::once(&self.gaussians).chain(&self.refined).collect();
        let Some(scores) = score_maps(rows, trajectory, &maps, dataset, observer, stop)? else {
            return Ok(false);
        };
        let mut scores = scores.into_iter();
        set_scores(rows, scores.next());
        metrics.scores.set_means(rows, metrics.eval_holdout);
        if let Some(refined) = &mut metrics.refined {
            let mut rows = rows.clone();
            for row in &mut rows {
                row.scores = Scores::default();
            }
            set_scores(&mut rows, scores.next());
            refined.scores.set_means(&rows, metrics.eval_holdout);
        }
        Ok(true)
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
    let maps = [gaussians];
    let Some(scores) = score_maps(rows, trajectory, &maps, dataset, observer, stop)? else {
        return Ok(false);
    };
    set_scores(rows, scores.into_iter().next());
    Ok(true)
}

/// The scores of each row, `None` where it has none.
type RowScores = Vec<Option<Scores>>;

/// Does what [`score_images`] describes with several maps, and returns the scores with each of them.
fn score_maps(
    rows: &[FrameRow],
    trajectory: &Trajectory,
    maps: &[&Gaussians],
    dataset: &Dataset,
    observer: &mut dyn RunObserver,
    stop: &AtomicBool,
) -> Result<Option<Vec<RowScores>>, RunError> {
    let mut scores: Vec<RowScores> = vec![Vec::with_capacity(rows.len()); maps.len()];
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else {
        return Ok(Some(scores));
    };
    let at_once = frames_at_once(dataset.camera());
    let mut frames = dataset.frames(first.index..last.index + 1).zip(rows);
    let mut done = 0;
    while done < rows.len() {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let batch: Vec<_> = frames.by_ref().take(at_once).collect();
        if batch.is_empty() {
            break;
        }
        let scored: Vec<_> = batch
            .par_iter()
            .map_init(Rasterizer::default, |rasterizer, (frame, row)| {
                let pose = row.timestamp_secs.and_then(|secs| trajectory.at(secs));
                let (Ok(frame), Some(pose)) = (frame, pose) else {
                    return Ok(vec![None; maps.len()]);
                };
                let frame = &trajectory.synchronized(frame);
                let score = |gaussians: &&Gaussians| {
                    score_frame(frame, pose, gaussians, rasterizer).map(Some)
                };
                maps.iter().map(score).collect()
            })
            .collect::<Result<Vec<RowScores>, EvalError>>()?;
        done += scored.len();
        for of_frame in scored {
            for (scores, of_frame) in scores.iter_mut().zip(of_frame) {
                scores.push(of_frame);
            }
        }
        observer.on(&RunEvent::Scored {
            done,
            total: rows.len(),
        });
    }
    Ok(Some(scores))
}

/// As many as cores can use and memory affords.
fn frames_at_once(camera: &Camera) -> usize {
    (PIXELS_AT_ONCE / (camera.width * camera.height)).clamp(1, FRAMES_AT_ONCE)
}

/// Takes over the scores that there are.
fn set_scores(rows: &mut [FrameRow], scores: Option<RowScores>) {
    for (row, scores) in rows.iter_mut().zip(scores.into_iter().flatten()) {
        if let Some(scores) = scores {
            row.scores = scores;
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_frames_are_scored_one_by_one() {
        let at_once = |width: usize, height: usize| {
            frames_at_once(&fgs_synth::kinect_camera(width, height).unwrap())
        };
        assert_eq!(at_once(640, 480), 16);
        assert_eq!(at_once(1920, 1080), 2);
        assert_eq!(at_once(4000, 3000), 1);
        assert_eq!(at_once(10_000, 10_000), 1);
    }
}
