//! Trajectories and their text files in TUM's format: `timestamp tx ty tz qx qy qz qw` per line,
//! seconds and metres, `world_from_camera`.
//!
//! The format's quaternion order, xyzw, appears in this module only. A [`Trajectory`] holds finite
//! poses at strictly increasing times.

use std::borrow::Cow;
use std::io::Write;
use std::path::Path;

use fgs_geom::{RgbdFrame, Se3};
use nalgebra::Vector6;

use crate::lines::Lines;
use crate::{DataError, LineFault};

/// Files carry two digits of a quaternion at the very least; a length further from 1 means that
/// the columns are something else.
const MAX_QUATERNION_LENGTH_ERROR: f64 = 0.05;

/// A thousand kilometres: single precision, in which maps are kept, is good to 6 cm there.
const MAX_COORDINATE_M: f64 = 1e6;

/// Poses further apart in time do not say how the camera moved at a frame, seconds.
const MAX_GAP_SECS: f64 = 0.2;

/// Poses closer in time say nothing of a velocity: time stamps have microseconds at best.
const MIN_INTERVAL_SECS: f64 = 1e-6;

/// A camera pose with its timestamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Seconds on the recording's clock.
    pub timestamp_secs: f64,
    /// The camera's pose.
    pub world_from_camera: Se3,
}

/// Poses at strictly increasing times, all finite.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    poses: Vec<StampedPose>,
}

impl Trajectory {
    /// Creates a trajectory from (timestamp in seconds, pose) pairs.
    ///
    /// # Errors
    /// For the first pose that is not finite or not later than its predecessor.
    pub fn new(poses: impl IntoIterator<Item = (f64, Se3)>) -> Result<Self, DataError> {
        let mut trajectory = Self::default();
        for (index, (timestamp_secs, world_from_camera)) in poses.into_iter().enumerate() {
            trajectory
                .push(timestamp_secs, world_from_camera)
                .map_err(|fault| DataError::Pose { index, fault })?;
        }
        Ok(trajectory)
    }

    fn push(&mut self, timestamp_secs: f64, world_from_camera: Se3) -> Result<(), LineFault> {
        if !timestamp_secs.is_finite() {
            return Err(LineFault::OutOfRange(timestamp_secs));
        }
        check_position(&world_from_camera)?;
        let length = world_from_camera.rotation.norm();
        if !is_unit(length) {
            return Err(LineFault::Quaternion(length));
        }
        if let Some(last) = self.poses.last()
            && timestamp_secs <= last.timestamp_secs
        {
            return Err(LineFault::NotIncreasing {
                previous: last.timestamp_secs,
                current: timestamp_secs,
            });
        }
        self.poses.push(StampedPose {
            timestamp_secs,
            world_from_camera,
        });
        Ok(())
    }

    /// Reads a file in TUM's format; lines starting with `#` are comments.
    ///
    /// # Errors
    /// If the file cannot be read, or a line does not hold eight finite numbers, a unit quaternion
    /// and a timestamp later than the previous one, with path and line number.
    pub fn read(path: &Path) -> Result<Self, DataError> {
        let mut trajectory = Self::default();
        let mut lines = Lines::open(path)?;
        while let Some(line) = lines.next_line()? {
            let [timestamp_secs, tx, ty, tz, qx, qy, qz, qw] = line.numbers()?;
            let length = [qx, qy, qz, qw]
                .iter()
                .fold(0.0, |sum: f64, q| sum.hypot(*q));
            let pose = Se3::from_wxyz([qw, qx, qy, qz], [tx, ty, tz])
                .filter(|_| is_unit(length))
                .ok_or_else(|| line.error(LineFault::Quaternion(length)))?;
            trajectory
                .push(timestamp_secs, pose)
                .map_err(|fault| line.error(fault))?;
        }
        Ok(trajectory)
    }

