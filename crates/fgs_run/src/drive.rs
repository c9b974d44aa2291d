//! Drives a session of `fgs_slam` over the frames of a plan. The only file that deals with its events
//! and its output; everything else sees rows and metrics.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use fgs_data::{DataError, Dataset, Trajectory};
use fgs_geom::FrameIndex;
use fgs_slam::{
    Execution, FrameResult, FrameStatus, SavedSession, Slam, SlamConfig, SlamError, SlamEvent,
    SlamOutput, Subscription, drive_with, live_with, replay_with,
};
use fgs_splat::GaussianModel;

use crate::backend::Model;
use crate::checkpoints::Checkpoints;
use crate::error::RunError;
use crate::frame_log::FrameRow;
use crate::input::Input;
use crate::map_folder::{MapFolder, MapWriter};
use crate::metrics::{Metrics, RefinedMetrics};
use crate::observer::{RunEvent, RunObserver};
use crate::peak_memory::peak_rss_bytes;
use crate::plan::{KnownMap, Plan};
use crate::run_result::{FurtherSubmap, RunResult};
use crate::score_values::{Scores, mean};
use crate::settings::COMMIT;

/// So many events wait for who looks on at a live camera: those of some minutes. The log of the run is whole
/// in any case.
const LIVE_EVENTS: usize = 10_000;

