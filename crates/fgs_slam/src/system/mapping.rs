//! How the mapper gets its turns: what a session asks of each way to run it.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use fgs_geom::{KeyframeId, Se3};
use fgs_splat::Gaussians;

use super::worker::{MappingOutput, SavedMapping};
use crate::keyframes::{FrameWork, Keyframe};
use crate::seam::Seam;

/// The mapper cannot go on; [`Mapping::finish`] says why.
pub struct MapperGone;

/// Rigid motions of keyframes, each `new_world_from_old_world`.
pub type Moves = Arc<[(KeyframeId, Se3)]>;

/// A mapper at work.
pub trait Mapping: Send {
    /// Whether a keyframe can be handed over without the tracker having to wait for the mapper.
    fn accepts_keyframe(&self) -> bool;

    /// A frame came, and may have something for the mapper to do. Frames are aligned with the map only
    /// where the mapper has a turn after each.
    fn after_frame(&mut self, work: Option<FrameWork>) -> Result<(), MapperGone>;

    /// Keyframes have moved, and the map must move with them.
    fn move_keyframes(&mut self, moves: &Moves) -> Result<(), MapperGone>;

    /// The map was closed by the motions before: what both sides of a seam show is thinned out.
    fn mend(&mut self, seam: Seam) -> Result<(), MapperGone>;

    /// A copy of the map with every keyframe handed over so far.
    fn snapshot(&mut self) -> Result<Gaussians, MapperGone>;

    /// All that the mapper's next turn depends on, once it has done what it was given.
    fn save(&mut self) -> Result<SavedMapping, MapperGone>;

    /// Waits until a time, or until the mapper is gone.
    fn wait_until(&self, time: Instant) -> Result<(), MapperGone>;

    /// Ends mapping; the closing keyframe, if any, still joins the map. Then a copy of the map is
    /// refined by up to `refine_steps`, until `stop` is set.
    fn finish(
        self: Box<Self>,
        closing: Option<Keyframe>,
        refine_steps: usize,
        stop: &AtomicBool,
    ) -> MappingOutput;
}
