//! Whether a frame's verdict is honest: scenarios in which tracking is likely to fail, with exact
//! truth.

use std::time::Duration;

use anyhow::Context;
use clap::builder::PossibleValuesParser;
use fgs_geom::Camera;
use fgs_slam::{Execution, FrameResult, FrameStatus, Slam, SlamConfig, model_settings};
use fgs_splat::CpuModel;
use fgs_synth::{PoseError, Scenario, kinect_camera};
use serde::Serialize;

use crate::console::Console;
use crate::failure::{EXIT_DONE, UsageError};
use crate::image_size::ImageSize;

const DEFAULT_SIZE: ImageSize = ImageSize {
    width: 320,
    height: 240,
};

/// Optimisation steps a frame: poses hardly depend on them.
const STEPS_PER_FRAME: f64 = 0.5;

/// What became of a scenario: one line of the table.
#[derive(Serialize)]
struct Row<'a> {
    scenario: &'a str,
    frames: usize,
    tracked: usize,
    weak: usize,
    lost: usize,
    /// Of the tracked and the weak ones, those whose pose is wrong.
    wrong_tracked: usize,
    wrong_weak: usize,
    /// The largest error of a tracked frame.
    worst_tracked_m: f64,
    /// Sub-maps that began.
    submaps: usize,
    /// Keyframes whose pose is wrong.
    wrong_keyframes: usize,
    /// Frames from the end of the disturbance to the first that is tracked in the first sub-map and right, if
    /// there is one.
    recovered_after: Option<usize>,
    track_mean_ms: f64,
    track_max_ms: f64,
}

/// One frame.
#[derive(Serialize)]
struct Line<'a> {
    scenario: &'a str,
    frame: usize,
    disturbed: bool,
    status: FrameStatus,
    wrong: bool,
    error_m: Option<f64>,
    error_deg: Option<f64>,
    submap: Option<usize>,
    keyframe: bool,
    points: usize,
    inliers: usize,
    residual_m: f64,
    uncertainty_m: f64,
    likeness: Option<f64>,
    seen_through: Option<f64>,
    compared: Option<usize>,
}

/// The names that `--robustness` takes.
pub fn names() -> PossibleValuesParser {
    PossibleValuesParser::new(Scenario::names())
}

/// Goes through the scenarios of these names, or all.
///
/// # Errors
/// If the size is impossible or a session fails.
pub fn run(names: &[String], size: Option<ImageSize>, console: Console) -> anyhow::Result<u8> {
    let ImageSize { width, height } = size.unwrap_or(DEFAULT_SIZE);
    let camera =
        kinect_camera(width, height).map_err(|error| UsageError(format!("--size: {error}")))?;
    console.say(format!(
        "{:<14} {:>6} {:>7} {:>5} {:>5}  {:>13} {:>10} {:>9} {:>9}  {:>9}  {:>13}\n\
         {:<14} {:>6} {:>7} {:>5} {:>5}  {:>13} {:>10} {:>9} {:>9}  {:>9}  {:>13}",
        "scenario",
        "frames",
        "tracked",
        "weak",
        "lost",
        "wrong,",
        "wrong,",
        "wrong",
        "worst",
        "recovered",
        "tracking, ms",
        "",
        "",
        "",
        "",
        "",
        "called tracked",
        "weak",
        "keyframes",
        "tracked m",
        "after",
        "mean      max",
    ));
    let is_asked_for = |name: &str| names.is_empty() || names.iter().any(|asked| asked == name);
    for name in Scenario::names().filter(|name| is_asked_for(name)) {
        let scenario = Scenario::named(name, camera).context("no such scenario")?;
        let results = follow(&scenario, &camera)?;
        report(name, &scenario, &results, console);
    }
    Ok(EXIT_DONE)
}

