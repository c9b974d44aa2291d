//! What the outside may see of a run while it runs: progress bars and viewers implement
//! [`Observer`].

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::keyframes::KeyframeKind;
use crate::tracker::Tracked;

/// What became of a frame. As text: the variant's name in lower case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FrameStatus {
    /// It has a pose.
    Tracked,
    /// It was read, but registration gave no pose that can be trusted.
    Lost,
    /// It could not be read.
    Damaged,
    /// It arrived too late in real time and was skipped.
    Dropped,
}

impl fmt::Display for FrameStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Something that happened.
#[derive(Debug)]
pub enum SlamEvent<'a> {
    /// A frame was tracked or lost.
    Frame {
        /// The result.
        tracked: &'a Tracked,
        /// What the frame became.
        keyframe: Option<KeyframeKind>,
        /// Gaussians in the map, as far as known.
        num_gaussians: usize,
        /// Optimisation steps so far, as far as known.
        steps: usize,
    },
    /// A frame could not be read and was skipped.
    Damaged {
        /// Why.
        error: &'a (dyn std::error::Error + 'static),
    },
    /// A frame came too late in real time and was dropped.
    Dropped,
}

/// Sees every event, on the thread that tracks.
pub trait Observer {
    /// Called for each event in its order.
    fn on(&mut self, event: &SlamEvent<'_>);
}

/// An observer that does nothing.
impl Observer for () {
    fn on(&mut self, _: &SlamEvent<'_>) {}
}
