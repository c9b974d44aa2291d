//! The model on a graphics device. Everything of a step stays there; the host hears of it some steps
//! later.
//!
//! A step that finds no room for the tiles' lists changes nothing, and neither does any after it,
//! until the host hears of it, makes room and repeats them in their order. So results depend on
//! nothing but the calls and the device.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use fgs_geom::View;

use super::buffers::Buffers;
use super::device::GpuDevice;
use super::error::GpuError;
use super::layout::{self, Count, Gaussian, NONE};
use super::parameters::{from_device, sparse_from_device, to_device};
use super::passes::{groups, loss_uniform, view_uniform};
use super::readback::{Arrival, Landing, read};
use super::recorder::{Groups, Recorder};
use super::targets::ResidentTargets;
use super::timer::StageTimer;
use crate::adam::Corrections;
use crate::model::{
    GaussianModel, ModelError, ModelSettings, PruneRule, Seeds, SparseChanges, SparseId, StepStats,
    ViewId,
};
use crate::{Cotangents, Gaussians, Rendered, Target, photometric_loss};

/// Steps that the device may be behind the host: enough that it never waits for one.
const MAX_IN_FLIGHT: usize = 4;
/// Entries of the tiles' lists that there is room for at first.
const FIRST_ENTRIES: usize = 1 << 18;
/// The set of gaussians that steps touched since the sparse map was last asked for.
const TOUCHED_SET: u32 = 0;

/// A [`GaussianModel`] on a graphics device.
pub struct GpuModel {
    pub(super) device: GpuDevice,
    settings: ModelSettings,
    pub(super) buffers: Buffers,
    count: usize,
    views: BTreeMap<ViewId, TrainingView>,
    next_view: usize,
    free_sets: BTreeSet<u32>,
    targets: ResidentTargets,
    /// The view whose target the stages are bound to.
    bound_target: Option<ViewId>,
    in_flight: VecDeque<InFlight>,
    landings: Vec<Landing>,
    stats: Vec<StepStats>,
    repeated_steps: usize,
    /// Sparse gaussians pruned since they were last asked for.
    removed: Vec<SparseId>,
    /// The map as the host last knew it, for when the device is lost.
    last_known: Gaussians,
}

/// A registered view.
struct TrainingView {
    view: View,
    target: Target,
    /// Number of its set of gaussians.
    set: u32,
}

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

/// A step that the device has not reported yet.
struct InFlight {
    view: ViewId,
    counts: Arrival,
}

impl GpuModel {
    /// An empty map. Up to `max_resident_views` views have their images on the device.
    ///
    /// # Errors
    /// If the device's memory does not suffice.
    pub fn new(
        device: GpuDevice,
        settings: ModelSettings,
        max_resident_views: usize,
    ) -> Result<Self, GpuError> {
        Self::with_entries(device, settings, max_resident_views, FIRST_ENTRIES)
    }

    /// As [`GpuModel::new`], with room for that many entries of the tiles' lists at first.
    pub(super) fn with_entries(
        device: GpuDevice,
        settings: ModelSettings,
        max_resident_views: usize,
        entries: usize,
    ) -> Result<Self, GpuError> {
        let mut buffers = Buffers::new(&device, entries)?;
        let rates = &settings.learning_rates;
        let optimizer = layout::Optimizer {
            means: rates.means,
            quats: rates.quats,
            log_scales: rates.log_scales,
            opacity_logits: rates.opacity_logits,
            sh: rates.sh,
            scale_weight: settings.loss.scale_weight,
        };
        let queue = device.queue();
        queue.write_buffer(buffers.get("optimizer")?, 0, bytemuck::bytes_of(&optimizer));
        let corrections: Vec<[f32; 2]> = Corrections::table()
            .iter()
            .map(|correction| [correction.first, correction.second_root])
            .collect();
        buffers.set("corrections", device.buffer_of("corrections", &corrections));
        Ok(Self {
            free_sets: (TOUCHED_SET + 1..buffers.sets() as u32).collect(),
            device,
            settings,
            buffers,
            count: 0,
            views: BTreeMap::new(),
            next_view: 0,
            targets: ResidentTargets::new(max_resident_views),
            bound_target: None,
            in_flight: VecDeque::new(),
            landings: Vec::new(),
            stats: Vec::new(),
            repeated_steps: 0,
            removed: Vec::new(),
            last_known: Gaussians::default(),
        })
    }

