//! What became of a frame.

use std::fmt;
use std::time::Duration;

use fgs_direct::Agreement;
use fgs_geom::{FrameIndex, KeyframeId, Se3};
use serde::{Deserialize, Serialize};

use crate::keyframes::KeyframeKind;
use crate::verdict::Evidence;

/// The verdict on a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum FrameStatus {
    /// It has a pose that can be trusted.
    Tracked,
    /// It has a pose that is probably right; nothing is built on it.
    Weak,
    /// It was read but has no pose that can be trusted.
    Lost,
    /// It could not be read, or is no frame of this camera.
    Damaged,
    /// It came too late in real time.
    Dropped,
}

impl fmt::Display for FrameStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Tracked => "tracked",
            Self::Weak => "weak",
            Self::Lost => "lost",
            Self::Damaged => "damaged",
            Self::Dropped => "dropped",
        })
    }
}

/// The result of one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct FrameResult {
    /// Which frame.
    pub index: FrameIndex,
    /// Its time, seconds on the recording's clock; `None` if it was never read.
    pub timestamp_secs: Option<f64>,
    /// The verdict.
    pub status: FrameStatus,
    /// Its pose if it was tracked, or is weak.
    pub world_from_camera: Option<Se3>,
    /// The sub-map that this pose is in. While the session goes on, sub-maps are numbered as they began.
    pub submap: Option<usize>,
    /// The keyframe that it became, if any.
    pub keyframe: Option<(KeyframeId, KeyframeKind)>,
    /// How it was tracked; `None` if it was not even tried.
    pub tracking: Option<TrackingQuality>,
}

/// How well a frame could be registered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TrackingQuality {
    /// How many of its points have a surface and were to be registered.
    pub points: usize,
    /// The share of the image that was left out because it moves.
    pub moving_share: f64,
    /// How many points the sparse map had then.
    pub sparse_points: usize,
    /// How many of its points correspond to the sparse map.
    pub inliers: usize,
    /// Root mean square distance of those along the surface normal, metres.
    pub residual_m: f64,
    /// How well the weakest direction is constrained relative to the strongest, 0 to 1.
    pub conditioning: f64,
    /// Standard deviation of the position along its worst direction, by depth and colour alone, metres.
    /// `None` if nothing was registered, as in the first frame, or the session was saved since.
    #[serde(skip)]
    pub uncertainty_m: Option<f64>,
    /// How the frame agrees with a keyframe in brightness and depth; `None` before the second frame and
    /// without colour in tracking.
    pub agreement: Option<Agreement>,
    /// Wall time of tracking.
    pub duration: Duration,
}

impl TrackingQuality {
    /// Takes over what speaks for a pose.
    pub(crate) fn take_over(&mut self, evidence: &Evidence) {
        self.inliers = evidence.inliers;
        self.residual_m = evidence.residual_m;
        self.conditioning = evidence.conditioning;
        self.uncertainty_m = (evidence.inliers > 0).then_some(evidence.uncertainty_m);
        self.agreement = evidence.agreement;
    }
}

impl FrameResult {
    /// A frame that was not tracked, and why.
    pub(crate) fn untracked(index: FrameIndex, status: FrameStatus) -> Self {
        Self {
            index,
            timestamp_secs: None,
            status,
            world_from_camera: None,
            submap: None,
            keyframe: None,
            tracking: None,
        }
    }
}
