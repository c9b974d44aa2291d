//! Ground-truth poses as the layouts store them: row-major 4x4 matrices `world_from_camera`, or a
//! trajectory file with timestamps on the frames' clock.

use std::path::Path;

use fgs_files::is_present;
use fgs_geom::Se3;
use nalgebra::Matrix4;

use super::{FrameFiles, no_overlap};
use crate::lines::{Line, Lines};
use crate::trajectory::check_position;
use crate::{DataError, LineFault, PoseOrigin, Trajectory};

/// Poses are interpolated over at most this long: a hand accelerating at 2 m/s^2 strays
/// 2 * 0.1^2 / 8 m = 2.5 mm from the straight line meanwhile.
const MAX_POSE_GAP_SECS: f64 = 0.1;

/// `traj.txt`, if the folder has it: sixteen numbers a line, a line for each frame.
pub(super) fn read_matrix_per_line(
    folder: &Path,
    frames: &[FrameFiles],
    frames_path: &Path,
) -> Result<Option<Trajectory>, DataError> {
    let path = &folder.join("traj.txt");
    if !is_present(path) {
        return Ok(None);
    }
    let mut lines = Lines::open(path)?;
    let mut poses = Vec::new();
    while let Some(line) = lines.next_line()? {
        poses.push(pose(&line, line.numbers()?)?);
    }
    if poses.len() != frames.len() {
        return Err(DataError::CountMismatch {
            path: path.into(),
            count: poses.len(),
            other: frames_path.into(),
            other_count: frames.len(),
        });
    }
    Trajectory::new(frames.iter().map(|frame| frame.timestamp_secs).zip(poses)).map(Some)
}

/// `groundtruth.txt`, else `device_poses.txt`, if the folder has one: the poses of those frames that it
/// brackets in time.
pub(super) fn read_trajectory(
    folder: &Path,
    frames: &[FrameFiles],
    frames_path: &Path,
) -> (Result<Option<Trajectory>, DataError>, PoseOrigin) {
    let known = [
        ("groundtruth.txt", PoseOrigin::GroundTruth),
        ("device_poses.txt", PoseOrigin::Device),
    ];
    let present = known
        .map(|(name, origin)| (folder.join(name), origin))
        .into_iter()
        .find(|(path, _)| is_present(path));
    match present {
        None => (Ok(None), PoseOrigin::GroundTruth),
        Some((path, origin)) => (at_frames(&path, frames, frames_path).map(Some), origin),
    }
}

fn at_frames(
    path: &Path,
    frames: &[FrameFiles],
    frames_path: &Path,
) -> Result<Trajectory, DataError> {
    let recorded = Trajectory::read(path)?;
    let at_frames = Trajectory::new(frames.iter().filter_map(|frame| {
        let pose = recorded.interpolate(frame.timestamp_secs, MAX_POSE_GAP_SECS)?;
        Some((frame.timestamp_secs, pose))
    }))?;
    if at_frames.poses().is_empty() {
        let recorded_secs: Vec<_> = recorded.poses().iter().map(|p| p.timestamp_secs).collect();
        let frame_secs: Vec<_> = frames.iter().map(|frame| frame.timestamp_secs).collect();
        return Err(no_overlap(
            (path, &recorded_secs),
            (frames_path, &frame_secs),
        ));
    }
    Ok(at_frames)
}

/// One matrix in four lines of four numbers.
pub(super) fn read_matrix(path: &Path) -> Result<Se3, DataError> {
    let mut lines = Lines::open(path)?;
    let mut values = Vec::with_capacity(16);
    while let Some(line) = lines.next_line()? {
        values.extend(line.numbers::<4>()?);
        if let Ok(row_major) = values.as_slice().try_into() {
            return pose(&line, row_major);
        }
    }
    Err(DataError::Empty {
        path: path.into(),
        what: "matrix of four lines",
    })
}

fn pose(line: &Line<'_>, row_major: [f64; 16]) -> Result<Se3, DataError> {
    let matrix = Matrix4::from_row_slice(&row_major);
    let pose = Se3::from_matrix(&matrix)
        .filter(|_| row_major[12..] == [0.0, 0.0, 0.0, 1.0])
        .ok_or_else(|| line.error(LineFault::Matrix))?;
    check_position(&pose).map_err(|fault| line.error(fault))?;
    Ok(pose)
}