    /// How many steps found no room and were repeated.
    pub fn repeated_steps(&self) -> usize {
        self.repeated_steps
    }

    /// Takes a step on a registered view and times its stages. `None` if the device has no clock.
    ///
    /// # Errors
    /// If there is no such view, a rendered value is out of range or the device fails.
    pub fn timed_step(&mut self, id: ViewId) -> Result<Option<TimedStep>, ModelError> {
        self.finish_steps()?;
        let Some(mut timer) = StageTimer::new(&self.device)? else {
            return Ok(None);
        };
        self.submit_step(id, Some(&mut timer))?;
        self.finish_steps()?;
        let counts = self.buffers.get("counts")?;
        let counts: Vec<u32> = read(&self.device, counts, 0, Count::ALL.len())?;
        let count = |place: Count| counts[place as usize] as usize;
        Ok(Some(TimedStep {
            stages: timer.take(&self.device)?,
            in_view: count(Count::VISIBLE),
            entries: count(Count::ENTRIES),
        }))
    }

    /// Waits for all steps.
    ///
    /// # Errors
    /// If one of them found damaged values, or the device fails.
    pub fn finish_steps(&mut self) -> Result<(), ModelError> {
        while !self.in_flight.is_empty() {
            self.retire_step()?;
        }
        Ok(())
    }

    /// The uniform of a view that shows the map as it is now.
    fn view_uniform(&self, view: &View) -> layout::View {
        view_uniform(view, self.count, self.buffers.entries())
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<(), GpuError> {
        let buffer = self.buffers.get(name)?;
        self.device.queue().write_buffer(buffer, 0, bytes);
        Ok(())
    }

    /// Writes what the stages need to know of a registered view.
    fn look_at(&mut self, id: ViewId) -> Result<(layout::View, layout::Loss), ModelError> {
        let Some(training) = self.views.get(&id) else {
            return Err(ModelError::NoSuchView(id));
        };
        let camera = training.view.camera;
        self.buffers
            .make_room_for_image(camera.width, camera.height)?;
        let view = layout::View {
            set_start: training.set * self.buffers.set_words() as u32,
            ..self.view_uniform(&training.view)
        };
        let loss = loss_uniform(&self.settings.loss, &training.target);
        let measured = self.targets.get(&self.device, id, &training.target)?;
        if self.bound_target != Some(id) {
            self.buffers.set("measured", measured);
            self.bound_target = Some(id);
        }
        self.write("loss", bytemuck::bytes_of(&loss))?;
        Ok((view, loss))
    }

    fn submit_step(
        &mut self,
        id: ViewId,
        timer: Option<&mut StageTimer>,
    ) -> Result<(), ModelError> {
        self.device.check()?;
        let (view, loss) = self.look_at(id)?;
        let view = layout::View {
            touched_start: TOUCHED_SET * self.buffers.set_words() as u32,
            ..view
        };
        self.write("view", bytemuck::bytes_of(&view))?;
        let bytes = 4 * Count::ALL.len() as u64;
        let landing = match self.landings.pop() {
            Some(landing) => landing,
            None => Landing::new(&self.device, bytes)?,
        };
        let mut recorder = Recorder::new(&self.device, &mut self.buffers, timer);
        recorder.forward(&view)?;
        recorder.backward(&view, &loss)?;
        recorder.optimize()?;
        let counts = recorder.buffers.get("counts")?.clone();
        recorder
            .encoder()
            .copy_buffer_to_buffer(&counts, 0, landing.buffer(), 0, bytes);
        let counts = landing.expect(recorder.submit());
        self.in_flight.push_back(InFlight { view: id, counts });
        Ok(())
    }

    /// Waits for the oldest step that is in flight.
    fn retire_step(&mut self) -> Result<(), ModelError> {
        let Some(InFlight { view, counts }) = self.in_flight.pop_front() else {
            return Ok(());
        };
        let (counts, landing) = counts.take_and_keep::<u32>(&self.device)?;
        self.landings.push(landing);
        let count = |place: Count| counts[place as usize];
        if count(Count::OUT_OF_RANGE) != 0 {
            self.forget_steps_in_flight()?;
            return Err(self.what_is_out_of_range(view)?);
        }
        if count(Count::OVERFLOWED) != 0 {
            let mut void = vec![view];
            void.extend(self.forget_steps_in_flight()?);
            self.repeated_steps += void.len();
            self.make_room(count(Count::ENTRIES_NEEDED))?;
            for view in void {
                self.submit_step(view, None)?;
            }
            return Ok(());
        }
        self.stats.push(StepStats {
            view,
            loss: f32::from_bits(count(Count::LOSS)),
            visible: count(Count::TOUCHED) as usize,
            skipped_gradients: count(Count::SKIPPED) as usize,
        });
        Ok(())
    }

    /// Waits for the steps in flight, which changed nothing, and lets the next one change things.
    fn forget_steps_in_flight(&mut self) -> Result<Vec<ViewId>, GpuError> {
        let steps = std::mem::take(&mut self.in_flight);
        let mut views = Vec::new();
        for InFlight { view, counts } in steps {
            let (_, landing) = counts.take_and_keep::<u32>(&self.device)?;
            self.landings.push(landing);
            views.push(view);
        }
        self.write("counts", &[0; 4 * Count::ALL.len()])?;
        Ok(views)
    }

    /// Room for that many entries, and for some more.
    fn make_room(&mut self, entries: u32) -> Result<(), GpuError> {
        let entries = entries as usize;
        self.buffers.make_room_for_entries(entries + entries / 4)
    }

    /// Why the render of a view cannot be compared with its target.
    fn what_is_out_of_range(&mut self, id: ViewId) -> Result<ModelError, ModelError> {
        let Some(TrainingView { view, .. }) = self.views.get(&id) else {
            return Err(ModelError::NoSuchView(id));
        };
        let rendered = self.render(&view.clone())?;
        let target = &self.views[&id].target;
        let loss = photometric_loss(
            &rendered,
            target,
            &self.settings.loss,
            &mut Cotangents::default(),
        );
        Ok(match loss {
            Err(error) => ModelError::Loss(error),
            Ok(_) => GpuError::Other("a rendered value was out of range".into()).into(),
        })
    }

    /// Runs a pass that is no step until there is room for it; the counts it ends with.
    fn run_to_the_end(
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
            let counts: Vec<u32> = read(
                &self.device,
                self.buffers.get("counts")?,
                0,
                Count::ALL.len(),
            )?;
            self.write("counts", &[0; 4 * Count::ALL.len()])?;
            if counts[Count::OVERFLOWED as usize] == 0 {
                return Ok(counts);
            }
            self.make_room(counts[Count::ENTRIES_NEEDED as usize])?;
        }
    }

