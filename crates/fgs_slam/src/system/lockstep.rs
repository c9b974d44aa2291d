//! Tracker and mapper in strict turns on one thread; inside a turn all threads compute. The same
//! input gives the same bits.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use crossbeam_channel::never;
use fgs_splat::Gaussians;

use super::mapping::{MapperGone, Mapping, Moves};
use super::worker::{MapperWorker, MappingOutput, SavedMapping};
use crate::keyframes::{FrameWork, Keyframe};
use crate::seam::Seam;

/// The mapper, whose turn comes after each frame.
pub struct Lockstep {
    worker: MapperWorker,
}

impl Lockstep {
    pub fn new(mut worker: MapperWorker) -> Self {
        let owed = worker.take_owed_steps();
        if owed > 0 {
            worker.turn(|worker| worker.steps(owed));
        }
        Self { worker }
    }
}

impl Mapping for Lockstep {
    fn accepts_keyframe(&self) -> bool {
        true
    }

    fn after_frame(&mut self, work: Option<FrameWork>) -> Result<(), MapperGone> {
        let steps = self.worker.steps_of_next_frame();
        let alive = self.worker.turn(|worker| {
            if let Some(work) = work {
                worker.take(work)?;
                worker.settle()?;
            }
            worker.steps(steps)
        });
        alive.then_some(()).ok_or(MapperGone)
    }

    fn move_keyframes(&mut self, moves: &Moves) -> Result<(), MapperGone> {
        let alive = self.worker.turn(|worker| worker.move_keyframes(moves));
        alive.then_some(()).ok_or(MapperGone)
    }

    fn mend(&mut self, seam: Seam) -> Result<(), MapperGone> {
        let alive = self.worker.turn(|worker| worker.mend(&seam));
        alive.then_some(()).ok_or(MapperGone)
    }

    fn snapshot(&mut self) -> Result<Gaussians, MapperGone> {
        let mut gaussians = None;
        self.worker.turn(|worker| {
            gaussians = Some(worker.gaussians()?);
            Ok(())
        });
        gaussians.ok_or(MapperGone)
    }

    fn save(&mut self) -> Result<SavedMapping, MapperGone> {
        let mut saved = None;
        // No turn: what the mapper has to report, it reports after its next, as if nothing had been.
        self.worker.attempt(|worker| {
            saved = Some(worker.save()?);
            Ok(())
        });
        saved.ok_or(MapperGone)
    }

    fn wait_until(&self, time: Instant) -> Result<(), MapperGone> {
        // Times out: on this channel nothing ever comes.
        let _ = never::<()>().recv_deadline(time);
        (!self.worker.has_failed()).then_some(()).ok_or(MapperGone)
    }

    fn finish(
        mut self: Box<Self>,
        closing: Option<Keyframe>,
        refine_steps: usize,
        stop: &AtomicBool,
    ) -> MappingOutput {
        self.worker.close(closing);
        self.worker.finish(refine_steps, stop)
    }
}
