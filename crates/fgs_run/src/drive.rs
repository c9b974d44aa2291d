//! Drives a session of `fgs_slam` over the frames of a plan. The only file that deals with its events
//! and its output; everything else sees rows and metrics.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use fgs_data::Trajectory;
use fgs_geom::FrameIndex;
use fgs_slam::{
    Execution, FrameResult, FrameStatus, Slam, SlamEvent, SlamOutput, Subscription, replay,
};

use crate::backend::Model;
use crate::error::RunError;
use crate::frame_log::FrameRow;
use crate::metrics::{Metrics, RefinedMetrics};
use crate::observer::{RunEvent, RunObserver};
use crate::peak_memory::peak_rss_bytes;
use crate::plan::Plan;
use crate::run_result::RunResult;
use crate::score_values::{Scores, mean};
use crate::settings::COMMIT;

/// Tracks and maps every frame of the plan and refines the map; nothing is scored or saved.
///
/// # Errors
/// If it cannot be started, or no frame can be read.
pub fn drive(
    plan: &Plan,
    model: Model,
    observer: &mut dyn RunObserver,
    stop: &AtomicBool,
) -> Result<RunResult, RunError> {
    let (camera, config) = (plan.dataset.camera(), plan.settings.slam());
    let mut slam = Slam::new(camera, &config, plan.execution, model.map)?;
    slam.start_at(FrameIndex(plan.frames.start));
    if let Some(holdout) = plan.eval_holdout {
        slam.hold_out(holdout);
    }
    // Room for every frame: whoever looks on may be slow, but the log of a run is whole.
    let events = slam.subscribe(plan.frames.len() + 1);
    let output = thread::scope(|scope| {
        let tracking = scope.spawn(|| {
            let frames = plan.dataset.frames(plan.frames.clone());
            match plan.execution {
                Execution::Realtime => replay(&mut slam, frames, stop),
                Execution::Lockstep | Execution::Parallel => {
                    fgs_slam::drive(&mut slam, frames, stop);
                }
            }
            slam.finish_refined(plan.refine, stop)
        });
        pass_on(&events, observer);
        tracking.join()
    })
    .map_err(|_| RunError::TrackerPanicked)?;
    let rows: Vec<FrameRow> = output.frames.iter().map(row_of).collect();
    let damaged = |row: &FrameRow| row.status == FrameStatus::Damaged;
    if !rows.is_empty() && rows.iter().all(damaged) {
        return Err(RunError::NothingRead { frames: rows.len() });
    }
    let poses = output.frames.iter();
    let trajectory = Trajectory::new(
        poses.filter_map(|frame| Some((frame.timestamp_secs?, frame.world_from_camera?))),
    )?;
    Ok(RunResult {
        metrics: metrics(plan, &rows, &output, model.name, stop),
        rows,
        trajectory,
        gaussians: output.gaussians,
        refined: output.refined.map(|refined| refined.gaussians),
    })
}

/// Tells the observer what happens until the session ends.
fn pass_on(events: &Subscription, observer: &mut dyn RunObserver) {
    for event in events.events() {
        match event {
            SlamEvent::Frame {
                result,
                error,
                num_gaussians,
                steps,
            } => observer.on(&RunEvent::Frame {
                row: &row_of(&result),
                error: error.as_deref(),
                num_gaussians,
                steps,
            }),
            SlamEvent::Refined { done, steps: total } => {
                observer.on(&RunEvent::Refined { done, total });
            }
            _ => {}
        }
    }
}

fn row_of(frame: &FrameResult) -> FrameRow {
    let tracking = frame.tracking.as_ref();
    let agreement = tracking.and_then(|tracking| tracking.agreement.as_ref());
    FrameRow {
        timestamp_secs: frame.timestamp_secs,
        keyframe: frame.keyframe.map(|(_, kind)| kind),
        points: tracking.map(|tracking| tracking.points),
        sparse_points: tracking.map(|tracking| tracking.sparse_points),
        inliers: tracking.map(|tracking| tracking.inliers),
        residual_m: tracking.map(|tracking| tracking.residual_m),
        conditioning: tracking.map(|tracking| tracking.conditioning),
        likeness: agreement.map(|agreement| agreement.likeness),
        seen_through: agreement.map(|agreement| agreement.seen_through),
        tracking_ms: tracking.map(|tracking| 1e3 * tracking.duration.as_secs_f64()),
        ..FrameRow::new(frame.index.0, frame.status)
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
    let tried = output
        .frames
        .iter()
        .filter(|frame| frame.tracking.is_some());
    let read = tried.count();
    let per_frame = |total: f64| (read > 0).then(|| total / read as f64);
    let seconds = output.timings.total.as_secs_f64();
    Metrics {
        frames: rows.len(),
        frames_dropped: count(FrameStatus::Dropped),
        frames_lost: count(FrameStatus::Lost),
        frames_weak: count(FrameStatus::Weak),
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
        loops: output.loops,
        num_gaussians: output.gaussians.len(),
        map_bytes: 0,
        peak_rss_bytes: peak_rss_bytes(),
        device_bytes: output.device_bytes,
        seed: plan.settings.seed,
        commit: COMMIT.into(),
        mode: plan.execution,
        backend,
        threads: rayon::current_num_threads(),
        dataset: plan.dataset_from_folder.clone(),
        eval_holdout: plan.eval_holdout,
        refined: output.refined.as_ref().map(|refined| RefinedMetrics {
            steps: refined.steps,
            seconds: refined.duration.as_secs_f64(),
            scores: Scores::default(),
            num_gaussians: refined.gaussians.len(),
            map_bytes: 0,
        }),
    }
}
