//! The mapping side of a session: the mapper with what it works off, whose turn it may be on any
//! thread, and what it tells the tracking side.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use fgs_geom::{Camera, FrameIndex, KeyframeId, Se3};
use fgs_splat::{GaussianModel, Gaussians, ModelError, SavedModel, SparseId, Target};
use serde::{Deserialize, Serialize};

use super::budget::Budget;
use super::preparation::Preparation;
use crate::config::SlamConfig;
use crate::event::{Addition, EventHub, SlamEvent};
use crate::keyframes::{FrameWork, Keyframe};
use crate::mapper::{Mapper, MapperError, MapperState};
use crate::merge::Renumbering;
use crate::prepare::PreparedKeyframe;
use crate::refinement::RefinedMap;
use crate::seam::Seam;

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

/// What the tracking side has not heard yet, as plain data.
#[derive(Default, Serialize, Deserialize)]
pub struct MapReport {
    removed: Vec<SparseId>,
    moved: Vec<(KeyframeId, Se3)>,
    aligned: Vec<(FrameIndex, Se3)>,
}

impl MapReport {
    /// Frames are none of this session's.
    pub fn forget_frames(&mut self) {
        self.aligned.clear();
    }

    /// Takes in what another map has to tell.
    pub fn append(&mut self, other: Self, renumbering: Renumbering) {
        let removed = other.removed.into_iter();
        self.removed
            .extend(removed.map(|id| renumbering.sparse(id)));
        let moved = other.moved.into_iter();
        self.moved
            .extend(moved.map(|(id, motion)| (renumbering.keyframe(id), motion)));
    }
}

impl MapStatus {
    /// Nothing has happened since a report.
    pub fn restored(report: MapReport) -> Self {
        Self {
            removed: report.removed.into(),
            moved: report.moved.into(),
            aligned: report.aligned.into(),
            ..Self::default()
        }
    }

    /// What has been reported and not been taken.
    pub fn save(&self) -> MapReport {
        MapReport {
            removed: lock(&self.removed).clone(),
            moved: lock(&self.moved).clone(),
            aligned: lock(&self.aligned).clone(),
        }
    }

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

/// All that the mapping side knows, as plain data, apart from keyframes' images.
#[derive(Serialize, Deserialize)]
pub struct SavedMapping {
    model: SavedModel,
    mapper: MapperState,
    budget: Budget,
    busy: Duration,
    is_frozen: bool,
}

/// A map that is in its model, and what else the mapping side knows.
pub struct Ready {
    model: Box<dyn GaussianModel>,
    mapper: MapperState,
    budget: Budget,
    busy: Duration,
    is_frozen: bool,
}

impl SavedMapping {
    /// Of an empty map.
    pub fn new(seed: u64) -> Self {
        Self {
            model: SavedModel::default(),
            mapper: MapperState::new(seed),
            budget: Budget::default(),
            busy: Duration::ZERO,
            is_frozen: false,
        }
    }

    /// The map.
    pub fn gaussians(&self) -> &Gaussians {
        &self.model.gaussians
    }

    /// The keyframes whose images the map is optimised with.
    pub fn views(&self) -> impl Iterator<Item = KeyframeId> {
        self.model.views.iter().map(|view| view.id)
    }

    /// Whether every view is of one camera.
    pub fn is_of(&self, camera: &Camera) -> bool {
        let mut views = self.model.views.iter();
        views.all(|saved| saved.view.camera == *camera)
    }

    /// Takes in another map.
    pub fn append(&mut self, other: Self, renumbering: Renumbering) {
        let keyframe = |id| renumbering.keyframe(id);
        (self.model).append(other.model, keyframe, |id| renumbering.sparse(id));
        self.mapper.append(other.mapper, renumbering);
    }

    /// What was counted begins anew.
    pub fn forget_counts(&mut self) {
        self.mapper.forget_counts();
        (self.budget, self.busy) = (Budget::default(), Duration::ZERO);
    }

    /// The map stays as it is from now on.
    pub fn freeze(&mut self) {
        self.is_frozen = true;
    }