    /// Finds which gaussians a view shows: the way back tells which ones a pixel took. Returns the
    /// counts.
    pub(super) fn see_again(&mut self, id: ViewId) -> Result<Vec<u32>, ModelError> {
        let (view, loss) = self.look_at(id)?;
        self.run_to_the_end(&view, Some(&loss))
    }

    /// Leaves room for only so many entries, as if no view had been looked at.
    #[cfg(test)]
    pub(super) fn shrink_entries(&mut self, entries: usize) {
        self.buffers.shrink_entries(entries);
    }

    fn read_gaussians(&self) -> Result<Vec<Gaussian>, GpuError> {
        read(&self.device, self.buffers.get("gaussians")?, 0, self.count)
    }

    /// Writes what the passes over the whole map need.
    fn write_rule(&self, rule: &PruneRule) -> Result<(), GpuError> {
        let rule = layout::Prune {
            count: self.count as u32,
            set_words: self.buffers.set_words() as u32,
            min_opacity: rule.min_opacity,
            max_log_scale: rule.max_scale_m.ln(),
            max_log_aspect: rule.max_aspect.ln(),
        };
        self.write("rule", bytemuck::bytes_of(&rule))
    }

    fn read_kept(&self) -> Result<usize, GpuError> {
        let counts = self.buffers.get("counts")?;
        let kept: Vec<u32> = read(&self.device, counts, Count::KEPT as usize, 1)?;
        Ok(kept[0] as usize)
    }

