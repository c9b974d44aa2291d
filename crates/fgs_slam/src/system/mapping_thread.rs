//! The mapper on a thread of its own. What it does with its time is given by the mode; messages
//! come to it over a bounded channel, and a channel whose other end is gone ends every wait.

use std::convert::Infallible;
use std::io;
use std::sync::atomic::AtomicBool;
use std::thread::{Builder, JoinHandle};
use std::time::Instant;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use fgs_splat::Gaussians;

use super::mapping::{MapperGone, Mapping, Moves};
use super::worker::{MapperWorker, MappingOutput, SavedMapping};
use crate::keyframes::{FrameWork, Keyframe};
use crate::seam::Seam;

/// What the tracking side tells the mapper.
pub enum Message {
    /// A frame came.
    Frame(Option<FrameWork>),
    /// Keyframes have moved.
    Move(Moves),
    /// They closed the map.
    Mend(Seam),
    /// A copy of the map is wanted.
    Snapshot(Sender<Gaussians>),
    /// All that the next turns depend on is wanted.
    Save(Sender<Box<SavedMapping>>),
}

/// A mapper on its thread.
pub struct MappingThread {
    messages: Sender<Message>,
    /// Disconnected when the mapper has ended.
    alive: Receiver<Infallible>,
    thread: JoinHandle<MapperWorker>,
    policy: Policy,
}

/// Which messages the mapper gets, and whether the tracker waits for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    /// One for every frame; the tracker waits when the queue is full.
    EveryFrame,
    /// Only keyframes, and only while the queue has room.
    KeyframesWhileRoom,
}

impl MappingThread {
    /// Lets `optimize` work off the messages, of which up to `capacity` may wait, until they end or
    /// the mapper fails.
    ///
    /// # Errors
    /// If the thread does not start.
    pub fn start(
        mut worker: MapperWorker,
        policy: Policy,
        capacity: usize,
        optimize: impl FnOnce(&mut MapperWorker, &Receiver<Message>) + Send + 'static,
    ) -> io::Result<Self> {
        let (messages, queue) = bounded(capacity);
        let (lives, alive) = bounded(0);
        let thread = Builder::new().name("mapper".into()).spawn(move || {
            optimize(&mut worker, &queue);
            drop(lives);
            worker
        })?;
        Ok(Self {
            messages,
            alive,
            thread,
            policy,
        })
    }

    fn send(&self, message: Message) -> Result<(), MapperGone> {
        self.messages.send(message).map_err(|_| MapperGone)
    }
}

/// Does what a message asks for, apart from optimisation; `false` if the mapper is gone.
pub fn obey(worker: &mut MapperWorker, message: Message) -> bool {
    worker.turn(|worker| match message {
        Message::Frame(Some(work)) => worker.take(work),
        Message::Frame(None) => Ok(()),
        Message::Move(moves) => worker.move_keyframes(&moves),
        Message::Mend(seam) => worker.mend(&seam),
        Message::Snapshot(answer) => {
            worker.settle()?;
            // Whoever asked may have given up.
            let _ = answer.send(worker.gaussians()?);
            Ok(())
        }
        Message::Save(answer) => {
            let _ = answer.send(Box::new(worker.save()?));
            Ok(())
        }
    })
}

impl Mapping for MappingThread {
    fn accepts_keyframe(&self) -> bool {
        self.policy == Policy::EveryFrame || !self.messages.is_full()
    }

    fn after_frame(&mut self, work: Option<FrameWork>) -> Result<(), MapperGone> {
        let is_keyframe = matches!(work, Some(FrameWork::Keyframe(_)));
        if !is_keyframe && self.policy == Policy::KeyframesWhileRoom {
            return self.wait_until(Instant::now());
        }
        self.send(Message::Frame(work))
    }

    fn move_keyframes(&mut self, moves: &Moves) -> Result<(), MapperGone> {
        self.send(Message::Move(Moves::clone(moves)))
    }

    fn mend(&mut self, seam: Seam) -> Result<(), MapperGone> {
        self.send(Message::Mend(seam))
    }

    fn snapshot(&mut self) -> Result<Gaussians, MapperGone> {
        let (answer, gaussians) = bounded(1);
        self.send(Message::Snapshot(answer))?;
        gaussians.recv().map_err(|_| MapperGone)
    }

    fn save(&mut self) -> Result<SavedMapping, MapperGone> {
        let (answer, saved) = bounded(1);
        self.send(Message::Save(answer))?;
        saved.recv().map(|saved| *saved).map_err(|_| MapperGone)
    }

    fn wait_until(&self, time: Instant) -> Result<(), MapperGone> {
        match self.alive.recv_deadline(time) {
            Ok(never) => match never {},
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => Err(MapperGone),
        }
    }

    fn finish(
        self: Box<Self>,
        closing: Option<Keyframe>,
        refine_steps: usize,
        stop: &AtomicBool,
    ) -> MappingOutput {
        drop(self.messages);
        match self.thread.join() {
            Ok(mut worker) => {
                worker.close(closing);
                worker.finish(refine_steps, stop)
            }
            Err(panic) => MappingOutput::panicked(&*panic),
        }
    }
}
