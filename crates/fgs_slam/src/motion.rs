//! The motion model: where the camera should be next.
//!
//! In: the pose and time of each tracked frame, and where the recording device believes it was, if it says.
//! The camera is the depth camera: its poses come from registration, one per frame. Out: the pose at which
//! registration of the next frame starts, and how sure it is.
//!
//! Devices that track themselves, like phones, are asked for their motion from frame to frame: never for
//! more, since their worlds drift and jump, and only while they have lately been right. Otherwise velocity
//! is taken to be constant, in the camera's own axes. Because it is per second and not per frame, dropped
//! frames, lost frames and uneven frame rates need no special care.

use fgs_geom::Se3;
use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

use crate::verdict::Hold;

/// Assumed between two frames whose time stamps do not advance: then velocity is in effect per
/// frame, whatever this value.
const NOMINAL_INTERVAL_SECS: f64 = 1.0 / 30.0;

/// A hand does not keep its velocity for longer; the camera is then as likely to be anywhere near
/// where it was last seen.
const HORIZON_SECS: f64 = 0.5;

/// For so long the motion model is believed where nothing else holds the camera: walking people change their
/// velocity by 2 m/s in a second, which makes 4 cm.
const MAX_COAST_SECS: f64 = 0.2;

/// For so long a device is believed: they drift by centimetres a second at worst.
const MAX_CARRY_SECS: f64 = 2.0;

/// Standard deviations of what a hand does between two frames that constant velocity does not predict.
const HAND_RAD: f64 = 0.02;
const HAND_M: f64 = 0.02;

/// A device is believed after so many frames in which its motion was known otherwise; of its errors those of
/// about so many frames count.
const DEVICE_FRAMES: u32 = 15;

/// No device is more exact than this from frame to frame, nor over a way, of which it is this share.
const DEVICE_RAD: f64 = 1e-3;
const DEVICE_M: f64 = 1e-3;
const DEVICE_DRIFT: f64 = 0.01;

/// Where the camera should be.
#[derive(Clone, Copy, Debug)]
pub struct Prediction {
    /// Pose of the depth camera.
    pub world_from_camera: Se3,
    /// Standard deviation of its rotation, radians.
    pub rotation_rad: f64,
    /// Standard deviation of its position, metres.
    pub translation_m: f64,
    /// Whether the recording device says so.
    pub is_by_device: bool,
    /// Whether it can be relied on where nothing else holds the camera.
    pub holds: bool,
}

/// Predicts where the camera is next.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct MotionModel {
    last: Option<TimedPose>,
    device: DeviceErrors,
    /// When depth and colour last held the camera.
    held_secs: Option<f64>,
    /// Twist `[omega, v]` in the camera's axes, rad/s and m/s.
    velocity: Vector6<f64>,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct TimedPose {
    world_from_camera: Se3,
    device: Option<Se3>,
    timestamp_secs: f64,
}

/// How well a device tells its motion from frame to frame.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct DeviceErrors {
    frames: u32,
    /// Mean squares of the errors, the newer weighing more.
    rotation_rad2: f64,
    translation_m2: f64,
}

impl DeviceErrors {
    /// The motion seen differs by `error` from the device's, and may be wrong itself by `uncertainty_m`.
    fn observe(&mut self, error: &Se3, uncertainty_m: f64) {
        self.frames = (self.frames + 1).min(DEVICE_FRAMES);
        let weight = 1.0 / f64::from(self.frames);
        let mean = |mean: &mut f64, new: f64| *mean += weight * (new * new - *mean);
        mean(&mut self.rotation_rad2, error.rotation.angle());
        let translation_m = (error.translation.norm() - uncertainty_m).max(0.0);
        mean(&mut self.translation_m2, translation_m);
    }

