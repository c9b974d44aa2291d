//! What a frame's pose is worth after those before it: a lost camera must be found twice, and one that is
//! found nowhere starts a sub-map (submaps.rs).

use std::sync::Arc;

use fgs_geom::{KeyframeId, RgbdFrame, Se3};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::Tracker;
use crate::keyframes::Admission;
use crate::motion::MotionModel;
use crate::moving::MovingThings;
use crate::registrar::{Attempt, Known, Measured};
use crate::relocalizer::follows;
use crate::submaps::APART_M;
use crate::verdict::{Hold, Verdict};

/// A camera is lost for good when it has not been found in so many frames that show what the frame before each
/// shows, less those that do not: it sees well, but nothing that is known.
const MAX_FOLLOWED: usize = 12;

/// What the camera's last pose is worth.
#[derive(Clone, Default, Serialize, Deserialize)]
pub enum Footing {
    /// It is trusted.
    #[default]
    Firm,
    /// The camera is lost. So many frames showed what the one before each showed, less those that did not.
    Lost { followed: usize },
    /// One frame says where it is. If the next does not agree, what was before is taken up.
    Found {
        motion_before: Box<MotionModel>,
        home_before: Option<KeyframeId>,
    },
}

impl Tracker {
    /// What a frame's own verdict is worth after those before it.
    pub(super) fn believe(&mut self, attempt: &Attempt) -> Verdict {
        let own = attempt.verdict;
        let is_a_find = own == Verdict::Tracked && attempt.evidence.is_a_find();
        let has_slid =
            attempt.evidence.hold() == Hold::None && self.motion.has_coasted(self.clock.now_secs());
        let is_known = is_a_find || matches!(self.footing, Footing::Firm);
        if own == Verdict::Lost || has_slid || !is_known {
            self.stumble();
            return Verdict::Lost;
        }
        let is_relocalized = attempt.relocalized_by.is_some();
        let is_first = matches!(self.footing, Footing::Lost { .. });
        let needs_another = is_first && (attempt.is_doubtful || is_relocalized);
        self.footing = if needs_another {
            Footing::Found {
                motion_before: Box::new(self.motion.clone()),
                home_before: self.home,
            }
        } else {
            Footing::Firm
        };
        if is_relocalized {
            self.home = attempt.relocalized_by;
            self.motion = MotionModel::default();
        }
        if needs_another { Verdict::Weak } else { own }
    }

    /// A frame is lost, and with it what only the frame before said.
    pub(super) fn stumble(&mut self) {
        match &self.footing {
            Footing::Lost { .. } => return,
            Footing::Firm => {}
            Footing::Found {
                motion_before,
                home_before,
            } => {
                self.motion = (**motion_before).clone();
                self.home = *home_before;
            }
        }
        self.footing = Footing::Lost { followed: 0 };
    }

    /// Where a camera begins a sub-map that has been lost for a while and sees well; `None` if it does not.
    pub(super) fn start_elsewhere(
        &mut self,
        frame: &Arc<RgbdFrame>,
        admission: Admission,
    ) -> Option<Attempt> {
        let Footing::Lost { followed } = &mut self.footing else {
            return None;
        };
        let before = self.latest.as_ref()?;
        let can_be_followed = follows(frame, &before.frame);
        *followed = if can_be_followed {
            *followed + 1
        } else {
            followed.saturating_sub(1)
        };
        if !can_be_followed || *followed < MAX_FOLLOWED || admission != Admission::Allowed {
            return None;
        }
        let height_m = self.relocalizer.highest_m()? + APART_M;
        let elsewhere = Se3::new(
            UnitQuaternion::identity(),
            Vector3::new(0.0, -height_m, 0.0),
        );
        let measured = Measured {
            frame,
            points: &self.grid.surface_points(&frame.depth_m, &frame.camera),
            seconds: self.clock.now_secs(),
        };
        let nowhere = MotionModel::default();
        let known = Known {
            motion: &nowhere,
            ..self.known()
        };
        let attempt = self.registrar.place(measured, known, &elsewhere)?;
        self.footing = Footing::Firm;
        self.home = None;
        self.motion = nowhere;
        self.moving = MovingThings::default();
        Some(attempt)
    }
}
