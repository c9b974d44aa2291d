//! The queue of steps, motions and prunings in flight: submitted to the device, but not yet known to
//! have taken effect.
//!
//! A step whose tile lists overflow is void: it changes nothing, and neither does anything submitted
//! after it, until the host reads the overflow flag, grows the buffers and resubmits all of it in
//! order. So results depend only on the calls and the device, never on buffer capacities or timing.

use std::collections::VecDeque;

use fgs_geom::{KeyframeId, View};

use super::device_map::{DeviceMap, Pruning};
use super::images;
use super::layout::{self, Count};
use super::passes::{loss_uniform, view_uniform};
use super::readback::{Arrival, Landing};
use super::timer::StageTimer;
use super::training_views::TrainingViews;
use crate::GpuError;
use crate::model::{ModelError, PruneRule, SparseId, StepStats};
use crate::{Cotangents, Gaussians, LossSettings, photometric_loss};

/// Maximum number of submissions in flight: enough to keep the device busy.
const MAX_IN_FLIGHT: usize = 4;

/// Work that is submitted without waiting for the device.
pub enum Work {
    /// A step on a keyframe's view, as posed at the time of the call.
    Step(KeyframeId, View),
    /// Sorted by anchor.
    Move(Vec<layout::Motion>),
    Prune(PruneRule),
}

/// The pending readback of a submission.
enum Report {
    /// The step's counts.
    Step(Arrival),
    /// None: a motion takes effect if everything before it did.
    Move,
    Prune(Pruning),
}

/// The map, its views and the work in flight.
pub struct WorkQueue {
    pub map: DeviceMap,
    pub views: TrainingViews,
    loss: LossSettings,
    in_flight: VecDeque<(Work, Report)>,
    landings: Vec<Landing>,
    repeated_steps: usize,
    /// Statistics of finished steps.
    pub stats: Vec<StepStats>,
    /// Pruned gaussians of the sparse map, not yet reported to the caller.
    pub removed: Vec<SparseId>,
    /// The host's last copy of the map, in case the device is lost.
    pub last_known: Gaussians,
}

impl WorkQueue {
    /// A queue with nothing in flight.
    pub fn new(map: DeviceMap, views: TrainingViews, loss: LossSettings) -> Self {
        Self {
            map,
            views,
            loss,
            in_flight: VecDeque::new(),
            landings: Vec::new(),
            repeated_steps: 0,
            stats: Vec::new(),
            removed: Vec::new(),
            last_known: Gaussians::default(),
        }
    }

    /// How many steps were repeated because the tile lists overflowed.
    pub fn repeated_steps(&self) -> usize {
        self.repeated_steps
    }

    /// Number of submissions in flight.
    #[cfg(test)]
    pub fn in_flight(&self) -> usize {
        self.in_flight.len()
    }

    /// Submits work. If the queue is full, waits for the oldest submission first.
    ///
    /// # Errors
    /// If a step's view does not exist, an earlier step rendered a value out of range, or the device
    /// fails.
    pub fn push(&mut self, work: Work) -> Result<(), ModelError> {
        if self.in_flight.len() >= MAX_IN_FLIGHT {
            self.retire()?;
        }
        self.submit(work, None)
    }

    /// Submits a step whose stages are timed. Nothing may be in flight.
    ///
    /// # Errors
    /// If the view does not exist, or the device fails.
    pub fn push_timed(
        &mut self,
        id: KeyframeId,
        view: View,
        timer: &mut StageTimer,
    ) -> Result<(), ModelError> {
        self.submit(Work::Step(id, view), Some(timer))
    }

    /// Waits for everything in flight.
    ///
    /// # Errors
    /// If a step rendered a value out of range, or the device fails.
    pub fn finish(&mut self) -> Result<(), ModelError> {
        while !self.in_flight.is_empty() {
            self.retire()?;
        }
        Ok(())
    }

    /// Fills a view's visibility set: the backward pass records the gaussians that contribute to a
    /// pixel. Nothing may be in flight. Returns the counts of the pass.
    ///
    /// # Errors
    /// If there is no such view, or the device fails.
    pub fn find_visible(&mut self, id: KeyframeId) -> Result<Vec<u32>, ModelError> {
        let view = self.views.get(id)?.view;
        let (uniform, loss, set) = self.look_at(id, &view)?;
        let (counts, []) = images::run(
            &mut self.map,
            &uniform,
            |recorder| recorder.backward(&uniform, &loss, set),
            [],
        )?;
        Ok(counts)
    }

    /// Makes room for a view's images, uploads its target if necessary and writes the loss's uniform.
    /// Returns the uniforms of view and loss, and the index of the visibility set.
    fn look_at(
        &mut self,
        id: KeyframeId,
        view: &View,
    ) -> Result<(layout::View, layout::Loss, u32), ModelError> {
        let map = &mut self.map;
        map.buffers
            .make_room_for_image(view.camera.width, view.camera.height)?;
        let device = map.device().clone();
        let training = self.views.require(&device, &mut map.buffers, id)?;
        let uniform = layout::View {
            set_start: training.set * map.buffers.set_words() as u32,
            ..view_uniform(view, map.len(), map.buffers.entries())
        };
        let loss = loss_uniform(&self.loss, &training.target);
        map.write("loss", bytemuck::bytes_of(&loss))?;
        Ok((uniform, loss, training.set))
    }

