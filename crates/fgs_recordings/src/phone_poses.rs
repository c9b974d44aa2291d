//! Poses as phones and renderers give them: camera axes x right, y up, z backward, those of ARKit and
//! OpenGL. Ours are x right, y down, z forward: half a turn about x.

use fgs_data::{DataError, Trajectory};
use fgs_geom::Se3;
use nalgebra::{UnitQuaternion, Vector3};

/// `world_from_camera` in our axes.
pub(crate) fn from_y_up(world_from_camera: Se3) -> Se3 {
    let half_turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    world_from_camera * Se3::new(half_turn, Vector3::zeros())
}

/// Where frames have no times, those of a camera of this rate are assumed, frames a second.
const FRAME_RATE_HZ: f64 = 30.0;

/// The times of so many frames that have none, seconds.
pub(crate) fn assumed_times(count: usize) -> Vec<f64> {
    (0..count)
        .map(|index| index as f64 / FRAME_RATE_HZ)
        .collect()
}

/// The poses of those frames that have one; `None` if none has.
///
/// # Errors
/// If a pose or time is impossible.
pub(crate) fn trajectory(
    timestamps: &[f64],
    poses: impl Iterator<Item = Option<Se3>>,
) -> Result<Option<Trajectory>, DataError> {
    let known = timestamps.iter().copied().zip(poses);
    let known: Vec<_> = known
        .filter_map(|(secs, pose)| Some((secs, pose?)))
        .collect();
    (!known.is_empty())
        .then(|| Trajectory::new(known))
        .transpose()
}
