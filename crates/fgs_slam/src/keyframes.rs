//! Which frames become keyframes (paper, Sec. III-C).
//!
//! A tracking keyframe shows much that the sparse map lacks: it extends both maps. A mapping
//! keyframe, every so many frames after it, only improves the dense map.

use std::fmt;
use std::sync::Arc;

use fgs_geom::{RgbdFrame, Se3};
use fgs_splat::SparseId;
use serde::{Deserialize, Serialize};

use crate::config::KeyframeConfig;

/// What a keyframe is for. As text: the variant's name in lower case.
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
        self.serialize(f)
    }
}

/// All that the mapper needs of a frame, in one message.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// What it is for.
    pub kind: KeyframeKind,
    /// Its images.
    pub frame: Arc<RgbdFrame>,
    /// Where it was taken.
    pub world_from_camera: Se3,
    /// The pixels that join the sparse map, with the names of their gaussians.
    pub new_points: Vec<NewPoint>,
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

/// Decides frame by frame.
pub struct KeyframePolicy {
    min_overlap_share: f64,
    mapping_every: usize,
    frames_since_tracking_keyframe: usize,
    any: bool,
}

impl KeyframePolicy {
    /// Before the first frame.
    pub fn new(config: &KeyframeConfig) -> Self {
        Self {
            min_overlap_share: config.min_overlap_share,
            mapping_every: config.mapping_every,
            frames_since_tracking_keyframe: 0,
            any: false,
        }
    }

    /// What the next tracked frame becomes, given the share of its points that overlap the sparse
    /// map. The first frame is always a tracking keyframe.
    pub fn decide(&mut self, overlap_share: f64) -> Option<KeyframeKind> {
        self.frames_since_tracking_keyframe += 1;
        if !self.any || overlap_share < self.min_overlap_share {
            self.any = true;
            self.frames_since_tracking_keyframe = 0;
            return Some(KeyframeKind::Tracking);
        }
        self.frames_since_tracking_keyframe
            .is_multiple_of(self.mapping_every)
            .then_some(KeyframeKind::Mapping)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracking_at_low_overlap_and_mapping_every_tenth_after_it() {
        let mut policy = KeyframePolicy::new(&KeyframeConfig::default());
        let overlaps = |i: usize| if i == 13 || i == 14 { 0.79 } else { 0.8 };
        let decisions: Vec<_> = (0..40)
            .filter_map(|i| policy.decide(overlaps(i)).map(|kind| (i, kind)))
            .collect();
        use KeyframeKind::{Mapping, Tracking};
        assert_eq!(
            decisions,
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
}
