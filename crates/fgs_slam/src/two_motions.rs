//! Two motions in one frame: something large that is part of the map begins to move. Part of the frame then
//! fits the map at one pose, and part at another; registration takes what weighs more, or something between.
//!
//! Such a frame fits worse than frames usually do. Then other poses are tried: of the points that fit where the
//! camera is expected, and of the far ones, since what moves is mostly near. The camera's pose is the one that
//! most of the frame fits, and that motion makes likely: people stop, start and turn more abruptly than a
//! camera in a hand, which sees everything move at once.

use fgs_geom::Se3;
use fgs_gicp::SurfacePoint;
use serde::{Deserialize, Serialize};

use crate::motion::{MotionModel, Prediction};
use crate::registrar::{Attempt, Known, Measured, Registrar, Start};

/// A frame is suspect whose residuals are so many times as large as usual, and fits well below the other.
const SUSPECT: f64 = 1.5;
const FITS_WELL: f64 = 1.15;

/// How much the newest frame counts in what is usual: where all fits worse from a frame on, it takes a second
/// to get used to.
const RATE: f64 = 0.03;

/// A point fits within so many standard deviations.
const FITS: f64 = 3.0;

/// Poses are the same that differ by less, metres and radians.
const SAME_M: f64 = 0.005;
const SAME_RAD: f64 = 0.005;

/// It does not matter which of two poses is right that differ by less: half of what makes a pose wrong.
const MATTERS_M: f64 = 0.025;
const MATTERS_RAD: f64 = 0.025;

/// The share of the points that a standard deviation from the expected motion outweighs; it grows with the square
/// up to a limit.
const UNLIKELY: f64 = 0.01;
const MOST_UNLIKELY: f64 = 0.1;

/// Of the points that are registered by themselves every so many will do: thousands are left.
const STEP: usize = 4;

/// Poses are told apart by at least this share of the points.
const CLEARLY: f64 = 0.1;

/// How well frames fit the map.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct UsualFit {
    /// The usual variance of residuals relative to the points' covariances.
    variance: Option<f64>,
    /// The camera's motion when a frame last fitted well.
    motion: MotionModel,
    /// How many frames have been found since, which did not.
    frames: usize,
}

/// What is to be made of a frame.
pub enum Suspicion {
    /// It fits no better anywhere else.
    Unfounded,
    /// It fits about as well at another pose.
    Open,
    /// It fits better at another pose, or as well at a likelier one: that is the camera's.
    Founded(TwoMotions),
}

/// A frame with two motions.
pub struct TwoMotions {
    pub world_from_depth: Se3,
    /// Which of the frame's points fit the pose where it was found, and not the camera's: what moves.
    pub moves: Vec<bool>,
    /// Whether it is clear which pose is the camera's.
    pub is_clear: bool,
}

/// Where the camera may be.
struct Hypothesis {
    world_from_depth: Se3,
    /// Which of the frame's points fit there.
    fits: Vec<bool>,
    /// Their share, less what the motion there lacks in likelihood.
    score: f64,
}

impl UsualFit {
    /// A frame was found, with these residuals and the camera's motion up to it.
    pub fn observe(&mut self, residual_variance: f64, motion: &MotionModel) {
        if residual_variance == 0.0 {
            return;
        }
        let usual = self.variance.get_or_insert(residual_variance);
        if residual_variance <= FITS_WELL * FITS_WELL * *usual {
            self.motion = motion.clone();
            self.frames = 0;
        } else {
            self.frames += 1;
        }
        let variance = residual_variance.min(SUSPECT * SUSPECT * *usual);
        *usual += RATE * (variance - *usual);
    }

    /// The camera's motion when a frame last fitted well.
    pub fn motion(&self) -> &MotionModel {
        &self.motion
    }

    /// The world around the camera moved rigidly, and the camera with it.
    pub fn move_world(&mut self, new_world_from_old_world: &Se3) {
        self.motion.move_world(new_world_from_old_world);
    }

    /// Looks for two motions in a frame that was found at a pose.
    pub fn investigate(
        &self,
        registrar: &Registrar,
        measured: Measured,
        known: Known,
        found: &Attempt,
    ) -> Suspicion {
        let device = measured.frame.device_pose.as_ref();
        let suspect = self.suspect(found.residual_variance);
        let (Some(usual), Some(predicted)) =
            (suspect, self.motion.predict(measured.seconds, device))
        else {
            return Suspicion::Unfounded;
        };
        let fitting = |pose: &Se3| registrar.fitting(measured, known, pose, FITS * FITS * usual);
        let judge = |world_from_depth: Se3| {
            let fits = fitting(&world_from_depth);
            let share = fits.iter().filter(|fits| **fits).count() as f64 / fits.len() as f64;
            Hypothesis {
                score: share - self.unlikelihood(&predicted, &world_from_depth),
                world_from_depth,
                fits,
            }
        };
        let by_points = |chosen: Vec<bool>| {
            let points = measured.points.iter().zip(&chosen);
            let points = points.filter_map(|(point, chosen)| chosen.then_some(*point));
            let points: Vec<SurfacePoint> = points.step_by(STEP).collect();
            let only = Measured {
                points: &points,
                ..measured
            };
            let pose = registrar.register(only, known, &Start::predicted(&predicted))?;
            Some(judge(pose))
        };
        let where_expected = fitting(&predicted.world_from_camera);
        let others = [where_expected, far_half(measured.points)];
        let others = others.into_iter().filter_map(by_points);
        let other = others.reduce(|a, b| if b.score > a.score { b } else { a });
        other.map_or(Suspicion::Unfounded, |other| {
            compare(&judge(found.world_from_depth), &other)
        })
    }