    /// Moves the gaussians that survive together, and all that belongs to them.
    fn compact(&mut self) -> Result<(), GpuError> {
        const NEW_PLACES: (&str, &str) = ("new_from_old", "depth_keys");
        let by_gaussian = groups(self.count);
        let words = groups(self.count.div_ceil(32));
        let moved_sets = self.buffers.empty_sets()?;
        self.buffers.set("moved_sets", moved_sets);
        let Groups::Fixed(words, _) = words else {
            return Ok(());
        };
        let sets = Groups::Fixed(words, self.buffers.sets() as u32);

        let mut recorder = Recorder::new(&self.device, &mut self.buffers, None);
        let aliases = [
            NEW_PLACES,
            ("moved_gaussians", "gradients"),
            ("removed_ids", "order"),
        ];
        recorder.run_as("move_survivors", 0, &aliases, by_gaussian)?;
        recorder.run_as("move_sets", 0, &[NEW_PLACES], sets)?;
        recorder.submit();
        self.buffers.swap("gaussians", "gradients");
        for moments in ["first_moments", "second_moments"] {
            let mut recorder = Recorder::new(&self.device, &mut self.buffers, None);
            let aliases = [NEW_PLACES, ("rows", moments), ("moved_rows", "gradients")];
            recorder.run_as("move_rows", 0, &aliases, by_gaussian)?;
            recorder.submit();
            self.buffers.swap(moments, "gradients");
        }
        self.buffers.swap("visible_sets", "moved_sets");
        self.buffers.remove("moved_sets");
        Ok(())
    }
}

impl GaussianModel for GpuModel {
    fn len(&self) -> usize {
        self.count
    }

    fn add_view(&mut self, view: View, target: Target) -> Result<ViewId, ModelError> {
        self.finish_steps()?;
        let expected = (view.camera.width, view.camera.height);
        let actual = (target.color().width(), target.color().height());
        if expected != actual {
            return Err(ModelError::TargetSize { expected, actual });
        }
        let set = match self.free_sets.pop_first() {
            Some(set) => set,
            None => {
                let set = self.buffers.sets() as u32;
                self.buffers.double_sets()?;
                self.free_sets.extend(set + 1..self.buffers.sets() as u32);
                set
            }
        };
        let id = ViewId(self.next_view);
        self.next_view += 1;
        self.views.insert(id, TrainingView { view, target, set });
        if let Err(error) = self.see_again(id) {
            self.drop_view(id)?;
            return Err(error);
        }
        Ok(id)
    }

    fn drop_view(&mut self, id: ViewId) -> Result<(), ModelError> {
        self.finish_steps()?;
        let dropped = self.views.remove(&id).ok_or(ModelError::NoSuchView(id))?;
        self.free_sets.insert(dropped.set);
        self.targets.remove(id);
        Ok(())
    }

    fn insert(&mut self, seeds: &Seeds) -> Result<(), ModelError> {
        self.finish_steps()?;
        let added = seeds.sparse_ids.len();
        if !seeds.gaussians.has_len(added) {
            return Err(ModelError::RaggedSeeds);
        }
        let count = self.count + added;
        self.buffers.make_room_for_gaussians(count, self.count)?;
        self.last_known.extend(&seeds.gaussians);
        let row = size_of::<Gaussian>() as u64;
        let (start, bytes) = (row * self.count as u64, row * added as u64);
        let mut encoder = self
            .device
            .raw()
            .create_command_encoder(&Default::default());
        for moments in ["first_moments", "second_moments"] {
            encoder.clear_buffer(self.buffers.get(moments)?, start, Some(bytes));
        }
        self.device.queue().submit([encoder.finish()]);
        let rows = to_device(seeds);
        let gaussians = self.buffers.get("gaussians")?;
        let queue = self.device.queue();
        queue.write_buffer(gaussians, start, bytemuck::cast_slice(&rows));
        self.count = count;
        Ok(self.device.check()?)
    }

    fn prune(&mut self, rule: &PruneRule) -> Result<usize, ModelError> {
        self.finish_steps()?;
        self.write_rule(rule)?;
        let mut recorder = Recorder::new(&self.device, &mut self.buffers, None);
        recorder.run("count_survivors", groups(self.count))?;
        recorder.run("place_survivors", Groups::Fixed(1, 1))?;
        recorder.submit();
        let pruned = self.count - self.read_kept()?;
        if pruned > 0 {
            self.compact()?;
            let ids: Vec<u32> = read(&self.device, self.buffers.get("order")?, 0, pruned)?;
            let ids = ids.into_iter().filter(|id| *id != NONE);
            self.removed.extend(ids.map(SparseId));
            self.count -= pruned;
            self.last_known = from_device(&self.read_gaussians()?);
        }
        Ok(pruned)
    }

