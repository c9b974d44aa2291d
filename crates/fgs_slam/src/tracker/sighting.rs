//! A frame without what moves in it (moving.rs, two_motions.rs).

use std::sync::Arc;

use fgs_geom::RgbdFrame;
use fgs_gicp::SurfacePoint;

use super::Tracker;
use super::footing::Footing;
use crate::keyframes::Admission;
use crate::moving::Moving;
use crate::registrar::{Attempt, Measured};
use crate::two_motions::Suspicion;
use crate::verdict::Verdict;

/// A frame without what moves in it.
pub struct Sighting {
    pub found: Option<Attempt>,
    pub points: Vec<SurfacePoint>,
    /// What was left out.
    pub moving: Option<Moving>,
    /// It was part of the map before.
    pub something_left: bool,
    /// Whether it may not as well be the camera that moved.
    pub is_sure: bool,
}

impl Sighting {
    /// Of a frame in which all stands still.
    fn whole(found: Option<Attempt>, points: Vec<SurfacePoint>) -> Self {
        Self {
            found,
            points,
            moving: None,
            something_left: false,
            is_sure: true,
        }
    }
}

impl Tracker {
    /// Finds a frame, without what moves in it.
    pub(super) fn sight(&mut self, frame: &Arc<RgbdFrame>, admission: Admission) -> Sighting {
        let points = self.grid.surface_points(&frame.depth_m, &frame.camera);
        let Some(attempt) = self.find(frame, &points, admission) else {
            return Sighting::whole(None, points);
        };
        let suspicion = self.investigate(frame, &points, &attempt);
        let mut pose = attempt.located.world_from_camera;
        let mut moves = Vec::new();
        let mut is_sure = matches!(suspicion, Suspicion::Unfounded);
        let mut something_left = false;
        if let Suspicion::Founded(two) = suspicion {
            let depth_from_color = frame.depth_sensor.color_from_depth.inverse();
            pose = two.world_from_depth * depth_from_color;
            moves = (points.iter().zip(&two.moves))
                .filter_map(|(point, moves)| moves.then_some((point.u, point.v)))
                .collect();
            is_sure = two.is_clear;
            something_left = true;
        }
        let Some(moving) = self.moving.find(frame, &pose, &moves) else {
            return Sighting {
                is_sure: is_sure && !something_left,
                ..Sighting::whole(Some(attempt), points)
            };
        };
        if something_left {
            // What the camera seemed to do since was the other's motion.
            self.motion = self.usual_fit.motion().clone();
        }
        let still = Arc::new(moving.left_out_of(frame));
        let points = self.grid.surface_points(&still.depth_m, &still.camera);
        Sighting {
            found: self.find(&still, &points, admission),
            points,
            moving: Some(moving),
            something_left,
            is_sure,
        }
    }

    /// Whether something began to move in a frame that is about to be believed.
    fn investigate(
        &self,
        frame: &Arc<RgbdFrame>,
        points: &[SurfacePoint],
        attempt: &Attempt,
    ) -> Suspicion {
        if attempt.verdict == Verdict::Lost || !matches!(self.footing, Footing::Firm) {
            return Suspicion::Unfounded;
        }
        let measured = Measured {
            frame,
            points,
            seconds: self.clock.now_secs(),
        };
        (self.usual_fit).investigate(&self.registrar, measured, self.known(), attempt)
    }
}