    /// The usual variance, if a frame's is suspiciously larger.
    fn suspect(&self, residual_variance: f64) -> Option<f64> {
        let is_larger = |usual: &f64| residual_variance > SUSPECT * SUSPECT * usual;
        self.variance.filter(is_larger)
    }

    /// What a motion that is not the expected one takes from a score.
    fn unlikelihood(&self, predicted: &Prediction, world_from_depth: &Se3) -> f64 {
        let moved = predicted.world_from_camera.inverse() * *world_from_depth;
        let frames = (self.frames + 1) as f64;
        let deviations2 = (moved.translation.norm() / (frames * predicted.translation_m)).powi(2)
            + (moved.rotation.angle() / (frames * predicted.rotation_rad)).powi(2);
        (UNLIKELY * deviations2).min(MOST_UNLIKELY)
    }
}

/// What to make of a frame that was found at one pose, and fits another too.
fn compare(found: &Hypothesis, other: &Hypothesis) -> Suspicion {
    let apart = found.world_from_depth.inverse() * other.world_from_depth;
    let is_within = |metres: f64, radians: f64| {
        apart.translation.norm() < metres && apart.rotation.angle() < radians
    };
    let better = other.score - found.score;
    if better <= 0.0 {
        let may_be_wrong = better > -CLEARLY && !is_within(MATTERS_M, MATTERS_RAD);
        return if may_be_wrong {
            Suspicion::Open
        } else {
            Suspicion::Unfounded
        };
    }
    if is_within(SAME_M, SAME_RAD) {
        return Suspicion::Unfounded;
    }
    let both = found.fits.iter().zip(&other.fits);
    Suspicion::Founded(TwoMotions {
        world_from_depth: other.world_from_depth,
        moves: both.map(|(found, other)| *found && !*other).collect(),
        is_clear: better >= CLEARLY,
    })
}

/// Which points are further away than the middle one.
fn far_half(points: &[SurfacePoint]) -> Vec<bool> {
    let mut depths: Vec<f64> = points.iter().map(|point| point.fitted.z).collect();
    depths.sort_unstable_by(f64::total_cmp);
    let middle_m = depths.get(depths.len() / 2).copied();
    let far = points.iter().map(|point| Some(point.fitted.z) > middle_m);
    far.collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    fn along_x(metres: f64) -> Se3 {
        Se3::new(UnitQuaternion::identity(), Vector3::new(metres, 0.0, 0.0))
    }

    #[test]
    fn a_frame_is_suspect_that_fits_worse_until_all_do() {
        let mut usual = UsualFit::default();
        let still = MotionModel::default();
        assert!(usual.suspect(100.0).is_none());
        for _ in 0..5 {
            usual.observe(1.0, &still);
        }
        assert!(usual.suspect(2.2).is_none());
        assert!(usual.suspect(2.3).is_some());
        let frames = (0..200).take_while(|_| {
            let is_suspect = usual.suspect(6.0).is_some();
            usual.observe(6.0, &still);
            is_suspect
        });
        let frames = frames.count();
        assert!((20..60).contains(&frames), "{frames}");
    }

    #[test]
    fn the_motion_of_frames_that_fit_well_is_kept() {
        let mut usual = UsualFit::default();
        let motion = |x: f64| {
            let mut motion = MotionModel::default();
            motion.observe(along_x(x), x, 1e-3, None);
            motion
        };
        let position = |usual: &UsualFit| {
            let predicted = usual.motion().predict(10.0, None).unwrap();
            predicted.world_from_camera.translation.x
        };
        usual.observe(1.0, &motion(1.0));
        usual.observe(1.2, &motion(2.0));
        assert!(position(&usual) == 2.0);
        usual.observe(2.0, &motion(3.0));
        assert!(position(&usual) == 2.0 && usual.frames == 1);
        usual.move_world(&along_x(5.0));
        assert!(position(&usual) == 7.0);
    }

    #[test]
    fn the_far_half_is_beyond_the_middle() {
        let at = |z: f64| SurfacePoint {
            u: 0,
            v: 0,
            measured: Vector3::new(0.0, 0.0, z),
            fitted: Vector3::new(0.0, 0.0, z),
            normal: -Vector3::z(),
        };
        let far = far_half(&[3.0, 1.0, 2.0, 5.0, 4.0].map(at));
        assert_eq!(far, [false, false, false, true, true]);
        assert!(far_half(&[]).is_empty());
    }
}