    /// Writes a file in TUM's format with all digits, so that [`Trajectory::read`] returns the same
    /// numbers. The file appears complete or not at all.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), DataError> {
        fgs_files::write_file(path, |file| self.encode(file)).map_err(|source| DataError::Io {
            path: path.into(),
            source,
        })
    }

    /// Writes what [`write`](Self::write) does to any writer.
    ///
    /// # Errors
    /// What the writer returns.
    pub fn encode(&self, file: &mut impl Write) -> std::io::Result<()> {
        writeln!(file, "# timestamp tx ty tz qx qy qz qw")?;
        for pose in &self.poses {
            let t = pose.world_from_camera.translation;
            let q = pose.world_from_camera.rotation.coords; // xyzw
            let seconds = pose.timestamp_secs;
            writeln!(
                file,
                "{seconds} {} {} {} {} {} {} {}",
                t.x, t.y, t.z, q.x, q.y, q.z, q.w
            )?;
        }
        Ok(())
    }

    /// The poses in chronological order.
    pub fn poses(&self) -> &[StampedPose] {
        &self.poses
    }

    /// The pose with exactly this timestamp, if there is one.
    pub fn at(&self, timestamp_secs: f64) -> Option<Se3> {
        self.interpolate(timestamp_secs, 0.0)
    }

    /// The pose at any time: that of an equal timestamp or, if the neighbouring poses are at most
    /// `max_gap_secs` apart, interpolated along the geodesic between them. `None` outside the
    /// trajectory and in longer gaps.
    pub fn interpolate(&self, timestamp_secs: f64, max_gap_secs: f64) -> Option<Se3> {
        let next = self
            .poses
            .partition_point(|pose| pose.timestamp_secs < timestamp_secs);
        let after = self.poses.get(next)?;
        if after.timestamp_secs == timestamp_secs {
            return Some(after.world_from_camera);
        }
        let before = self.poses.get(next.checked_sub(1)?)?;
        let gap = after.timestamp_secs - before.timestamp_secs;
        let t = (timestamp_secs - before.timestamp_secs) / gap;
        (gap <= max_gap_secs).then(|| {
            before
                .world_from_camera
                .interpolate(&after.world_from_camera, t)
        })
    }

    /// The camera's velocity at the pose with exactly this timestamp, from the pose before it to the one
    /// after it: a twist `[omega, v]` in its own axes, rad/s and m/s. Neighbours more than
    /// `max_gap_secs` away do not count; zero if there is no such pose, it stands alone, or its
    /// neighbours are less than a microsecond apart.
    pub fn velocity(&self, timestamp_secs: f64, max_gap_secs: f64) -> Vector6<f64> {
        let is_earlier = |pose: &StampedPose| pose.timestamp_secs < timestamp_secs;
        let index = self.poses.partition_point(is_earlier);
        let near = |i: usize| {
            let pose = self.poses.get(i)?;
            ((pose.timestamp_secs - timestamp_secs).abs() <= max_gap_secs).then_some(pose)
        };
        let Some(now) = near(index).filter(|pose| pose.timestamp_secs == timestamp_secs) else {
            return Vector6::zeros();
        };
        let before = index.checked_sub(1).and_then(near).unwrap_or(now);
        let after = near(index + 1).unwrap_or(now);
        let interval = after.timestamp_secs - before.timestamp_secs;
        if interval >= MIN_INTERVAL_SECS {
            (before.world_from_camera.inverse() * after.world_from_camera).log() / interval
        } else {
            Vector6::zeros()
        }
    }

    /// What a render at a frame's pose can be compared with: the frame as one camera with a global
    /// shutter would have taken it, its rows and its depth image brought to the moment of its time
    /// stamp by the velocity of this trajectory.
    pub fn synchronized<'a>(&self, frame: &'a RgbdFrame) -> Cow<'a, RgbdFrame> {
        frame.synchronized(&self.velocity(frame.timestamp_secs, MAX_GAP_SECS))
    }
}

/// Refuses positions that maps cannot hold.
pub(crate) fn check_position(world_from_camera: &Se3) -> Result<(), LineFault> {
    for &coordinate in world_from_camera.translation.iter() {
        if !(-MAX_COORDINATE_M..=MAX_COORDINATE_M).contains(&coordinate) {
            return Err(LineFault::OutOfRange(coordinate));
        }
    }
    Ok(())
}

fn is_unit(quaternion_length: f64) -> bool {
    (quaternion_length - 1.0).abs() <= MAX_QUATERNION_LENGTH_ERROR
}
