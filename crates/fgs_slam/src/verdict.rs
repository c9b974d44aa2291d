//! Whether a pose can be trusted, from what speaks for it. A wrong pose that is believed spoils the
//! map for good; a frame too many that is lost costs little.
//!
//! Differs from the paper, which believes every pose.

use fgs_direct::Agreement;
use serde::{Deserialize, Serialize};

use crate::config::TrackingConfig;

/// So many of a keyframe's points tell whether a frame agrees with it.
const MIN_COMPARED: usize = 30;

/// With less support by a keyframe ([`Agreement::support`]) than this, a frame was not taken there.
const MIN_SUPPORT: f64 = 0.25;

/// With this much a pose is trusted.
const GOOD_SUPPORT: f64 = 0.45;

/// With this much there is no need to look for a better one. Such a frame may show much that the map
/// lacks: only so many of its points need to be registered.
const CLEAR_SUPPORT: f64 = 0.75;
const CLEAR_INLIER_SHARE: f64 = 0.3;

/// So much more support tells two poses of a frame apart.
const CLEARLY_BETTER: f64 = 0.05;

/// A camera that was lost is found only where at least so many of its points are registered, and a
/// keyframe is clearly seen. Look-alike rooms gave 0.6; right ones above 0.9.
const FOUND_INLIER_SHARE: f64 = 0.75;

/// A position that depth and colour hold less than this in some direction, metres of standard deviation,
/// is the motion model's: a bare wall, a corridor along its axis. Right poses are below 2.5 mm.
const MAX_UNCERTAINTY_M: f64 = 0.01;

/// Beyond this the next frame may not be held any more.
const SLIPPING_M: f64 = 0.4 * MAX_UNCERTAINTY_M;

/// What to make of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Verdict {
    /// It is wrong, or nothing speaks for it.
    Lost,
    /// It is probably right, but nothing should be built on it.
    Weak,
    /// It is right.
    Tracked,
}

/// How firmly the camera is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Hold {
    /// In some direction nothing says where it is.
    None,
    /// The next frame may not be held any more.
    Slipping,
    /// In every direction.
    Firm,
}

impl Hold {
    /// Of a position with a standard deviation, along its worst direction, metres.
    pub fn of(uncertainty_m: f64) -> Self {
        if uncertainty_m <= SLIPPING_M {
            Self::Firm
        } else if uncertainty_m <= MAX_UNCERTAINTY_M {
            Self::Slipping
        } else {
            Self::None
        }
    }
}

/// What speaks for a pose.
#[derive(Clone, Copy, Debug, Default)]
pub struct Evidence {
    /// Whether registration settled.
    pub converged: bool,
    /// Points that were registered.
    pub inliers: usize,
    /// The share of the frame's points that they are.
    pub inlier_share: f64,
    /// Root mean square of their distances along the normals, metres.
    pub residual_m: f64,
    /// Standard deviation of the position, along its worst direction, by depth, colour and a device that is
    /// believed, metres.
    pub uncertainty_m: f64,
    /// How the frame agrees with a keyframe, if there is one to compare with.
    pub agreement: Option<Agreement>,
}

impl Evidence {
    /// The verdict.
    pub fn verdict(&self, limits: &TrackingConfig) -> Verdict {
        let support = self.support();
        let needed = if support.is_some_and(|support| support >= CLEAR_SUPPORT) {
            limits.min_inlier_share.min(CLEAR_INLIER_SHARE)
        } else {
            limits.min_inlier_share
        };
        let registered = self.converged && self.inlier_share >= needed;
        match support {
            _ if !registered => Verdict::Lost,
            Some(support) if support < MIN_SUPPORT => Verdict::Lost,
            Some(support) if support < GOOD_SUPPORT => Verdict::Weak,
            _ if self.hold() == Hold::None => Verdict::Weak,
            _ => Verdict::Tracked,
        }
    }

    /// How firmly the camera is held.
    pub fn hold(&self) -> Hold {
        Hold::of(self.uncertainty_m)
    }

    /// Whether hold of the camera is about to be lost, so that what it now sees should be remembered.
    pub fn is_slipping(&self) -> bool {
        self.hold() < Hold::Firm
    }

    /// Whether it is worth looking for a better pose.
    pub fn is_doubtful(&self, limits: &TrackingConfig) -> bool {
        self.verdict(limits) < Verdict::Tracked
            || self.inlier_share < limits.min_inlier_share
            || self
                .support()
                .is_some_and(|support| support < CLEAR_SUPPORT)
    }

    /// Whether a keyframe speaks for the pose, whatever the geometry says.
    pub fn agrees(&self) -> bool {
        self.support()
            .is_some_and(|support| support >= GOOD_SUPPORT)
    }

    /// Whether a camera that was lost is believed to be found there.
    pub fn is_a_find(&self) -> bool {
        // Without colour in tracking, geometry has to do; a wall on which nothing can be compared has not.
        let is_seen =
            |seen: Agreement| seen.points >= MIN_COMPARED && seen.support() >= CLEAR_SUPPORT;
        self.inlier_share >= FOUND_INLIER_SHARE
            && !self.is_slipping()
            && self.agreement.is_none_or(is_seen)
    }

    /// Whether a keyframe clearly speaks for this pose of a frame rather than for another.
    pub fn agrees_better_than(&self, other: &Self) -> bool {
        match (self.support(), other.support()) {
            (Some(own), Some(other)) => own >= CLEAR_SUPPORT && own >= other + CLEARLY_BETTER,
            _ => false,
        }
    }