    fn render(&mut self, view: &View) -> Result<Rendered, ModelError> {
        self.finish_steps()?;
        let (width, height) = (view.camera.width, view.camera.height);
        self.buffers.make_room_for_image(width, height)?;
        self.run_to_the_end(&self.view_uniform(view), None)?;
        let pixels = width * height;
        let shown: Vec<[f32; 4]> = read(&self.device, self.buffers.get("rendered")?, 0, pixels)?;
        let states = self.buffers.get("pixel_states")?;
        let states: Vec<layout::PixelState> = read(&self.device, states, 0, pixels)?;
        let mut rendered = Rendered::default();
        rendered.resize(width, height);
        for (color, [r, g, b, _]) in rendered.color.data_mut().iter_mut().zip(&shown) {
            *color = [*r, *g, *b];
        }
        for (depth_m, [.., depth]) in rendered.depth_m.data_mut().iter_mut().zip(&shown) {
            *depth_m = *depth;
        }
        for (alpha, state) in rendered.alpha.data_mut().iter_mut().zip(&states) {
            *alpha = 1.0 - state.transmittance;
        }
        Ok(rendered)
    }

    fn step(&mut self, id: ViewId) -> Result<(), ModelError> {
        if self.in_flight.len() >= MAX_IN_FLIGHT {
            self.retire_step()?;
        }
        self.submit_step(id, None)
    }

    fn take_stats(&mut self) -> Vec<StepStats> {
        std::mem::take(&mut self.stats)
    }

    fn covisibility(&mut self, id: ViewId) -> Result<Vec<(ViewId, f32)>, ModelError> {
        self.finish_steps()?;
        let own = self.views.get(&id).ok_or(ModelError::NoSuchView(id))?;
        let sets = self.buffers.sets();
        let uniform = layout::Covisibility {
            own_set: own.set,
            set_words: self.buffers.set_words() as u32,
            used_words: self.count.div_ceil(32) as u32,
        };
        self.write("covisibility_", bytemuck::bytes_of(&uniform))?;
        let mut recorder = Recorder::new(&self.device, &mut self.buffers, None);
        recorder.run("covisibility", Groups::Fixed(sets as u32, 1))?;
        recorder.submit();
        let overlaps: Vec<u32> = read(&self.device, self.buffers.get("overlaps")?, 0, sets)?;
        let overlap = |view: &TrainingView| overlaps[view.set as usize];
        let count = overlap(own).max(1) as f32;
        let others = self.views.iter().filter(|(other, _)| **other != id);
        Ok(others
            .map(|(other, view)| (*other, overlap(view) as f32 / count))
            .collect())
    }

    fn take_sparse_changes(&mut self) -> Result<SparseChanges, ModelError> {
        self.finish_steps()?;
        self.write_rule(&PruneRule {
            min_opacity: 0.0,
            max_scale_m: f32::MAX,
            max_aspect: f32::MAX,
        })?;
        let by_gaussian = groups(self.count);
        let set_bytes = 4 * self.buffers.set_words() as u64;
        let mut recorder = Recorder::new(&self.device, &mut self.buffers, None);
        let aliases = [("moved_gaussians", "gradients")];
        recorder.run("count_moved", by_gaussian)?;
        recorder.run("place_moved", Groups::Fixed(1, 1))?;
        recorder.run_as("write_moved", 0, &aliases, by_gaussian)?;
        let sets = recorder.buffers.get("visible_sets")?.clone();
        recorder.encoder().clear_buffer(&sets, 0, Some(set_bytes));
        recorder.submit();
        let moved = self.read_kept()?;
        let rows: Vec<Gaussian> = read(&self.device, self.buffers.get("gradients")?, 0, moved)?;
        let mut removed = std::mem::take(&mut self.removed);
        removed.sort_unstable();
        Ok(SparseChanges {
            moved: sparse_from_device(&rows),
            removed,
        })
    }

    fn gaussians(&mut self) -> Result<Gaussians, ModelError> {
        self.finish_steps()?;
        Ok(from_device(&self.read_gaussians()?))
    }

    fn device_bytes(&self) -> u64 {
        self.buffers.bytes() + self.targets.bytes()
    }

    fn into_gaussians(mut self) -> Gaussians {
        // What a step has found wrong is no reason to lose what the others did.
        let _ = self.finish_steps();
        match self.read_gaussians() {
            Ok(rows) => from_device(&rows),
            Err(_) => self.last_known,
        }
    }
}
