//! `reference.txt`: where the camera really was, in the run's coordinates. With it, a run's folder says
//! how far each pose is off, without the recording.

use fgs_data::{Dataset, Trajectory};
use fgs_eval::align_positions;
use fgs_files::StagedFolder;

use crate::error::RunError;
use crate::run_folder::{REFERENCE, write};
use crate::run_result::RunResult;

/// Saves the recording's ground truth at the run's frames, moved by the rigid motion that brings it
/// closest to the run's poses: distances to these are those of the absolute trajectory error. Without
/// ground truth, or poses to compare it with, there is no file.
///
/// # Errors
/// If a pose is too large to be saved, or the file cannot be written.
pub fn save(
    result: &RunResult,
    dataset: &Dataset,
    results: &StagedFolder<'_>,
) -> Result<(), RunError> {
    let Some(reference) = in_run(result, dataset)? else {
        return Ok(());
    };
    write(results, REFERENCE, |file| reference.encode(file)).map(drop)
}

fn in_run(result: &RunResult, dataset: &Dataset) -> Result<Option<Trajectory>, RunError> {
    let Some(truth) = dataset.ground_truth() else {
        return Ok(None);
    };
    let poses = result.trajectory.poses().iter();
    let (estimated, reference): (Vec<_>, Vec<_>) = poses
        .filter_map(|pose| {
            let truth = truth.at(pose.timestamp_secs)?;
            Some((pose.world_from_camera.translation, truth.translation))
        })
        .unzip();
    if estimated.is_empty() {
        return Ok(None);
    }
    let run_from_truth = align_positions(&reference, &estimated);
    let mut last = f64::NEG_INFINITY;
    let poses = result.rows.iter().filter_map(|row| {
        // Frames that were dropped or damaged may have any time.
        let secs = row.timestamp_secs.filter(|secs| *secs > last)?;
        let pose = run_from_truth * truth.at(secs)?;
        last = secs;
        Some((secs, pose))
    });
    Ok(Some(Trajectory::new(poses)?))
}
