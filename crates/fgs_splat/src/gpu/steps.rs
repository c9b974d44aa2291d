//! Steps on their way to the device and back.
//!
//! A step that finds no room for the tiles' lists changes nothing, and neither does any after it,
//! until the host hears of it, makes room and repeats them in their order. So results depend on
//! nothing but the calls and the device.

use fgs_geom::{KeyframeId, View};

use super::error::GpuError;
use super::gpu_model::GpuModel;
use super::layout::{self, Count};
use super::passes::{loss_uniform, view_uniform};
use super::readback::{Arrival, Landing, read};
use super::recorder::Recorder;
use super::timer::StageTimer;
use crate::model::{GaussianModel, ModelError, StepStats};
use crate::{Cotangents, photometric_loss};

/// A step's stages and how much there was for them to do.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedStep {
    /// In their order, each with the milliseconds that it took by the device's clock.
    pub stages: Vec<(&'static str, f64)>,
    /// Gaussians in view.
    pub in_view: usize,
    /// Entries of the tiles' lists: how many times a gaussian meets a tile of 8x8 pixels.
    pub entries: usize,
}

/// What was asked of the device and is not known to have happened: a step that finds no room makes
/// void all that follows.
pub(super) enum InFlight {
    Step {
        id: KeyframeId,
        /// As it was then.
        view: View,
        counts: Arrival,
    },
    Move(Vec<layout::Motion>),
}

/// What is to be done again.
enum Work {
    Step(KeyframeId, View),
    Move(Vec<layout::Motion>),
}

impl GpuModel {
    /// Takes a step on a registered view and times its stages. `None` if the device has no clock.
    ///
    /// # Errors
    /// If there is no such view, a rendered value is out of range or the device fails.
    pub fn timed_step(&mut self, id: KeyframeId) -> Result<Option<TimedStep>, ModelError> {
        self.finish_steps()?;
        let Some(mut timer) = StageTimer::new(&self.device)? else {
            return Ok(None);
        };
        loop {
            let repeated = self.repeated_steps;
            self.submit_step(id, &self.view_of(id)?, Some(&mut timer))?;
            self.finish_steps()?;
            let stages = timer.take(&self.device)?;
            // A step for which there was no room was repeated, untimed.
            if self.repeated_steps == repeated {
                let counts = self.read_counts()?;
                return Ok(Some(TimedStep {
                    stages,
                    in_view: counts[Count::VISIBLE as usize] as usize,
                    entries: counts[Count::ENTRIES as usize] as usize,
                }));
            }
        }
    }

    /// Waits for all steps and motions.
    ///
    /// # Errors
    /// If one of them found damaged values, or the device fails.
    pub fn finish_steps(&mut self) -> Result<(), ModelError> {
        while !self.in_flight.is_empty() {
            self.retire()?;
        }
        Ok(())
    }

    /// The uniform of a view that shows the map as it is now.
    pub(super) fn view_uniform(&self, view: &View) -> layout::View {
        view_uniform(view, self.count, self.buffers.entries())
    }

    /// Where a keyframe's view is now.
    pub(super) fn view_of(&self, id: KeyframeId) -> Result<View, ModelError> {
        let training = self.views.get(&id).ok_or(ModelError::NoSuchView(id))?;
        Ok(training.view)
    }

    /// Writes what the stages need to know of a keyframe's view.
    fn look_at(
        &mut self,
        id: KeyframeId,
        view: &View,
    ) -> Result<(layout::View, layout::Loss), ModelError> {
        let training = self.views.get(&id).ok_or(ModelError::NoSuchView(id))?;
        self.buffers
            .make_room_for_image(view.camera.width, view.camera.height)?;
        let view = layout::View {
            set_start: training.set * self.buffers.set_words() as u32,
            ..self.view_uniform(view)
        };
        let loss = loss_uniform(&self.settings.loss, &training.target);
        let measured = self.targets.get(&self.device, id, &training.target)?;
        if self.bound_target != Some(id) {
            self.buffers.replace("measured", measured);
            self.bound_target = Some(id);
        }
        self.write("loss", bytemuck::bytes_of(&loss))?;
        Ok((view, loss))
    }

    /// Asks for a step on a keyframe's view from a given pose.
    pub(super) fn submit_step(
        &mut self,
        id: KeyframeId,
        view: &View,
        timer: Option<&mut StageTimer>,
    ) -> Result<(), ModelError> {
        self.device.check()?;
        let (uniform, loss) = self.look_at(id, view)?;
        self.write("view", bytemuck::bytes_of(&uniform))?;
        let bytes = 4 * Count::ALL.len() as u64;
        let landing = match self.landings.pop() {
            Some(landing) => landing,
            None => Landing::new(&self.device, bytes)?,
        };
        let mut recorder = Recorder::new(&self.device, &mut self.buffers, timer);
        recorder.forward(&uniform)?;
        recorder.backward(&uniform, &loss)?;
        recorder.optimize()?;
        let counts = recorder.buffers.get("counts")?.clone();
        recorder
            .encoder()
            .copy_buffer_to_buffer(&counts, 0, landing.buffer(), 0, bytes);
        self.in_flight.push_back(InFlight::Step {
            id,
            view: *view,
            counts: landing.expect(recorder.submit()),
        });
        Ok(())
    }

