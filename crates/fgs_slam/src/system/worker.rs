//! The mapping side of a session: the mapper with what it works off, whose turn it may be on any
//! thread, and what it tells the tracking side.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use fgs_geom::{FrameIndex, KeyframeId, Se3};
use fgs_splat::{Gaussians, SparseId};

use super::preparation::Preparation;
use crate::event::{EventHub, SlamEvent};
use crate::keyframes::{FrameWork, Keyframe};
use crate::mapper::{Mapper, MapperError};
use crate::refinement::RefinedMap;

/// What the mapper tells the tracking side. Bounded by the size of the map.
#[derive(Default)]
pub struct MapStatus {
    is_stopped: AtomicBool,
    num_gaussians: AtomicUsize,
    steps: AtomicUsize,
    removed: Mutex<Vec<SparseId>>,
    moved: Mutex<Vec<(KeyframeId, Se3)>>,
    aligned: Mutex<Vec<(FrameIndex, Se3)>>,
}

impl MapStatus {
    /// No optimisation step is taken from now on.
    pub fn stop_optimizing(&self) {
        self.is_stopped.store(true, Ordering::Relaxed);
    }

    /// Gaussians in the map.
    pub fn num_gaussians(&self) -> usize {
        self.num_gaussians.load(Ordering::Relaxed)
    }

    /// Optimisation steps so far.
    pub fn steps(&self) -> usize {
        self.steps.load(Ordering::Relaxed)
    }

    /// Sparse gaussians pruned since the last call.
    pub fn take_removed(&self) -> Vec<SparseId> {
        std::mem::take(&mut lock(&self.removed))
    }

    /// How keyframes moved when they joined the map, each by its `new_world_from_old_world`.
    pub fn take_moved(&self) -> Vec<(KeyframeId, Se3)> {
        std::mem::take(&mut lock(&self.moved))
    }

    /// How frames between keyframes moved when they were aligned with the map, each in its camera's
    /// axes, `old_from_new`.
    pub fn take_aligned(&self) -> Vec<(FrameIndex, Se3)> {
        std::mem::take(&mut lock(&self.aligned))
    }
}

/// What the mapper reports is whole at every moment, also if its thread died holding the lock.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The mapper and what it works off.
pub struct MapperWorker {
    mapper: Mapper,
    preparation: Preparation,
    status: Arc<MapStatus>,
    events: EventHub,
    busy: Duration,
    /// Why the mapper cannot go on.
    failure: Option<MapperError>,
}

/// What is left when mapping has ended.
pub struct MappingOutput {
    /// The map when the recording had ended.
    pub gaussians: Gaussians,
    /// The map after refinement, if there was any.
    pub refined: Option<RefinedMap>,
    pub device_bytes: u64,
    pub steps: usize,
    pub busy: Duration,
    pub failure: Option<MapperError>,
}

impl MappingOutput {
    /// What is left of a mapper whose thread died.
    pub fn panicked(panic: &(dyn Any + Send)) -> Self {
        Self {
            gaussians: Gaussians::default(),
            refined: None,
            device_bytes: 0,
            steps: 0,
            busy: Duration::ZERO,
            failure: Some(MapperError::Panicked(panic_message(panic))),
        }
    }
}

impl MapperWorker {
    pub fn new(
        mapper: Mapper,
        preparation: Preparation,
        status: Arc<MapStatus>,
        events: EventHub,
    ) -> Self {
        Self {
            mapper,
            preparation,
            status,
            events,
            busy: Duration::ZERO,
            failure: None,
        }
    }

    /// Lets the mapper work and reports what became of the map. `false` once the mapper cannot go
    /// on: it has failed or panicked, now or before.
    pub fn turn(&mut self, work: impl FnOnce(&mut Self) -> Result<(), MapperError>) -> bool {
        if self.failure.is_some() {
            return false;
        }
        let start = Instant::now();
        let work = AssertUnwindSafe(|| work(self).and_then(|()| self.report()));
        let done = catch_unwind(work)
            .unwrap_or_else(|panic| Err(MapperError::Panicked(panic_message(&*panic))));
        self.busy += start.elapsed();
        self.failure = done.err();
        self.failure.is_none()
    }

    /// Takes on what a frame gives to do.
    pub fn take(&mut self, work: FrameWork) -> Result<(), MapperError> {
        match work {
            FrameWork::Keyframe(keyframe) => self.begin(*keyframe),
            FrameWork::Align(frame) => {
                if let Some(motion) = self.mapper.align_frame(&frame)? {
                    lock(&self.status.aligned).push((frame.index, motion));
                }
                Ok(())
            }
        }
    }

    /// Starts on a keyframe, after the one before it has joined the map.
    pub fn begin(&mut self, mut keyframe: Keyframe) -> Result<(), MapperError> {
        self.settle()?;
        if let Some(motion) = self.mapper.align(&mut keyframe)? {
            lock(&self.status.moved).push((keyframe.id, motion));
        }
        let missing = self.mapper.missing_region(&keyframe)?;
        self.preparation.begin(keyframe, missing)
    }

