//! The motion model: constant velocity in the camera's own axes, per second.
//!
//! In: the pose and time of each tracked frame. The camera is the depth camera: its poses come from
//! registration, one per frame. Out: the pose at which registration of the next
//! frame starts. Because velocity is per second and not per frame, dropped frames, lost frames and
//! uneven frame rates need no special care.

use fgs_geom::Se3;
use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

/// Assumed between two frames whose time stamps do not advance: then velocity is in effect per
/// frame, whatever this value.
const NOMINAL_INTERVAL_SECS: f64 = 1.0 / 30.0;

/// A hand does not keep its velocity for longer; the camera is then as likely to be anywhere near
/// where it was last seen.
const HORIZON_SECS: f64 = 0.5;

/// For so long the motion model is believed where nothing else holds the camera: walking people change their
/// velocity by 2 m/s in a second, which makes 4 cm.
const MAX_COAST_SECS: f64 = 0.2;

/// Predicts where the camera is next.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct MotionModel {
    last: Option<TimedPose>,
    /// When depth and colour last held the camera.
    held_secs: Option<f64>,
    /// Twist `[omega, v]` in the camera's axes, rad/s and m/s.
    velocity: Vector6<f64>,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct TimedPose {
    world_from_camera: Se3,
    timestamp_secs: f64,
}

impl TimedPose {
    fn secs_until(&self, timestamp_secs: f64) -> f64 {
        let interval = timestamp_secs - self.timestamp_secs;
        if interval.is_finite() && interval > 0.0 {
            interval
        } else {
            NOMINAL_INTERVAL_SECS
        }
    }
}

impl MotionModel {
    /// `world_from_camera` expected at a time; `None` before the first observation. After a gap of
    /// more than half a second, the last known pose.
    pub fn predict(&self, timestamp_secs: f64) -> Option<Se3> {
        let last = self.last?;
        let motion = last.secs_until(timestamp_secs) * self.velocity_at(timestamp_secs);
        Some(last.world_from_camera * Se3::exp(&motion))
    }

    /// The velocity expected at a time, `[omega, v]` in the camera's axes, rad/s and m/s; zero after a
    /// gap of more than half a second.
    fn velocity_at(&self, timestamp_secs: f64) -> Vector6<f64> {
        match self.last {
            Some(last) if last.secs_until(timestamp_secs) <= HORIZON_SECS => self.velocity,
            _ => Vector6::zeros(),
        }
    }

    /// The twist from the last frame to a pose, `[omega, v]` in the camera's axes, rad/s and m/s; zero
    /// before the second frame and after a gap of more than half a second.
    pub fn velocity_to(&self, world_from_camera: &Se3, timestamp_secs: f64) -> Vector6<f64> {
        let Some(last) = self.last else {
            return Vector6::zeros();
        };
        let interval = last.secs_until(timestamp_secs);
        if interval > HORIZON_SECS {
            Vector6::zeros()
        } else {
            (last.world_from_camera.inverse() * *world_from_camera).log() / interval
        }
    }

    /// Whether nothing has held the camera for too long.
    pub fn has_coasted(&self, timestamp_secs: f64) -> bool {
        let held_secs = self.held_secs;
        held_secs.is_some_and(|held_secs| timestamp_secs - held_secs > MAX_COAST_SECS)
    }

    /// A frame was tracked; `is_held` by depth and colour, or only by this model.
    pub fn observe(&mut self, world_from_camera: Se3, timestamp_secs: f64, is_held: bool) {
        if is_held || self.held_secs.is_none() {
            self.held_secs = Some(timestamp_secs);
        }
        self.velocity = self.velocity_to(&world_from_camera, timestamp_secs);
        self.last = Some(TimedPose {
            world_from_camera,
            timestamp_secs,
        });
    }

    /// The world around the camera moved rigidly, and the camera with it. Velocity, being in the
    /// camera's axes, stays.
    pub fn move_world(&mut self, new_world_from_old_world: &Se3) {
        if let Some(last) = &mut self.last {
            last.world_from_camera = *new_world_from_old_world * last.world_from_camera;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera that turns and moves steadily.
    fn pose(secs: f64) -> Se3 {
        let start = Se3::exp(&Vector6::new(0.3, -0.8, 0.1, 1.0, 2.0, -0.5));
        start * Se3::exp(&(secs * Vector6::new(0.9, -0.4, 0.6, 0.5, 1.2, -0.8)))
    }

    fn distance(a: &Se3, b: &Se3) -> f64 {
        (a.inverse() * *b).log().norm()
    }

    #[test]
    fn every_third_frame_missing_and_uneven_intervals_are_predicted() {
        let mut motion = MotionModel::default();
        assert!(motion.predict(0.0).is_none());
        for i in (0..60).filter(|i| i % 3 != 2) {
            // Jitter of a third of the interval.
            let secs = (f64::from(i) + if i % 4 == 0 { 0.33 } else { 0.0 }) / 30.0;
            if i > 1 {
                let predicted = motion.predict(secs).unwrap();
                assert!(distance(&predicted, &pose(secs)) <= 1e-9, "frame {i}");
                // A prediction by frames would be off by half a frame's motion at least.
                assert!(distance(&pose(secs), &pose(secs - 0.5 / 30.0)) >= 0.02);
            }
            motion.observe(pose(secs), secs, true);
        }
    }

    #[test]
    fn without_usable_time_stamps_velocity_is_per_frame() {
        for stamps in [[7.0; 4], [f64::NAN; 4], [9.0, 8.0, 7.0, 6.0]] {
            let mut motion = MotionModel::default();
            for (i, stamp) in stamps[..3].iter().enumerate() {
                motion.observe(pose(0.1 * i as f64), *stamp, true);
            }
            let predicted = motion.predict(stamps[3]).unwrap();
            assert!(distance(&predicted, &pose(0.3)) <= 1e-9, "{stamps:?}");
        }
    }

    #[test]
    fn a_long_gap_forgets_the_velocity() {
        let mut motion = MotionModel::default();
        motion.observe(pose(0.0), 0.0, true);
        motion.observe(pose(0.1), 0.1, true);
        assert!(distance(&motion.predict(0.7).unwrap(), &pose(0.1)) <= 1e-12);
        motion.observe(pose(2.0), 2.0, true);
        assert!(distance(&motion.predict(2.1).unwrap(), &pose(2.0)) <= 1e-12);
    }

    #[test]
    fn a_moved_world_moves_the_prediction_alike() {
        let moved = Se3::exp(&Vector6::new(-0.2, 0.5, 0.9, 3.0, -1.0, 0.4));
        let mut motion = MotionModel::default();
        motion.observe(pose(0.0), 0.0, true);
        motion.observe(pose(0.1), 0.1, true);
        motion.move_world(&moved);
        assert!(distance(&motion.predict(0.2).unwrap(), &(moved * pose(0.2))) <= 1e-9);
    }
}
