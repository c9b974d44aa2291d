//! `fgs doctor`: examines a recording before it is run, and says what is wrong with it and what to
//! change.
//!
//! [`survey`] reads frames and registers neighbours. Each check has a file of its own and turns what
//! the survey has collected into one line of the [`report`].

mod color_misfit;
mod depth_along_z;
mod depth_scale;
mod depth_to_color;
mod exposure;
mod files;
mod frame_pairs;
mod intrinsics;
mod motion_fit;
mod neighbors;
mod pose_convention;
mod pose_times;
mod poses;
mod repeated_images;
mod report;
mod self_calibration;
#[cfg(test)]
mod sensor_motions_tests;
mod sensor_offset;
mod sensor_times;
mod statistics;
mod survey;
#[cfg(test)]
mod test_room;
#[cfg(test)]
mod tests;
mod time_check;
mod timing;
mod valid_depth;

use std::path::PathBuf;

use clap::Args;
use fgs_data::{Dataset, Format, PoseOrigin};
use fgs_geom::{Camera, Se3};
use fgs_run::{Settings, open_recording};
use nalgebra::Vector3;

use crate::console::Console;
use crate::failure::{EXIT_DONE, EXIT_FAILED};

use frame_pairs::FramePair;
use motion_fit::Motion;
use pose_times::TimedMotion;
use report::{Check, Found, Report, Verdict};
use survey::Survey;

/// Examine a recording before running it
///
/// Lists what the recording holds and checks for common problems: gaps, repeated images, missing depth, jumps in
/// exposure, a wrong depth scale or wrong intrinsics, depth that is not registered to colour or taken at
/// another time, poses in another convention. Says what to change.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs doctor recordings/desk
  fgs doctor recordings/desk --camera kinect.toml --json

The camera comes from --camera, else from the recording, else from [camera] in --config. --camera also
takes a settings file that has a [camera] table.

ok: nothing found. unknown: the recording does not show it either way. warn: results may suffer.
PROBLEM: results will be wrong; the line below says what to change.

Exit code: 0 no problem, 1 a problem or the recording cannot be opened, 2 usage error.")]
pub struct DoctorArgs {
    /// The recording: a folder or a file
    dataset: PathBuf,
    /// Settings file (TOML); only its camera table is used
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Camera file; overrides the recording's own camera
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Write the report to stdout as JSON
    #[arg(long)]
    json: bool,
}

/// Executes `fgs doctor`.
///
/// # Errors
/// If the recording or its camera is refused.
pub fn run(args: &DoctorArgs) -> anyhow::Result<u8> {
    let console = Console::new(args.json);
    let mut settings = Settings::load(args.config.as_deref(), &[])?;
    let dataset = open_recording(&args.dataset, args.camera.as_deref(), &mut settings)?;
    let bar = console.progress(survey::frames_to_read(&dataset), "looking");
    let report = examine(&dataset, || bar.inc(1));
    bar.finish_and_clear();
    console.event("doctor", &report);
    console.say(&report);
    Ok(if report.has_problem() {
        EXIT_FAILED
    } else {
        EXIT_DONE
    })
}

