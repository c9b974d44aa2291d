//! Which frames become keyframes (paper, Sec. III-C).
//!
//! A tracking keyframe shows much that the sparse map lacks: it extends both maps. A mapping
//! keyframe, every so many frames after it, only improves the dense map.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use fgs_geom::{KeyframeId, RgbdFrame, Se3, View};
use fgs_splat::SparseId;
use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};

use crate::config::KeyframeConfig;
use crate::map_alignment::FrameToAlign;

/// What a keyframe is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum KeyframeKind {
    /// Extends the sparse and the dense map.
    Tracking,
    /// Only for the dense map.
    Mapping,
}

impl fmt::Display for KeyframeKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Tracking => "tracking",
            Self::Mapping => "mapping",
        })
    }
}

/// All that the mapper needs of a frame, in one message.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// Its name.
    pub id: KeyframeId,
    /// What it is for.
    pub kind: KeyframeKind,
    /// Its images.
    pub frame: Arc<RgbdFrame>,
    /// Where it was taken.
    pub world_from_camera: Se3,
    /// The keyframe that it was tracked from, in whose sub-map it is; `None` if it starts one.
    pub previous: Option<KeyframeId>,
    /// How sure that is: inverse covariance of the pose, tangent `[omega, v]` in the camera's axes
    /// (rad, metres), [6, 6]. `None` where nothing was registered, as for the first keyframe.
    pub information: Option<Matrix6<f64>>,
    /// The pixels that join the sparse map, with the names of their gaussians.
    pub new_points: Vec<NewPoint>,
}

impl Keyframe {
    /// Its camera and pose.
    pub fn view(&self) -> View {
        View {
            camera: self.frame.camera,
            world_from_camera: self.world_from_camera,
        }
    }
}

/// How keyframes moved, each by its `new_world_from_old_world`.
#[derive(Default)]
pub struct Motions(BTreeMap<KeyframeId, Se3>);

impl Motions {
    /// Of moves one after the other.
    pub fn new(moves: &[(KeyframeId, Se3)]) -> Self {
        let mut motions = Self::default();
        for (id, new_from_old) in moves {
            let so_far = motions.0.entry(*id);
            so_far
                .and_modify(|so_far| *so_far = *new_from_old * *so_far)
                .or_insert(*new_from_old);
        }
        motions
    }

    /// That of a keyframe; `None` if it did not move.
    pub fn of(&self, id: KeyframeId) -> Option<&Se3> {
        self.0.get(&id)
    }

    /// Moves a keyframe's pose.
    pub fn apply(&self, id: KeyframeId, world_from_camera: &mut Se3) {
        if let Some(new_from_old) = self.of(id) {
            *world_from_camera = *new_from_old * *world_from_camera;
        }
    }
}

/// What a tracked frame gives the mapper to do.
pub enum FrameWork {
    /// It joins the map.
    Keyframe(Box<Keyframe>),
    /// It is aligned with the map.
    Align(Box<FrameToAlign>),
}

/// A pixel of a tracking keyframe that joins the sparse map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NewPoint {
    /// Column.
    pub u: usize,
    /// Row.
    pub v: usize,
    /// The name of its gaussian.
    pub id: SparseId,
}

/// Whether a frame may become a keyframe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admission {
    /// It may.
    Allowed,
    /// Not now: the mapper has no room.
    PutOff,
    /// Never: it is to judge the map by.
    HeldOut,
}

/// Where little holds the camera, a keyframe comes at least so many frames after another.
const FRAMES_BETWEEN_HOLDS: usize = 3;

/// Decides frame by frame.
pub struct KeyframePolicy {
    min_overlap_share: f64,
    mapping_every: usize,
    /// `None` before the first keyframe.
    frames_since_keyframe: Option<usize>,
}

impl KeyframePolicy {
    /// Before the first frame: without `frames_since_keyframe`.
    pub fn new(config: &KeyframeConfig, frames_since_keyframe: Option<usize>) -> Self {
        Self {
            min_overlap_share: config.min_overlap_share,
            mapping_every: config.mapping_every,
            frames_since_keyframe,
        }
    }

    /// Frames since the last keyframe; `None` before the first.
    pub fn frames_since_keyframe(&self) -> Option<usize> {
        self.frames_since_keyframe
    }

    /// What the next tracked frame becomes, given the share of its points that overlap the sparse
    /// map, whether the camera hardly sees any more what the newest keyframe shows, and whether what it
    /// sees hardly holds it. The first frame is always a tracking keyframe. One that is not `allowed` is put
    /// off to the next frame.
    pub fn decide(
        &mut self,
        overlap_share: f64,
        has_left_newest: bool,
        is_slipping: bool,
        allowed: bool,
    ) -> Option<KeyframeKind> {
        let kind = match &mut self.frames_since_keyframe {
            None => Some(KeyframeKind::Tracking),
            Some(frames) => {
                *frames += 1;
                let must_hold = is_slipping && *frames >= FRAMES_BETWEEN_HOLDS;
                if overlap_share < self.min_overlap_share || must_hold {
                    Some(KeyframeKind::Tracking)
                } else {
                    (has_left_newest || *frames >= self.mapping_every)
                        .then_some(KeyframeKind::Mapping)
                }
            }
        };
        let kind = kind.filter(|_| allowed)?;
        self.frames_since_keyframe = Some(0);
        Some(kind)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use KeyframeKind::{Mapping, Tracking};

    /// The keyframes among forty frames of which frames 13 and 14 overlap too little.
    fn keyframes(allowed: fn(usize) -> bool) -> Vec<(usize, KeyframeKind)> {
        keyframes_of(|_| false, allowed)
    }

    fn keyframes_of(
        has_left: fn(usize) -> bool,
        allowed: fn(usize) -> bool,
    ) -> Vec<(usize, KeyframeKind)> {
        let mut policy = KeyframePolicy::new(&KeyframeConfig::default(), None);
        let overlap = |i: usize| if i == 13 || i == 14 { 0.79 } else { 0.8 };
        (0..40)
            .filter_map(|i| {
                let kind = policy.decide(overlap(i), has_left(i), false, allowed(i));
                Some((i, kind?))
            })
            .collect()
    }

    #[test]
    fn what_little_holds_is_remembered_but_not_with_every_frame() {
        let mut policy = KeyframePolicy::new(&KeyframeConfig::default(), None);
        let decide = |i: usize| Some((i, policy.decide(1.0, false, (5..9).contains(&i), true)?));
        let keyframes: Vec<_> = (0..12).filter_map(decide).collect();
        assert_eq!(keyframes, [(0, Tracking), (5, Tracking), (8, Tracking)]);
    }

    #[test]
    fn tracking_at_low_overlap_and_mapping_every_tenth_after_it() {
        assert_eq!(
            keyframes(|_| true),
            [
                (0, Tracking),
                (10, Mapping),
                (13, Tracking),
                (14, Tracking),
                (24, Mapping),
                (34, Mapping)
            ]
        );
    }

    #[test]
    fn a_mapping_keyframe_when_the_newest_is_left_behind() {
        let keyframes = keyframes_of(|i| i == 4 || i == 13, |_| true);
        assert_eq!(keyframes[1], (4, Mapping));
        assert_eq!(keyframes[2], (13, Tracking));
    }

    #[test]
    fn what_is_not_allowed_is_put_off() {
        assert_eq!(
            keyframes(|i| ![0, 11, 12, 13, 24].contains(&i)),
            [(1, Tracking), (14, Tracking), (25, Mapping), (35, Mapping)]
        );
    }
}