    /// Orders poses of one frame that have the same verdict.
    pub fn strength(&self) -> f64 {
        self.inlier_share * (1.0 + self.support().unwrap_or(0.0).max(0.0))
    }

    /// What a keyframe says of the pose, up to 1; `None` if too little could be compared.
    fn support(&self) -> Option<f64> {
        let seen = self.agreement.filter(|seen| seen.points >= MIN_COMPARED)?;
        Some(seen.support())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn evidence(inlier_share: f64, likeness: f64, seen_through: f64) -> Evidence {
        Evidence {
            converged: true,
            inliers: 5000,
            inlier_share,
            residual_m: 0.006,
            uncertainty_m: 0.002,
            agreement: Some(Agreement {
                points: 100,
                share: 0.6,
                likeness,
                seen_through,
            }),
        }
    }

    /// Poses of recordings with known truth: share of inliers, likeness, share seen through.
    #[test]
    fn right_poses_of_recordings_are_trusted() {
        // Fast turns, far walls with bad depth, much that is new.
        for (inliers, likeness, through) in
            [(0.78, 0.48, 0.0), (0.96, 0.95, 0.27), (0.31, 0.9, 0.0)]
        {
            let evidence = evidence(inliers, likeness, through);
            assert_eq!(
                evidence.verdict(&TrackingConfig::default()),
                Verdict::Tracked,
                "{evidence:?}"
            );
        }
        assert!(!evidence(0.9, 0.9, 0.0).is_doubtful(&TrackingConfig::default()));
    }

    #[test]
    fn wrong_poses_of_recordings_are_not_trusted_and_others_are_looked_for() {
        // Off by 14, 16, 23 and 12 cm, and a cut into another room.
        for (inliers, likeness, through) in [
            (0.81, 0.49, 0.17),
            (0.70, 0.45, 0.17),
            (0.63, 0.03, 0.17),
            (0.71, 0.15, 0.25),
            (0.38, 0.9, 0.3),
        ] {
            let evidence = evidence(inliers, likeness, through);
            assert!(
                evidence.verdict(&TrackingConfig::default()) < Verdict::Tracked,
                "{evidence:?}"
            );
            assert!(evidence.is_doubtful(&TrackingConfig::default()));
        }
    }

    #[test]
    fn few_inliers_are_enough_only_where_the_keyframe_is_clearly_seen() {
        assert_eq!(
            evidence(0.4, 0.9, 0.0).verdict(&TrackingConfig::default()),
            Verdict::Tracked
        );
        assert_eq!(
            evidence(0.4, 0.6, 0.0).verdict(&TrackingConfig::default()),
            Verdict::Lost
        );
        assert_eq!(
            evidence(0.2, 0.9, 0.0).verdict(&TrackingConfig::default()),
            Verdict::Lost
        );
        // A better pose is looked for all the same.
        assert!(evidence(0.4, 0.9, 0.0).is_doubtful(&TrackingConfig::default()));
    }

    #[test]
    fn without_a_keyframe_to_compare_with_geometry_decides() {
        let alone = |inlier_share| Evidence {
            agreement: Some(Agreement {
                points: 5,
                ..Agreement::default()
            }),
            ..evidence(inlier_share, 0.0, 0.0)
        };
        assert_eq!(
            alone(0.6).verdict(&TrackingConfig::default()),
            Verdict::Tracked
        );
        assert_eq!(
            alone(0.4).verdict(&TrackingConfig::default()),
            Verdict::Lost
        );
        let unsettled = Evidence {
            converged: false,
            ..alone(0.9)
        };
        assert_eq!(unsettled.verdict(&TrackingConfig::default()), Verdict::Lost);
    }

    #[test]
    fn another_pose_is_better_only_if_it_is_clearly_seen() {
        let better =
            |own, other| evidence(0.9, own, 0.0).agrees_better_than(&evidence(0.9, other, 0.0));
        assert!(better(0.98, 0.79));
        assert!(!better(0.98, 0.96) && !better(0.7, 0.5));
        let nothing_seen = Evidence {
            agreement: None,
            ..evidence(0.9, 0.0, 0.0)
        };
        assert!(!evidence(0.9, 0.98, 0.0).agrees_better_than(&nothing_seen));
    }

    #[test]
    fn of_two_poses_the_one_with_more_behind_it_is_stronger() {
        assert!(evidence(0.8, 0.9, 0.0).strength() > evidence(0.8, 0.6, 0.0).strength());
        assert!(evidence(0.8, 0.6, 0.0).strength() > evidence(0.6, 0.6, 0.0).strength());
    }

    #[test]
    fn what_nothing_holds_is_weak_and_a_lost_camera_is_found_on_strong_evidence_only() {
        let sliding = Evidence {
            uncertainty_m: 0.03,
            ..evidence(0.9, 0.99, 0.0)
        };
        assert_eq!(sliding.verdict(&TrackingConfig::default()), Verdict::Weak);
        assert!(evidence(1.0, 0.9, 0.0).is_a_find());
        // A room that looks alike.
        assert!(!evidence(0.6, 0.9, 0.0).is_a_find());
        // A bare wall.
        let bare = |points| Evidence {
            agreement: Some(Agreement {
                points,
                ..evidence(1.0, 0.9, 0.0).agreement.unwrap()
            }),
            ..evidence(1.0, 0.9, 0.0)
        };
        assert!(bare(50).is_a_find() && !bare(10).is_a_find());
        assert!(!sliding.is_a_find());
        assert!(!evidence(0.9, 0.58, 0.0).is_a_find());
    }
}