/// Tracks and maps every frame of the plan and refines the map; nothing is scored or saved but
/// checkpoints of the map. If one of them fails, [`RunResult::checkpoint_failure`] says why.
///
/// # Errors
/// If it cannot be started, or no frame can be read.
pub fn drive(
    plan: &Plan,
    model: Model,
    observer: &mut dyn RunObserver,
    stop: &AtomicBool,
) -> Result<RunResult, RunError> {
    let mut slam = session(plan, model.map)?;
    let checkpoints = checkpoints(plan, &mut slam)?;
    // Room for every frame: whoever looks on may be slow.
    let events = slam.subscribe(plan.num_frames_left().unwrap_or(LIVE_EVENTS) + 1);
    observer.begin(&slam);
    let (output, saved) = thread::scope(|scope| {
        let tracking = scope.spawn(|| {
            let saved = feed(plan, &mut slam, checkpoints, stop);
            (slam.finish_refined(plan.refine, stop), saved)
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
    let trajectory = |submap: usize| {
        let frames = output.frames.iter();
        let frames = frames.filter(|frame| frame.submap == Some(submap));
        Trajectory::new(
            frames.filter_map(|frame| Some((frame.timestamp_secs?, frame.world_from_camera?))),
        )
    };
    let metrics = metrics(plan, &rows, &output, model.name, stop);
    let further = output.further.into_iter().zip(1..).map(|(map, number)| {
        Ok(FurtherSubmap {
            trajectory: trajectory(number)?,
            gaussians: map.gaussians,
            refined: map.refined,
        })
    });
    let further = further.collect::<Result<_, DataError>>()?;
    Ok(RunResult {
        metrics,
        rows,
        trajectory: trajectory(0)?,
        further,
        gaussians: output.gaussians,
        refined: output.refined.map(|refined| refined.gaussians),
        checkpoint_failure: saved.err(),
    })
}

/// The session that the plan starts with: a new one, or one that goes on.
fn session(plan: &Plan, model: Box<dyn GaussianModel>) -> Result<Slam, RunError> {
    let (camera, config) = (plan.input.camera(), plan.settings.slam());
    let mut slam = match &plan.known_map {
        None => Slam::new(camera, &config, plan.execution, model)?,
        Some((known, folder)) => {
            let saved = folder.session()?;
            if saved.camera() != camera {
                return Err(other_recording(folder, "its camera is another"));
            }
            match known {
                KnownMap::Resume(_) => {
                    if let Some(dataset) = plan.dataset() {
                        check_recording(plan, dataset, folder, &saved)?;
                    }
                    return restored(plan, &config, folder, model, saved);
                }
                KnownMap::Extend(_) => restored(plan, &config, folder, model, saved.into_map())?,
                KnownMap::LocalizeOnly(_) => {
                    let saved = saved.into_map().localizing_only();
                    restored(plan, &config, folder, model, saved)?
                }
            }
        }
    };
    slam.start_at(FrameIndex(plan.frames.start));
    if let Some(holdout) = plan.eval_holdout {
        slam.hold_out(holdout);
    }
    Ok(slam)
}

fn restored(
    plan: &Plan,
    config: &SlamConfig,
    folder: &MapFolder,
    model: Box<dyn GaussianModel>,
    saved: SavedSession,
) -> Result<Slam, RunError> {
    let camera = plan.input.camera();
    let image_of = |id| folder.keyframe(id, camera);
    Slam::restore(config, plan.execution, model, saved, image_of)
}

/// Whether a recording can be the one that a session has seen the beginning of.
fn check_recording(
    plan: &Plan,
    dataset: &Dataset,
    folder: &MapFolder,
    saved: &SavedSession,
) -> Result<(), RunError> {
    let next = saved.next_frame().0;
    if next < plan.frames.start || next > plan.frames.end {
        let what = format!("frame {next} would come next, and it has {}", dataset.len());
        return Err(other_recording(folder, &what));
    }
    let last = saved.last_frame();
    if let Some((last, secs)) = last.and_then(|last| Some((last.index.0, last.timestamp_secs?)))
        && dataset.timestamps().nth(last) != Some(secs)
    {
        let what = format!("frame {last} was taken at another time than {secs} s");
        return Err(other_recording(folder, &what));
    }
    Ok(())
}

fn other_recording(folder: &MapFolder, what: &str) -> RunError {
    RunError::NotOfMap {
        path: folder.path().into(),
        what: what.into(),
    }
}

/// The checkpoints of the map, if the plan has any.
fn checkpoints(plan: &Plan, slam: &mut Slam) -> Result<Option<Checkpoints>, RunError> {
    let Some(every) = plan.checkpoint_every_secs.map(Duration::from_secs) else {
        return Ok(None);
    };
    let path = MapFolder::of_run(plan.folder.path());
    let writer = match &plan.known_map {
        None => MapWriter::begin(&path, &plan.settings)?,
        Some((KnownMap::Resume(_), folder)) => MapWriter::resume(folder),
        Some((_, folder)) => MapWriter::begin_with(&path, &plan.settings, folder)?,
    };
    Ok(Some(Checkpoints::begin(every, writer, slam)))
}

/// Feeds the session, with checkpoints between frames and at their end if there are any.
fn feed(
    plan: &Plan,
    slam: &mut Slam,
    mut checkpoints: Option<Checkpoints>,
    stop: &AtomicBool,
) -> Result<(), RunError> {
    let after_frame = |slam: &mut Slam| {
        if let Some(checkpoints) = &mut checkpoints {
            checkpoints.after_frame(slam);
        }
    };
    match &plan.input {
        Input::Camera(camera) => {
            let frames = camera.frames(plan.frames.len(), plan.dataset_path.clone());
            live_with(slam, frames, stop, after_frame).map_err(SlamError::Threads)?;
        }
        Input::Recording(dataset) => {
            let frames = dataset.frames(plan.frames_left());
            match plan.execution {
                Execution::Realtime => replay_with(slam, frames, stop, after_frame),
                Execution::Lockstep | Execution::Parallel => {
                    drive_with(slam, frames, stop, after_frame);
                }
            }
        }
    }
    checkpoints.map_or(Ok(()), |checkpoints| checkpoints.finish(slam))
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
        submap: frame.submap,
        keyframe: frame.keyframe.map(|(_, kind)| kind),
        points: tracking.map(|tracking| tracking.points),
        sparse_points: tracking.map(|tracking| tracking.sparse_points),
        inliers: tracking.map(|tracking| tracking.inliers),
        residual_m: tracking.map(|tracking| tracking.residual_m),
        uncertainty_m: tracking.map(|tracking| tracking.uncertainty_m),
        likeness: agreement.map(|agreement| agreement.likeness),
        seen_through: agreement.map(|agreement| agreement.seen_through),
        moving_share: tracking.map(|tracking| tracking.moving_share),
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
        frames_elsewhere: rows.iter().filter(|row| row.submap > Some(0)).count(),
        further_submaps: output.further.len(),
        interrupted: stop.load(Ordering::Relaxed),
        failure: output.failure.as_ref().map(ToString::to_string),
        reference_is_device: false,
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
