//! Where a frame may have been taken: where the motion model expects it, or where corners say (relocalizer.rs).

use std::sync::Arc;

use fgs_features::Features;
use fgs_geom::{RgbdFrame, Se3};
use fgs_gicp::SurfacePoint;

use super::Tracker;
use super::footing::Footing;
use crate::keyframes::Admission;
use crate::motion::MotionModel;
use crate::registrar::{Attempt, Known, Measured, Start};
use crate::relocalizer::Guess;

impl Tracker {
    /// The best pose of a frame that can be found; `None` if it cannot be registered at all, or cannot
    /// start the map.
    pub(super) fn find(
        &self,
        frame: &Arc<RgbdFrame>,
        points: &[SurfacePoint],
        admission: Admission,
    ) -> Option<Attempt> {
        let measured = Measured {
            frame,
            points,
            seconds: self.clock.now_secs(),
        };
        if self.newest_keyframe.is_none() {
            let place = || (self.registrar).place(measured, self.known(), &Se3::identity());
            return (admission == Admission::Allowed).then(place).flatten();
        }
        let attempt = |start: &Start| self.registrar.attempt(measured, self.known(), start);
        let predict = |device| self.motion.predict(measured.seconds, device);
        let predicted = predict(frame.device_pose.as_ref());
        let is_clear = |best: &Option<Attempt>| best.as_ref().is_some_and(|best| !best.is_doubtful);
        let mut best = predicted.and_then(|predicted| attempt(&Start::predicted(&predicted)));
        if is_clear(&best) {
            return best;
        }
        // The device's world may have jumped.
        if predicted.is_some_and(|predicted| predicted.is_by_device) {
            let steady = predict(None).and_then(|steady| attempt(&Start::predicted(&steady)));
            best = better(best, steady);
            if is_clear(&best) {
                return best;
            }
        }
        let features = Features::detect(measured.frame);
        let color_from_depth = measured.frame.depth_sensor.color_from_depth;
        let start_of = |guess: &Guess| {
            let world_from_depth = guess.world_from_camera * color_from_depth;
            Start::from_corners(world_from_depth, &guess.information)
        };
        for guess in self.relocalizer.guesses_nearby(&features, self.home) {
            best = better(best, attempt(&start_of(&guess)));
            if is_clear(&best) {
                return best;
            }
        }
        if matches!(self.footing, Footing::Firm) {
            return best;
        }
        // Nothing is known of the motion of a camera that is somewhere else.
        let known = Known {
            motion: &MotionModel::default(),
            ..self.known()
        };
        for guess in (self.relocalizer).guesses_anywhere(measured.frame, &features) {
            let relocalized = self.registrar.attempt(measured, known, &start_of(&guess));
            let relocalized = relocalized.map(|attempt| Attempt {
                relocalized_by: guess.keyframe,
                ..attempt
            });
            best = better(best, relocalized);
            if is_clear(&best) {
                return best;
            }
        }
        best
    }
}

/// The better of two poses of a frame.
fn better(a: Option<Attempt>, b: Option<Attempt>) -> Option<Attempt> {
    let worth = |attempt: &Attempt| (attempt.verdict, attempt.evidence.strength());
    match (a, b) {
        (Some(a), Some(b)) => Some(if worth(&b) > worth(&a) { b } else { a }),
        (a, b) => a.or(b),
    }
}