    /// Puts the map into an empty model; `targets` are the images of its [`views`](Self::views).
    ///
    /// # Errors
    /// If the map contradicts itself or the images, or the model fails.
    pub fn put_into(
        self,
        mut model: Box<dyn GaussianModel>,
        targets: Vec<Target>,
    ) -> Result<Ready, ModelError> {
        model.restore(self.model, targets)?;
        Ok(Ready {
            model,
            mapper: self.mapper,
            budget: self.budget,
            busy: self.busy,
            is_frozen: self.is_frozen,
        })
    }
}

/// The mapper and what it works off.
pub struct MapperWorker {
    mapper: Mapper,
    steps_per_frame: f64,
    budget: Budget,
    /// Whether the map stays as it is.
    is_frozen: bool,
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
        config: &SlamConfig,
        ready: Ready,
        preparation: Preparation,
        status: Arc<MapStatus>,
        events: EventHub,
    ) -> Self {
        Self {
            mapper: Mapper::restored(ready.model, config, ready.mapper),
            steps_per_frame: config.mapping.iterations_per_frame,
            budget: ready.budget,
            is_frozen: ready.is_frozen,
            preparation,
            status,
            events,
            busy: ready.busy,
            failure: None,
        }
    }

    /// Lets the mapper work and reports what became of the map. `false` once the mapper cannot go
    /// on: it has failed or panicked, now or before.
    pub fn turn(&mut self, work: impl FnOnce(&mut Self) -> Result<(), MapperError>) -> bool {
        let start = Instant::now();
        let alive = self.attempt(|worker| work(worker).and_then(|()| worker.report()));
        self.busy += start.elapsed();
        alive
    }

    /// As [`turn`](Self::turn), but reports nothing.
    pub fn attempt(&mut self, work: impl FnOnce(&mut Self) -> Result<(), MapperError>) -> bool {
        if self.failure.is_some() {
            return false;
        }
        let done = catch_unwind(AssertUnwindSafe(|| work(self)))
            .unwrap_or_else(|panic| Err(MapperError::Panicked(panic_message(&*panic))));
        self.failure = done.err();
        self.failure.is_none()
    }

    /// Whether the mapper cannot go on.
    pub fn has_failed(&self) -> bool {
        self.failure.is_some()
    }

    /// All that the next turns depend on, once the keyframe that is being prepared has joined.
    pub fn save(&mut self) -> Result<SavedMapping, MapperError> {
        self.settle()?;
        let (model, mapper) = self.mapper.save()?;
        Ok(SavedMapping {
            model,
            mapper,
            budget: self.budget.clone(),
            busy: self.busy,
            is_frozen: self.is_frozen,
        })
    }

    /// Optimisation steps that are due after one more frame.
    pub fn steps_of_next_frame(&mut self) -> usize {
        self.budget.next_frame(self.steps_per_frame)
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
            Some(prepared) => self.insert(prepared),
            None => Ok(()),
        }
    }

    /// Lets a keyframe join the map.
    fn insert(&mut self, prepared: PreparedKeyframe) -> Result<(), MapperError> {
        self.events.publish_addition(|| Addition {
            frame: Arc::clone(&prepared.keyframe.frame),
            detail: prepared.detail.clone(),
            missing: prepared.missing.clone(),
            seeds: prepared.seeds.sparse_ids.len(),
        });
        self.mapper.insert(prepared)
    }

    /// One optimisation step; before it, a keyframe that is ready joins the map. The first keyframe
    /// is waited for: without it there is nothing to optimise.
    pub fn step(&mut self) -> Result<(), MapperError> {
        if self.is_frozen {
            return Ok(());
        }
        if !self.mapper.has_views() {
            self.settle()?;
        } else if let Some(prepared) = self.preparation.poll()? {
            self.insert(prepared)?;
        }
        self.mapper.step()
    }

    /// Whether there is a keyframe to optimise, and the map may change.
    pub fn can_optimize(&self) -> bool {
        self.mapper.has_views() && !self.is_frozen
    }

    /// So many optimisation steps, as long as they are wanted: see [`MapStatus::stop_optimizing`].
    pub fn steps(&mut self, steps: usize) -> Result<(), MapperError> {
        for taken in 0..steps {
            if self.status.is_stopped.load(Ordering::Relaxed) {
                self.budget.owe(steps - taken);
                break;
            }
            self.step()?;
        }
        Ok(())
    }

    /// The steps that were due when the session before this one was stopped.
    pub fn take_owed_steps(&mut self) -> usize {
        self.budget.take_owed()
    }

    /// Moves the map with its keyframes.
    pub fn move_keyframes(&mut self, moves: &[(KeyframeId, Se3)]) -> Result<(), MapperError> {
        self.settle()?;
        self.mapper.move_keyframes(moves)
    }

    /// Thins out what both sides of a seam show.
    pub fn mend(&mut self, seam: &Seam) -> Result<(), MapperError> {
        if self.is_frozen {
            return Ok(());
        }
        self.mapper.mend(seam)
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
        if refine_steps > 0 && self.can_optimize() {
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
        let mapper = &mut self.mapper;
        self.events.publish_snapshot(|| mapper.gaussians())
    }
}

/// What a panic said.
fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "a panic without a message".into())
}
