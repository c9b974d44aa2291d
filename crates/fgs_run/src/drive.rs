//! Drives `fgs_slam` over the frames of a plan. The only file that deals with its events and its
//! output; everything else sees rows and metrics.

use std::sync::atomic::{AtomicBool, Ordering};

use fgs_data::Trajectory;
use fgs_slam::{FrameStatus, Observer, SlamEvent, SlamOutput, Tracked, TrackingStatus};
use fgs_splat::GaussianModel;

use crate::backend::Model;
use crate::error::RunError;
use crate::frame_log::FrameRow;
use crate::metrics::Metrics;
use crate::observer::{RunEvent, RunObserver};
use crate::peak_memory::peak_rss_bytes;
use crate::plan::Plan;
use crate::run_result::RunResult;
use crate::scores::{Scores, mean};
use crate::settings::COMMIT;

/// Tracks and maps every frame of the plan; nothing is scored or saved.
///
/// # Errors
/// If it cannot be started, or no frame can be read.
pub fn drive(
    plan: &Plan,
    model: Model,
    observer: &mut dyn RunObserver,
    stop: &AtomicBool,
) -> Result<RunResult, RunError> {
    let backend = model.name().to_owned();
    let mut rows = Rows {
        observer,
        next_index: plan.frames.start,
        rows: Vec::with_capacity(plan.frames.len()),
    };
    let output = match model {
        Model::Cpu { model, .. } => track_and_map(plan, *model, &mut rows, stop),
        Model::Gpu { model, .. } => track_and_map(plan, *model, &mut rows, stop),
    }?;
    let mut rows = rows.rows;
    if output.frames_damaged > 0 && output.frames_damaged == rows.len() {
        return Err(RunError::NothingRead { frames: rows.len() });
    }
    // The closing keyframe is chosen when no more frames come, after its event.
    for keyframe in &output.keyframes {
        let place = keyframe.index.0.checked_sub(plan.frames.start);
        if let Some(row) = place.and_then(|place| rows.get_mut(place)) {
            row.keyframe = Some(keyframe.kind);
        }
    }
    let trajectory = Trajectory::new(
        output
            .frames
            .iter()
            .filter_map(|frame| Some((frame.timestamp_secs, frame.world_from_camera?))),
    )?;
    Ok(RunResult {
        metrics: metrics(plan, &rows, &output, backend, stop),
        rows,
        trajectory,
        gaussians: output.gaussians,
    })
}

fn track_and_map(
    plan: &Plan,
    model: impl GaussianModel + Send,
    rows: &mut Rows<'_>,
    stop: &AtomicBool,
) -> Result<SlamOutput, RunError> {
    Ok(fgs_slam::run(
        plan.dataset.frames(plan.frames.clone()),
        plan.dataset.camera(),
        &plan.settings.slam(),
        plan.execution,
        model,
        rows,
        stop,
    )?)
}

/// Makes a row of each event, and passes the event on. Each frame gives exactly one, in order.
struct Rows<'a> {
    observer: &'a mut dyn RunObserver,
    next_index: usize,
    rows: Vec<FrameRow>,
}

impl Observer for Rows<'_> {
    fn on(&mut self, event: &SlamEvent<'_>) {
        let index = self.next_index;
        self.next_index += 1;
        let row = match event {
            SlamEvent::Frame {
                tracked,
                keyframe,
                num_gaussians,
                steps,
            } => {
                let mut row = row_of(tracked);
                row.keyframe = *keyframe;
                self.observer.on(&RunEvent::Frame {
                    row: &row,
                    num_gaussians: *num_gaussians,
                    steps: *steps,
                });
                row
            }
            SlamEvent::Damaged { error } => {
                let error = *error;
                self.observer.on(&RunEvent::Damaged { index, error });
                FrameRow::new(index, FrameStatus::Damaged)
            }
            SlamEvent::Dropped => {
                self.observer.on(&RunEvent::Dropped { index });
                FrameRow::new(index, FrameStatus::Dropped)
            }
        };
        self.rows.push(row);
    }
}

fn row_of(tracked: &Tracked) -> FrameRow {
    let status = match tracked.status {
        TrackingStatus::Tracked => FrameStatus::Tracked,
        TrackingStatus::Lost => FrameStatus::Lost,
    };
    FrameRow {
        timestamp_secs: Some(tracked.timestamp_secs),
        points: Some(tracked.points),
        sparse_points: Some(tracked.sparse_points),
        inliers: Some(tracked.inliers),
        residual_m: Some(tracked.residual_m),
        conditioning: Some(tracked.conditioning),
        tracking_ms: Some(1e3 * tracked.duration.as_secs_f64()),
        ..FrameRow::new(tracked.index.0, status)
    }
}

fn metrics(
    plan: &Plan,
    rows: &[FrameRow],
    output: &SlamOutput,
    backend: String,
    stop: &AtomicBool,
) -> Metrics {
    let count = |status| rows.iter().filter(|row| row.status == status).count();
    let read = output.frames.len();
    let per_frame = |total: f64| (read > 0).then(|| total / read as f64);
    let seconds = output.timings.total.as_secs_f64();
    Metrics {
        frames: rows.len(),
        frames_dropped: count(FrameStatus::Dropped),
        frames_lost: count(FrameStatus::Lost),
        frames_damaged: count(FrameStatus::Damaged),
        interrupted: stop.load(Ordering::Relaxed),
        failure: output.failure.as_ref().map(ToString::to_string),
        scores: Scores::default(),
        lpips: None,
        fps: (seconds > 0.0).then(|| rows.len() as f64 / seconds),
        tracking_ms: mean(rows.iter().filter_map(|row| row.tracking_ms)),
        mapping_ms: per_frame(1e3 * output.timings.mapping.as_secs_f64()),
        iterations: output.timings.steps,
        iterations_per_frame: per_frame(output.timings.steps as f64),
        keyframes: output.keyframes.len(),
        num_gaussians: output.gaussians.len(),
        map_bytes: 0,
        peak_rss_bytes: peak_rss_bytes(),
        device_bytes: output.device_bytes,
        seed: plan.settings.seed,
        commit: COMMIT.into(),
        mode: plan.execution,
        backend,
        threads: rayon::current_num_threads(),
        dataset: plan.dataset_path.clone(),
    }
}