    fn submit(&mut self, work: Work, timer: Option<&mut StageTimer>) -> Result<(), ModelError> {
        let report = match &work {
            Work::Step(id, view) => Report::Step(self.submit_step(*id, view, timer)?),
            Work::Move(motions) => {
                self.map.move_anchored(motions)?;
                Report::Move
            }
            Work::Prune(rule) => Report::Prune(self.map.prune(rule)?),
        };
        self.in_flight.push_back((work, report));
        Ok(())
    }

    fn submit_step(
        &mut self,
        id: KeyframeId,
        view: &View,
        timer: Option<&mut StageTimer>,
    ) -> Result<Arrival, ModelError> {
        self.map.device().check()?;
        let (uniform, loss, set) = self.look_at(id, view)?;
        self.map.write("view", bytemuck::bytes_of(&uniform))?;
        let bytes = 4 * Count::ALL.len() as u64;
        let landing = match self.landings.pop() {
            Some(landing) => landing,
            None => Landing::new(self.map.device(), bytes)?,
        };
        let mut recorder = self.map.recorder(timer);
        recorder.forward(&uniform)?;
        recorder.backward(&uniform, &loss, set)?;
        recorder.optimize()?;
        let counts = recorder.buffers.get("counts")?.clone();
        recorder
            .encoder()
            .copy_buffer_to_buffer(&counts, 0, landing.buffer(), 0, bytes);
        Ok(landing.expect(recorder.submit()))
    }

    /// Waits for the oldest submission and takes in what it reads back.
    fn retire(&mut self) -> Result<(), ModelError> {
        match self.in_flight.pop_front() {
            Some((Work::Step(id, view), Report::Step(counts))) => {
                self.retire_step(id, view, counts)
            }
            Some((_, Report::Prune(pruning))) => {
                let (removed, gaussians) = self.map.finish_pruning(pruning)?;
                self.removed.extend(removed);
                self.last_known = gaussians;
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn retire_step(
        &mut self,
        id: KeyframeId,
        view: View,
        counts: Arrival,
    ) -> Result<(), ModelError> {
        let device = self.map.device();
        let (counts, landing) = counts.take(device, bytemuck::pod_collect_to_vec::<u8, u32>)?;
        self.landings.push(landing);
        let count = |place: Count| counts[place as usize];
        if count(Count::OUT_OF_RANGE) != 0 {
            for work in self.forget_what_is_in_flight()? {
                // The views have moved already, so the gaussians must follow. Steps and prunings are
                // dropped: this error ends the run.
                if let Work::Move(_) = work {
                    self.submit(work, None)?;
                }
            }
            return Err(self.what_is_out_of_range(id, &view)?);
        }
        if count(Count::OVERFLOWED) != 0 {
            let void = self.forget_what_is_in_flight()?;
            self.map
                .make_room_for_entries(count(Count::ENTRIES_NEEDED))?;
            for work in std::iter::once(Work::Step(id, view)).chain(void) {
                self.repeated_steps += usize::from(matches!(work, Work::Step(..)));
                self.submit(work, None)?;
            }
            return Ok(());
        }
        self.stats.push(StepStats {
            view: id,
            loss: f32::from_bits(count(Count::LOSS)),
            visible: count(Count::TOUCHED) as usize,
            skipped_gradients: count(Count::SKIPPED) as usize,
        });
        Ok(())
    }

    /// Empties the queue after a void step: waits for the submissions, which are void too, clears the
    /// flags and returns the work in order.
    fn forget_what_is_in_flight(&mut self) -> Result<Vec<Work>, GpuError> {
        let mut void = Vec::new();
        for (work, report) in std::mem::take(&mut self.in_flight) {
            match report {
                Report::Step(counts) => {
                    let ((), landing) = counts.take(self.map.device(), |_| ())?;
                    self.landings.push(landing);
                }
                Report::Move => {}
                Report::Prune(pruning) => self.map.forget_pruning(pruning)?,
            }
            void.push(work);
        }
        self.map.clear_counts()?;
        Ok(void)
    }

    /// The error of a rendered value out of range: renders the view again to find the pixel.
    fn what_is_out_of_range(
        &mut self,
        id: KeyframeId,
        view: &View,
    ) -> Result<ModelError, ModelError> {
        self.finish()?;
        let rendered = images::render(&mut self.map, view)?;
        let loss = photometric_loss(
            &rendered,
            &self.views.get(id)?.target,
            &self.loss,
            &mut Cotangents::default(),
        );
        Ok(match loss {
            Err(error) => ModelError::Loss(error),
            Ok(_) => GpuError::Other("a rendered value was out of range".into()).into(),
        })
    }
}