    /// Whether it tells more than a guess would.
    fn are_small(&self) -> bool {
        self.frames >= DEVICE_FRAMES
            && self.rotation_rad2 <= HAND_RAD * HAND_RAD
            && self.translation_m2 <= HAND_M * HAND_M
    }
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
    /// Where the camera should be at a time, given where the device believes it to be; `None` before the first
    /// observation. Without the device's word, after a gap of more than half a second: the last known pose.
    pub fn predict(&self, timestamp_secs: f64, device: Option<&Se3>) -> Option<Prediction> {
        let last = self.last?;
        if let (Some(before), Some(now)) = (last.device, device)
            && self.device.are_small()
        {
            let motion = before.inverse() * *now;
            let held_secs = self.held_secs;
            return Some(Prediction {
                world_from_camera: last.world_from_camera * motion,
                rotation_rad: self.device.rotation_rad2.sqrt().max(DEVICE_RAD)
                    + DEVICE_DRIFT * motion.rotation.angle(),
                translation_m: self.device.translation_m2.sqrt().max(DEVICE_M)
                    + DEVICE_DRIFT * motion.translation.norm(),
                is_by_device: true,
                holds: held_secs
                    .is_some_and(|held_secs| timestamp_secs - held_secs <= MAX_CARRY_SECS),
            });
        }
        let motion = last.secs_until(timestamp_secs) * self.velocity_at(timestamp_secs);
        Some(Prediction {
            world_from_camera: last.world_from_camera * Se3::exp(&motion),
            rotation_rad: HAND_RAD,
            translation_m: HAND_M,
            is_by_device: false,
            holds: false,
        })
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

    /// A frame was tracked. `uncertainty_m` is how far depth and colour left its position open along the worst
    /// direction, a standard deviation; `device` is where the device believes it was.
    pub fn observe(
        &mut self,
        world_from_camera: Se3,
        timestamp_secs: f64,
        uncertainty_m: f64,
        device: Option<Se3>,
    ) {
        let hold = Hold::of(uncertainty_m);
        if hold == Hold::Firm
            && let Some(last) = self.last
            && let (Some(before), Some(now)) = (last.device, device)
            && last.secs_until(timestamp_secs) <= HORIZON_SECS
        {
            let motion = last.world_from_camera.inverse() * world_from_camera;
            (self.device).observe(&(now.inverse() * before * motion), uncertainty_m);
        }
        if hold > Hold::None || self.held_secs.is_none() {
            self.held_secs = Some(timestamp_secs);
        }
        self.velocity = self.velocity_to(&world_from_camera, timestamp_secs);
        self.last = Some(TimedPose {
            world_from_camera,
            device,
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

    fn predicted(motion: &MotionModel, secs: f64) -> Se3 {
        motion.predict(secs, None).unwrap().world_from_camera
    }

    fn distance(a: &Se3, b: &Se3) -> f64 {
        (a.inverse() * *b).log().norm()
    }

    #[test]
    fn every_third_frame_missing_and_uneven_intervals_are_predicted() {
        let mut motion = MotionModel::default();
        assert!(motion.predict(0.0, None).is_none());
        for i in (0..60).filter(|i| i % 3 != 2) {
            // Jitter of a third of the interval.
            let secs = (f64::from(i) + if i % 4 == 0 { 0.33 } else { 0.0 }) / 30.0;
            if i > 1 {
                let predicted = predicted(&motion, secs);
                assert!(distance(&predicted, &pose(secs)) <= 1e-9, "frame {i}");
                // A prediction by frames would be off by half a frame's motion at least.
                assert!(distance(&pose(secs), &pose(secs - 0.5 / 30.0)) >= 0.02);
            }
            motion.observe(pose(secs), secs, 0.0, None);
        }
    }

    #[test]
    fn without_usable_time_stamps_velocity_is_per_frame() {
        for stamps in [[7.0; 4], [f64::NAN; 4], [9.0, 8.0, 7.0, 6.0]] {
            let mut motion = MotionModel::default();
            for (i, stamp) in stamps[..3].iter().enumerate() {
                motion.observe(pose(0.1 * i as f64), *stamp, 0.0, None);
            }
            let predicted = predicted(&motion, stamps[3]);
            assert!(distance(&predicted, &pose(0.3)) <= 1e-9, "{stamps:?}");
        }
    }

    #[test]
    fn a_long_gap_forgets_the_velocity() {
        let mut motion = MotionModel::default();
        motion.observe(pose(0.0), 0.0, 0.0, None);
        motion.observe(pose(0.1), 0.1, 0.0, None);
        assert!(distance(&predicted(&motion, 0.7), &pose(0.1)) <= 1e-12);
        motion.observe(pose(2.0), 2.0, 0.0, None);
        assert!(distance(&predicted(&motion, 2.1), &pose(2.0)) <= 1e-12);
    }

    #[test]
    fn a_moved_world_moves_the_prediction_alike() {
        let moved = Se3::exp(&Vector6::new(-0.2, 0.5, 0.9, 3.0, -1.0, 0.4));
        let mut motion = MotionModel::default();
        motion.observe(pose(0.0), 0.0, 0.0, None);
        motion.observe(pose(0.1), 0.1, 0.0, None);
        motion.move_world(&moved);
        assert!(distance(&predicted(&motion, 0.2), &(moved * pose(0.2))) <= 1e-9);
    }

    /// A jerky way, which constant velocity does not predict, and where a device believes itself to be: in
    /// a world of its own, with its distances wrong by a factor.
    fn jerky(frame: usize, scale: f64) -> (f64, Se3, Se3) {
        let secs = frame as f64 / 30.0;
        let jerk = 0.05 * (frame % 3) as f64;
        let truth = pose(secs) * Se3::exp(&Vector6::new(jerk, 0.0, 0.0, 0.0, jerk, 0.0));
        let mut scaled = truth;
        scaled.translation *= scale;
        let elsewhere = Se3::exp(&Vector6::new(2.0, 0.3, -0.5, 9.0, 8.0, 7.0));
        (secs, truth, elsewhere * scaled)
    }

    #[test]
    fn a_device_that_was_right_is_believed_for_a_while() {
        let mut motion = MotionModel::default();
        for frame in 0..100 {
            let (secs, truth, device) = jerky(frame, 1.0);
            if let Some(predicted) = motion.predict(secs, Some(&device)) {
                // The first frame says nothing of its motion.
                assert_eq!(predicted.is_by_device, frame > DEVICE_FRAMES as usize);
                if predicted.is_by_device {
                    assert!(distance(&predicted.world_from_camera, &truth) <= 1e-9);
                    assert_eq!(predicted.holds, frame <= 40 + 60, "frame {frame}");
                    assert!(predicted.translation_m <= 2.0 * DEVICE_M);
                }
            }
            let uncertainty_m = if frame <= 40 { 1e-3 } else { 1.0 };
            motion.observe(truth, secs, uncertainty_m, Some(device));
        }
        let (secs, _, device) = jerky(120, 1.0);
        assert!(!motion.predict(secs, Some(&device)).unwrap().holds);
        // Where the device says nothing, velocity is constant.
        assert!(!motion.predict(secs, None).unwrap().is_by_device);
    }

    #[test]
    fn a_device_that_is_wrong_is_not_believed() {
        let mut motion = MotionModel::default();
        for frame in 0..60 {
            let (secs, truth, device) = jerky(frame, 2.0);
            let predicted = motion.predict(secs, Some(&device));
            assert!(predicted.is_none_or(|predicted| !predicted.is_by_device));
            motion.observe(truth, secs, 1e-3, Some(device));
        }
    }
}