/// What a session says of a scenario's frames when it sees them.
fn follow(scenario: &Scenario, camera: &Camera) -> anyhow::Result<Vec<FrameResult>> {
    let mut config = SlamConfig::default();
    config.mapping.iterations_per_frame = STEPS_PER_FRAME;
    let model = CpuModel::new(model_settings(&config.mapping));
    let mut slam = Slam::new(camera, &config, Execution::Lockstep, Box::new(model))?;
    let results = scenario.frames().map(|frame| slam.push(frame));
    Ok(results.collect::<Result<_, _>>()?)
}

fn report(name: &str, scenario: &Scenario, results: &[FrameResult], console: Console) {
    let poses: Vec<_> = (results.iter())
        .map(|result| Some((result.submap?, result.world_from_camera?)))
        .collect();
    let errors = scenario.errors(&poses);
    let is_wrong = |error: &Option<PoseError>| error.is_some_and(|error| error.is_wrong());
    let judged = || results.iter().zip(&errors);
    let of = |status| judged().filter(move |(result, _)| result.status == status);
    let wrong = |status| of(status).filter(|(_, error)| is_wrong(error)).count();
    let after = || judged().skip(scenario.disturbed().end);
    let ms = |time: Duration| 1e3 * time.as_secs_f64();
    let times =
        || (results.iter()).filter_map(|result| Some(ms(result.tracking.as_ref()?.duration)));
    let row = Row {
        scenario: name,
        frames: results.len(),
        tracked: of(FrameStatus::Tracked).count(),
        weak: of(FrameStatus::Weak).count(),
        lost: of(FrameStatus::Lost).count(),
        wrong_tracked: wrong(FrameStatus::Tracked),
        wrong_weak: wrong(FrameStatus::Weak),
        worst_tracked_m: of(FrameStatus::Tracked)
            .filter_map(|(_, error)| Some(error.as_ref()?.position_m))
            .fold(0.0, f64::max),
        submaps: (results.iter().filter_map(|result| result.submap).max())
            .map_or(0, |last| last + 1),
        wrong_keyframes: judged()
            .filter(|(result, error)| result.keyframe.is_some() && is_wrong(error))
            .count(),
        recovered_after: after().position(|(result, error)| {
            result.status == FrameStatus::Tracked && result.submap == Some(0) && !is_wrong(error)
        }),
        track_mean_ms: times().sum::<f64>() / results.len().max(1) as f64,
        track_max_ms: times().fold(0.0, f64::max),
    };
    console.say(format!(
        "{:<14} {:>6} {:>7} {:>5} {:>5}  {:>14} {:>10} {:>9} {:>9.3}  {:>9}  {:>6.1} {:>6.1}",
        row.scenario,
        row.frames,
        row.tracked,
        row.weak,
        row.lost,
        row.wrong_tracked,
        row.wrong_weak,
        row.wrong_keyframes,
        row.worst_tracked_m,
        (row.recovered_after).map_or_else(|| "never".to_owned(), |frames| frames.to_string()),
        row.track_mean_ms,
        row.track_max_ms,
    ));
    console.event("scenario", &row);
    for (frame, (result, error)) in judged().enumerate() {
        let Some(quality) = result.tracking else {
            continue;
        };
        let line = Line {
            scenario: name,
            frame,
            disturbed: scenario.disturbed().contains(&frame),
            status: result.status,
            wrong: is_wrong(error),
            error_m: error.map(|error| error.position_m),
            error_deg: error.map(|error| error.rotation_rad.to_degrees()),
            submap: result.submap,
            keyframe: result.keyframe.is_some(),
            points: quality.points,
            inliers: quality.inliers,
            residual_m: quality.residual_m,
            uncertainty_m: quality.uncertainty_m,
            likeness: quality.agreement.map(|seen| seen.likeness),
            seen_through: quality.agreement.map(|seen| seen.seen_through),
            compared: quality.agreement.map(|seen| seen.points),
        };
        console.event("frame", &line);
    }
}
