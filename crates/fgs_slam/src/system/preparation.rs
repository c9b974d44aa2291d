//! Where keyframes are prepared: in turn with the mapper, or on a thread of its own, so that
//! segmentation and seeding do not hold up the optimisation.
//!
//! At most one keyframe is under way. The region that the next one lacks is only known once this
//! one's gaussians are in the map.

use std::io;
use std::thread::Builder;

use crossbeam_channel::{Receiver, Sender, bounded};
use fgs_geom::Image;
use fgs_splat::LossError;

use crate::keyframes::Keyframe;
use crate::mapper::MapperError;
use crate::prepare::{KeyframePreparer, PreparedKeyframe};

type Job = (Keyframe, Image<bool>);
type Prepared = Result<PreparedKeyframe, LossError>;

/// Prepares one keyframe at a time.
pub enum Preparation {
    /// At once, on the thread that asks.
    InTurn {
        preparer: Box<KeyframePreparer>,
        ready: Option<Box<PreparedKeyframe>>,
    },
    /// On a thread that lives as long as this.
    OnThread {
        jobs: Sender<Job>,
        answers: Receiver<Prepared>,
        busy: bool,
    },
}

impl Preparation {
    pub fn in_turn(preparer: KeyframePreparer) -> Self {
        Self::InTurn {
            preparer: Box::new(preparer),
            ready: None,
        }
    }

    /// # Errors
    /// If the thread does not start.
    pub fn on_thread(mut preparer: KeyframePreparer) -> io::Result<Self> {
        let (jobs, queue) = bounded::<Job>(1);
        let (to_mapper, answers) = bounded(1);
        Builder::new().name("preparer".into()).spawn(move || {
            for (keyframe, missing) in queue {
                if to_mapper.send(preparer.prepare(keyframe, missing)).is_err() {
                    break;
                }
            }
        })?;
        Ok(Self::OnThread {
            jobs,
            answers,
            busy: false,
        })
    }

    /// Starts on a keyframe. The one before it must have been taken.
    pub fn begin(&mut self, keyframe: Keyframe, missing: Image<bool>) -> Result<(), MapperError> {
        match self {
            Self::InTurn { preparer, ready } => {
                *ready = Some(Box::new(preparer.prepare(keyframe, missing)?));
            }
            Self::OnThread { jobs, busy, .. } => {
                jobs.send((keyframe, missing)).map_err(|_| gone())?;
                *busy = true;
            }
        }
        Ok(())
    }

    /// Whether a keyframe is under way or waits to be taken.
    pub fn is_busy(&self) -> bool {
        match self {
            Self::InTurn { ready, .. } => ready.is_some(),
            Self::OnThread { busy, .. } => *busy,
        }
    }

    /// The keyframe that is ready, if any.
    pub fn poll(&mut self) -> Result<Option<PreparedKeyframe>, MapperError> {
        match self {
            Self::OnThread { answers, busy, .. } if *busy && answers.is_empty() => Ok(None),
            _ => self.wait(),
        }
    }

    /// The keyframe under way, once it is ready; `None` if there is none.
    pub fn wait(&mut self) -> Result<Option<PreparedKeyframe>, MapperError> {
        match self {
            Self::InTurn { ready, .. } => Ok(ready.take().map(|ready| *ready)),
            Self::OnThread { answers, busy, .. } => {
                if !std::mem::take(busy) {
                    return Ok(None);
                }
                let prepared = answers.recv().map_err(|_| gone())?;
                Ok(Some(prepared?))
            }
        }
    }
}

fn gone() -> MapperError {
    MapperError::Panicked("the thread that prepares keyframes died".into())
}