/// Reads the recording and runs every check.
fn examine(dataset: &Dataset, progress: impl FnMut()) -> Report {
    let times: Vec<f64> = dataset.timestamps().collect();
    let survey = Survey::read(dataset, progress);
    let frames_read = survey.frames_read();
    let pairs = &survey.pairs.pairs;
    let edges = survey.edges.check();
    let along_z = survey.flatness.check();
    let is_along_z = along_z.verdict != Verdict::Problem;
    let is_mirrored = survey.edges.mirror().is_some();
    let is_registered = edges.verdict != Verdict::Problem && is_along_z;
    let (intrinsics, calibration) = intrinsics::check(pairs, dataset.camera(), is_registered);
    let is_camera_known =
        is_along_z && (intrinsics.verdict == Verdict::Ok || calibration.is_some());
    // With wrong intrinsics the registered motions are wrong too: the poses are then compared with
    // those of the intrinsics that fit.
    let first_from_second: Vec<Se3> = match &calibration {
        Some(calibration) => calibration.first_from_second.clone(),
        None => pairs.iter().map(|pair| pair.first_from_second).collect(),
    };
    let mut checks = vec![
        files::check(&survey.unreadable, frames_read),
        timing::check(&times, dataset.format() != Format::Tum),
        survey.repeats.check(),
        valid_depth::check(&survey.depth_shares),
        along_z,
        survey.exposure.check(),
        edges,
        neighbors::check(&survey.pairs.lost, survey.depth_shares.len()),
        intrinsics,
    ];
    checks.extend(sensor_times::checks(survey.sensors, dataset.camera_file()));
    let mut motion_fit = None;
    if is_mirrored && dataset.ground_truth().is_some() {
        let seen = "cannot be compared while depth is mirrored".into();
        checks.push(Check::unknown("poses", seen));
    } else if let Some(truth) = dataset.ground_truth() {
        let timed: Vec<TimedMotion> = pairs
            .iter()
            .zip(first_from_second)
            .map(|(pair, first_from_second)| TimedMotion {
                motion: Motion {
                    first_from_second,
                    points: probe_points(pair, dataset.camera()),
                },
                times_secs: [pair.first.timestamp_secs, pair.second.timestamp_secs],
            })
            .collect();
        let (motions, poses): (Vec<Motion>, Vec<[Se3; 2]>) = timed
            .iter()
            .filter_map(|timed| {
                let [first, second] = timed.times_secs;
                Some((timed.motion.clone(), [truth.at(first)?, truth.at(second)?]))
            })
            .unzip();
        let (check, fit) = poses::check(&motions, &poses);
        let (times, fit_in_time) = pose_times::check(timed, truth);
        motion_fit = fit_in_time.or(fit);
        if check.verdict == Verdict::Ok || times.verdict == Verdict::Problem {
            checks.push(times);
        }
        checks.push(check);
    }
    if let Some(error) = dataset.ground_truth_error() {
        checks.push(Check::warn(
            "poses",
            error.to_string(),
            "correct the file or remove it; a run goes on without these poses".into(),
        ));
    }
    let depth_scale = dataset.camera_file().depth_scale();
    let median_depth = statistics::median(survey.median_depths_m);
    checks.push(depth_scale::check(
        depth_scale,
        median_depth,
        motion_fit.as_ref(),
        is_camera_known,
    ));
    Report {
        found: found(dataset, &times, frames_read),
        checks,
    }
}

/// The image's corners and centre, unprojected to the pair's median depth.
fn probe_points(pair: &FramePair, camera: &Camera) -> Vec<Vector3<f64>> {
    let (right, bottom) = (camera.width as f64 - 1.0, camera.height as f64 - 1.0);
    [
        [0.0, 0.0],
        [right, 0.0],
        [0.0, bottom],
        [right, bottom],
        [0.5 * right, 0.5 * bottom],
    ]
    .map(|[u, v]| camera.unproject(u, v, pair.median_depth_m))
    .into()
}

fn found(dataset: &Dataset, times: &[f64], frames_read: usize) -> Found {
    let camera = dataset.camera();
    let k = camera.intrinsics;
    let duration = times
        .last()
        .zip(times.first())
        .map(|(last, first)| last - first);
    Found {
        format: dataset.format().to_string(),
        frames: dataset.len(),
        frames_read,
        known_poses: dataset
            .ground_truth()
            .map_or(0, |truth| truth.poses().len()),
        poses_are_of_device: dataset.pose_origin() == PoseOrigin::Device,
        duration_secs: duration.unwrap_or(0.0),
        width: camera.width,
        height: camera.height,
        fx: k.fx,
        fy: k.fy,
        cx: k.cx,
        cy: k.cy,
        depth_scale: dataset.camera_file().depth_scale(),
    }
}