    /// Waits for the oldest step that is in flight, unless what is oldest is no step.
    pub(super) fn retire(&mut self) -> Result<(), ModelError> {
        let Some(InFlight::Step { id, view, counts }) = self.in_flight.pop_front() else {
            // All before it happened, so it did.
            return Ok(());
        };
        let (counts, landing) =
            counts.take(&self.device, bytemuck::pod_collect_to_vec::<u8, u32>)?;
        self.landings.push(landing);
        let count = |place: Count| counts[place as usize];
        if count(Count::OUT_OF_RANGE) != 0 {
            for work in self.forget_what_is_in_flight()? {
                // The views have moved already.
                if let Work::Move(motions) = work {
                    self.submit_move(motions)?;
                }
            }
            return Err(self.what_is_out_of_range(id, &view)?);
        }
        if count(Count::OVERFLOWED) != 0 {
            let void = self.forget_what_is_in_flight()?;
            self.make_room(count(Count::ENTRIES_NEEDED))?;
            for work in std::iter::once(Work::Step(id, view)).chain(void) {
                match work {
                    Work::Step(id, view) => {
                        self.repeated_steps += 1;
                        self.submit_step(id, &view, None)?;
                    }
                    Work::Move(motions) => self.submit_move(motions)?,
                }
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

    /// Waits for all that is in flight, which changed nothing, and lets what comes next change things.
    fn forget_what_is_in_flight(&mut self) -> Result<Vec<Work>, GpuError> {
        let mut void = Vec::new();
        for work in std::mem::take(&mut self.in_flight) {
            void.push(match work {
                InFlight::Step { id, view, counts } => {
                    let ((), landing) = counts.take(&self.device, |_| ())?;
                    self.landings.push(landing);
                    Work::Step(id, view)
                }
                InFlight::Move(motions) => Work::Move(motions),
            });
        }
        self.clear_counts()?;
        Ok(void)
    }

    pub(super) fn read_counts(&self) -> Result<Vec<u32>, GpuError> {
        let counts = self.buffers.get("counts")?;
        read(&self.device, counts, 0, Count::ALL.len())
    }

    /// What has happened so far keeps no later pass from changing things.
    fn clear_counts(&self) -> Result<(), GpuError> {
        self.write("counts", &[0; 4 * Count::ALL.len()])
    }

    /// Room for that many entries, and for some more.
    fn make_room(&mut self, entries: u32) -> Result<(), GpuError> {
        let entries = entries as usize;
        self.buffers.make_room_for_entries(entries + entries / 4)
    }

    /// Why the render of a view cannot be compared with its target.
    fn what_is_out_of_range(
        &mut self,
        id: KeyframeId,
        view: &View,
    ) -> Result<ModelError, ModelError> {
        let rendered = self.render(view)?;
        let training = self.views.get(&id).ok_or(ModelError::NoSuchView(id))?;
        let loss = photometric_loss(
            &rendered,
            &training.target,
            &self.settings.loss,
            &mut Cotangents::default(),
        );
        Ok(match loss {
            Err(error) => ModelError::Loss(error),
            Ok(_) => GpuError::Other("a rendered value was out of range".into()).into(),
        })
    }

    /// Runs a pass that is no step until there is room for it; the counts it ends with.
    pub(super) fn run_to_the_end(
        &mut self,
        view: &layout::View,
        loss: Option<&layout::Loss>,
    ) -> Result<Vec<u32>, ModelError> {
        loop {
            let view = layout::View {
                capacity: self.buffers.entries() as u32,
                ..*view
            };
            self.write("view", bytemuck::bytes_of(&view))?;
            let mut recorder = Recorder::new(&self.device, &mut self.buffers, None);
            recorder.forward(&view)?;
            if let Some(loss) = loss {
                recorder.backward(&view, loss)?;
            }
            recorder.submit();
            let counts = self.read_counts()?;
            self.clear_counts()?;
            if counts[Count::OVERFLOWED as usize] == 0 {
                return Ok(counts);
            }
            self.make_room(counts[Count::ENTRIES_NEEDED as usize])?;
        }
    }

    /// Finds which gaussians a view shows: the way back tells which ones a pixel took. Returns the
    /// counts.
    pub(super) fn see_again(&mut self, id: KeyframeId) -> Result<Vec<u32>, ModelError> {
        let (view, loss) = self.look_at(id, &self.view_of(id)?)?;
        self.run_to_the_end(&view, Some(&loss))
    }

    /// Leaves room for only so many entries, as if no view had been looked at.
    #[cfg(test)]
    pub(super) fn shrink_entries(&mut self, entries: usize) {
        self.buffers.shrink_entries(entries);
    }
}