    /// Whether a keyframe is being prepared.
    pub fn is_preparing(&self) -> bool {
        self.preparation.is_busy()
    }

    /// Waits for the keyframe that is being prepared, if any, and lets it join the map.
    pub fn settle(&mut self) -> Result<(), MapperError> {
        match self.preparation.wait()? {
            Some(prepared) => self.mapper.insert(prepared),
            None => Ok(()),
        }
    }

    /// One optimisation step; before it, a keyframe that is ready joins the map. The first keyframe
    /// is waited for: without it there is nothing to optimise.
    pub fn step(&mut self) -> Result<(), MapperError> {
        if !self.mapper.has_views() {
            self.settle()?;
        } else if let Some(prepared) = self.preparation.poll()? {
            self.mapper.insert(prepared)?;
        }
        self.mapper.step()
    }

    /// So many optimisation steps, as long as they are wanted: see [`MapStatus::stop_optimizing`].
    pub fn steps(&mut self, steps: usize) -> Result<(), MapperError> {
        for _ in 0..steps {
            if self.status.is_stopped.load(Ordering::Relaxed) {
                break;
            }
            self.step()?;
        }
        Ok(())
    }

    /// Whether there is a keyframe to optimise.
    pub fn has_views(&self) -> bool {
        self.mapper.has_views()
    }

    /// Moves the map with its keyframes.
    pub fn move_keyframes(&mut self, moves: &[(KeyframeId, Se3)]) -> Result<(), MapperError> {
        self.settle()?;
        self.mapper.move_keyframes(moves)
    }

    /// A copy of the map.
    pub fn gaussians(&mut self) -> Result<Gaussians, MapperError> {
        self.mapper.gaussians()
    }

    /// The closing keyframe joins the map. It costs no optimisation step: those are spent.
    pub fn close(&mut self, closing: Option<Keyframe>) {
        self.turn(|worker| {
            worker.settle()?;
            if let Some(keyframe) = closing {
                worker.begin(keyframe)?;
                worker.settle()?;
            }
            Ok(())
        });
    }

    /// Ends mapping, and refines a copy of the map by up to `refine_steps`, until `stop` is set. After a
    /// failure the map is what is known of it, after a panic perhaps nothing.
    pub fn finish(mut self, refine_steps: usize, stop: &AtomicBool) -> MappingOutput {
        let mut recorded = None;
        if refine_steps > 0 && self.has_views() {
            self.turn(|worker| {
                recorded = Some(worker.gaussians()?);
                Ok(())
            });
        }
        let (device_bytes, steps, busy) =
            (self.mapper.device_bytes(), self.mapper.steps(), self.busy);
        let start = Instant::now();
        if recorded.is_some() {
            self.refine(refine_steps, stop);
        }
        let refined_steps = self.mapper.steps() - steps;
        let mapper = self.mapper;
        let gaussians =
            catch_unwind(AssertUnwindSafe(|| mapper.into_gaussians())).unwrap_or_default();
        let (gaussians, refined) = match recorded {
            Some(recorded) if refined_steps > 0 => (
                recorded,
                Some(RefinedMap {
                    gaussians,
                    steps: refined_steps,
                    duration: start.elapsed(),
                }),
            ),
            _ => (gaussians, None),
        };
        MappingOutput {
            gaussians,
            refined,
            device_bytes,
            steps,
            busy,
            failure: self.failure,
        }
    }

    /// Optimises the map with all keyframes alike, until so many steps are taken, `stop` is set or the
    /// mapper cannot go on.
    fn refine(&mut self, steps: usize, stop: &AtomicBool) {
        let mut rounds = None;
        self.turn(|worker| {
            rounds = Some(worker.mapper.begin_refinement()?);
            Ok(())
        });
        let Some(mut rounds) = rounds else { return };
        for done in 1..=steps {
            if stop.load(Ordering::Relaxed)
                || !self.turn(|worker| worker.mapper.refine(&mut rounds))
            {
                return;
            }
            self.events.publish(|| SlamEvent::Refined { done, steps });
        }
    }

    fn report(&mut self) -> Result<(), MapperError> {
        let mut removed = self.mapper.take_removed()?;
        lock(&self.status.removed).append(&mut removed);
        let (gaussians, steps) = (self.mapper.num_gaussians(), self.mapper.steps());
        self.status
            .num_gaussians
            .store(gaussians, Ordering::Relaxed);
        self.status.steps.store(steps, Ordering::Relaxed);
        if self.events.take_snapshot_request() {
            let gaussians = Arc::new(self.mapper.gaussians()?);
            self.events.publish(|| SlamEvent::Snapshot(gaussians));
        }
        Ok(())
    }
}

/// What a panic said.
fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "a panic without a message".into())
}
