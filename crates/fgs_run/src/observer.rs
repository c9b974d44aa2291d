//! What the outside sees of a run while it works: progress bars, logs and viewers implement
//! [`RunObserver`].

use fgs_slam::Slam;
use fgs_splat::Gaussians;

use crate::frame_log::FrameRow;

/// Something that happened.
#[derive(Debug)]
#[non_exhaustive]
pub enum RunEvent<'a> {
    /// A frame was tracked, lost, dropped or found damaged.
    Frame {
        /// Its row in `frames.csv`, without scores.
        row: &'a FrameRow,
        /// Why it is damaged, if it is.
        error: Option<&'a str>,
        /// Gaussians in the map, as far as known.
        num_gaussians: usize,
        /// Optimisation steps so far, as far as known.
        steps: usize,
    },
    /// The map was refined by one more step, after the last frame.
    Refined {
        /// Steps done so far.
        done: usize,
        /// Steps in all.
        total: usize,
    },
    /// The map is finished, refined if that was asked for; nothing is saved yet.
    Mapped {
        /// The map.
        map: &'a Gaussians,
    },
    /// Frames were rendered and scored.
    Scored {
        /// Frames done so far.
        done: usize,
        /// Frames in all.
        total: usize,
    },
}

/// Sees every event, in order. While frames are tracked and the map is refined it is called on another
/// thread than the one that tracks: a slow observer does not slow the run.
pub trait RunObserver {
    /// Called once, before the first frame. Whoever wants to see more than [`RunEvent`]s subscribes to the
    /// session's own.
    fn begin(&mut self, _session: &Slam) {}

    /// Called for each event.
    fn on(&mut self, event: &RunEvent<'_>);
}

/// An observer that does nothing.
impl RunObserver for () {
    fn on(&mut self, _: &RunEvent<'_>) {}
}
