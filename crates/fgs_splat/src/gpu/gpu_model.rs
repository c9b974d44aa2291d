//! Implements [`GaussianModel`] on a graphics device, with the device's map, its views and the work
//! queue.

use fgs_geom::{Image, KeyframeId, Se3, View};

use super::device::GpuDevice;
use super::device_map::DeviceMap;
use super::images;
use super::layout::{self, Count};
use super::parameters::motions_to_device;
use super::readback::read;
use super::recorder::Groups;
use super::resident_targets::budget;
use super::timer::StageTimer;
use super::training_views::{TrainingView, TrainingViews};
use super::work_queue::{Work, WorkQueue};
use crate::GpuError;
use crate::least_useful::least_useful;
use crate::model::{
    GaussianModel, ModelError, ModelSettings, PruneRule, Seeds, SparseId, StepStats, check_image,
    check_seeds, check_view,
};
use crate::rigid_motion::by_keyframe;
use crate::{Gaussians, Rendered, SavedModel, SavedView, Target};

/// Initial capacity of the tile lists, entries.
const FIRST_ENTRIES: usize = 1 << 18;

/// A [`GaussianModel`] on a graphics device.
pub struct GpuModel {
    pub(super) work: WorkQueue,
}

/// The stages of a step with their times, and the amount of work.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedStep {
    /// Names in dispatch order, each with its milliseconds by the device's timestamps.
    pub stages: Vec<(&'static str, f64)>,
    /// Gaussians in view.
    pub in_view: usize,
    /// Entries of all tile lists, that is, pairs of a gaussian and a tile of 8x8 pixels it touches.
    pub entries: usize,
    /// Entries of the longest tile list.
    pub longest_list: usize,
    /// The most tiles that one gaussian touches.
    pub most_tiles: usize,
}

impl GpuModel {
    /// An empty map. The views' measured images are kept on the device within a budget: the largest
    /// buffer that the device allows, at most 1.5 GiB. Beyond it, or when memory runs out, the least
    /// recently used ones are evicted.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn new(device: GpuDevice, settings: &ModelSettings) -> Result<Self, GpuError> {
        let target_bytes = budget(&device);
        Self::with_room(device, settings, target_bytes, FIRST_ENTRIES)
    }

    /// As [`GpuModel::new`], with a budget of `target_bytes` for the measured images, and tile lists
    /// with an initial capacity of `entries`.
    pub(super) fn with_room(
        device: GpuDevice,
        settings: &ModelSettings,
        target_bytes: u64,
        entries: usize,
    ) -> Result<Self, GpuError> {
        let map = DeviceMap::new(device, settings, entries)?;
        let views = TrainingViews::new(&map.buffers, target_bytes);
        Ok(Self {
            work: WorkQueue::new(map, views, settings.loss.clone()),
        })
    }

    /// How many steps were repeated because the tile lists overflowed.
    pub fn repeated_steps(&self) -> usize {
        self.work.repeated_steps()
    }

    /// Waits for all submitted steps, motions and prunings.
    ///
    /// # Errors
    /// If a step rendered a value out of range, or the device fails.
    pub fn finish_steps(&mut self) -> Result<(), ModelError> {
        self.work.finish()
    }

    /// Takes a step on a registered view and times its stages. Without timestamp queries on the
    /// device it takes no step and returns `None`.
    ///
    /// # Errors
    /// If there is no such view, a rendered value is out of range or the device fails.
    pub fn timed_step(&mut self, id: KeyframeId) -> Result<Option<TimedStep>, ModelError> {
        self.work.finish()?;
        let Some(mut timer) = StageTimer::new(self.work.map.device())? else {
            return Ok(None);
        };
        loop {
            let repeated = self.repeated_steps();
            let view = self.work.views.get(id)?.view;
            self.work.push_timed(id, view, &mut timer)?;
            self.work.finish()?;
            let stages = timer.take(self.work.map.device())?;
            // If the tile lists overflowed, the step was repeated without the timer.
            if self.repeated_steps() == repeated {
                return Ok(Some(self.timed(stages, &view)?));
            }
        }
    }

    /// Which gaussians a view shows, by its set: i is bit `i % 32` of word `i / 32`. Nothing may be in
    /// flight.
    fn visible(&self, set: u32) -> Result<Vec<u32>, GpuError> {
        let map = &self.work.map;
        let sets = map.buffers.get("visible_sets")?;
        let first = set as usize * map.buffers.set_words();
        let mut visible: Vec<u32> = read(map.device(), sets, first, map.len().div_ceil(32))?;
        if let (Some(last), used @ 1..) = (visible.last_mut(), map.len() % 32) {
            // Pruned gaussians may have left their bits.
            *last &= (1 << used) - 1;
        }
        Ok(visible)
    }

    /// The last step's times with its amount of work, read back from the device.
    fn timed(&self, stages: Vec<(&'static str, f64)>, view: &View) -> Result<TimedStep, GpuError> {
        let map = &self.work.map;
        let fetch = |name, len| read(map.device(), map.buffers.get(name)?, 0, len);
        let counts: Vec<u32> = fetch("counts", Count::ALL.len())?;
        let in_view = counts[Count::VISIBLE as usize] as usize;
        let uniform = super::passes::view_uniform(view, 0, 0);
        let tiles = (uniform.tile_columns * uniform.tile_rows) as usize;
        // Pairs of words: a splat's first slot and number of slots; a list's start and end.
        let touches = fetch("touches", 2 * in_view)?;
        let ranges = fetch("ranges", 2 * tiles)?;
        let pairs = |words: &[u32]| words.as_chunks::<2>().0.to_vec();
        let most = |numbers: &mut dyn Iterator<Item = u32>| numbers.max().unwrap_or(0) as usize;
        Ok(TimedStep {
            stages,
            in_view,
            entries: counts[Count::ENTRIES as usize] as usize,
            longest_list: most(&mut pairs(&ranges).iter().map(|[start, end]| end - start)),
            most_tiles: most(&mut pairs(&touches).iter().map(|[_, number]| *number)),
        })
    }
}

impl GaussianModel for GpuModel {
    fn len(&self) -> usize {
        self.work.map.len()
    }

    fn add_view(&mut self, id: KeyframeId, view: View, target: Target) -> Result<(), ModelError> {
        check_view(self.work.views.contains(id), id, &view, &target)?;
        self.work.finish()?;
        let buffers = &mut self.work.map.buffers;
        self.work.views.add(buffers, id, view, target)?;
        if let Err(error) = self.work.find_visible(id) {
            self.drop_view(id)?;
            return Err(error);
        }
        Ok(())
    }

    fn drop_view(&mut self, id: KeyframeId) -> Result<(), ModelError> {
        self.work.finish()?;
        self.work.views.remove(&mut self.work.map.buffers, id)
    }

    fn insert(&mut self, seeds: &Seeds, anchor: KeyframeId) -> Result<(), ModelError> {
        check_seeds(seeds)?;
        self.work.finish()?;
        self.work.map.insert(seeds, anchor)?;
        self.work.last_known.extend(&seeds.gaussians);
        Ok(())
    }

    fn move_anchored(&mut self, moves: &[(KeyframeId, Se3)]) -> Result<(), ModelError> {
        let motions = by_keyframe(moves)?;
        if motions.is_empty() {
            return Ok(());
        }
        self.work.views.move_cameras(&motions);
        self.work.push(Work::Move(motions_to_device(&motions)))
    }

    fn prune(&mut self, rule: &PruneRule) -> Result<(), ModelError> {
        if self.is_empty() {
            return Ok(());
        }
        self.work.push(Work::Prune(*rule))
    }

    fn remove(&mut self, indices: &[usize]) -> Result<(), ModelError> {
        self.work.finish()?;
        if self.is_empty() || indices.is_empty() {
            return Ok(());
        }
        self.work.map.mark_unwanted(indices)?;
        self.prune(&PruneRule::NOT_A_NUMBER)?;
        self.work.finish()
    }

    fn make_room(&mut self, added: usize, max: usize) -> Result<(), ModelError> {
        self.work.finish()?;
        if self.len().saturating_add(added) <= max {
            return Ok(());
        }
        let logits = self.work.map.gaussians()?.opacity_logits;
        let sets: Vec<u32> = self.work.views.iter().map(|(_, view)| view.set).collect();
        let views = sets.iter().map(|set| self.visible(*set));
        let least = least_useful(&logits, views, added, max)?;
        self.remove(&least)
    }

    fn fade_contradicted(&mut self, view: &View, depth_m: &Image<f32>) -> Result<(), ModelError> {
        check_image(view, depth_m)?;
        self.work.finish()?;
        Ok(self.work.map.fade_contradicted(view, depth_m)?)
    }

    fn render(&mut self, view: &View) -> Result<Rendered, ModelError> {
        self.work.finish()?;
        Ok(images::render(&mut self.work.map, view)?)
    }

    fn see_through(&mut self, view: &View, min_alpha: f32) -> Result<Image<bool>, ModelError> {
        self.work.finish()?;
        Ok(images::see_through(&mut self.work.map, view, min_alpha)?)
    }

    fn match_exposure(&mut self, id: KeyframeId) -> Result<(), ModelError> {
        let view = self.work.views.get(id)?.view;
        let rendered = self.render(&view)?;
        let exposed = self.work.views.get(id)?.target.exposed_like(&rendered);
        let buffers = &mut self.work.map.buffers;
        self.work.views.replace_target(buffers, id, exposed)
    }

    fn step(&mut self, id: KeyframeId) -> Result<(), ModelError> {
        let view = self.work.views.get(id)?.view;
        self.work.push(Work::Step(id, view))
    }

    fn take_stats(&mut self) -> Vec<StepStats> {
        std::mem::take(&mut self.work.stats)
    }

    fn covisibility(&mut self, id: KeyframeId) -> Result<Vec<(KeyframeId, f32)>, ModelError> {
        self.work.finish()?;
        let own = self.work.views.get(id)?.set;
        let map = &mut self.work.map;
        let sets = map.buffers.sets();
        let uniform = layout::Covisibility {
            own_set: own,
            set_words: map.buffers.set_words() as u32,
            used_words: map.len().div_ceil(32) as u32,
        };
        map.write("covisibility_", bytemuck::bytes_of(&uniform))?;
        let mut recorder = map.recorder(None);
        recorder.run("covisibility", Groups::Fixed(sets as u32, 1))?;
        recorder.submit();
        let overlaps: Vec<u32> = read(map.device(), map.buffers.get("overlaps")?, 0, sets)?;
        let count = overlaps[own as usize].max(1) as f32;
        let share = |view: &TrainingView| overlaps[view.set as usize] as f32 / count;
        let others = self.work.views.iter().filter(|(other, _)| *other != id);
        Ok(others.map(|(other, view)| (other, share(view))).collect())
    }

    fn take_removed(&mut self) -> Result<Vec<SparseId>, ModelError> {
        let mut removed = std::mem::take(&mut self.work.removed);
        removed.sort_unstable();
        Ok(removed)
    }

    fn gaussians(&mut self) -> Result<Gaussians, ModelError> {
        self.work.finish()?;
        Ok(self.work.map.gaussians()?)
    }

    fn save(&mut self) -> Result<SavedModel, ModelError> {
        self.work.finish()?;
        let views = self.work.views.iter().map(|(id, training)| {
            Ok(SavedView {
                id,
                view: training.view,
                visible: self.visible(training.set)?,
            })
        });
        Ok(SavedModel {
            removed: self.work.removed.clone(),
            views: views.collect::<Result<_, GpuError>>()?,
            ..self.work.map.save()?
        })
    }

    fn restore(&mut self, saved: SavedModel, targets: Vec<Target>) -> Result<(), ModelError> {
        saved.check(&targets)?;
        if !(self.is_empty() && self.work.views.iter().next().is_none()) {
            return Err(ModelError::Saved("the model is not empty"));
        }
        let (map, views) = (&mut self.work.map, &mut self.work.views);
        map.restore(&saved)?;
        for (saved, target) in saved.views.iter().zip(targets) {
            views.add(&mut map.buffers, saved.id, saved.view, target)?;
            let first = views.get(saved.id)?.set as usize * map.buffers.set_words();
            let sets = map.buffers.get("visible_sets")?;
            let bytes = bytemuck::cast_slice(&saved.visible);
            let queue = map.device().queue();
            queue.write_buffer(sets, (size_of::<u32>() * first) as u64, bytes);
        }
        map.device().check()?;
        self.work.removed = saved.removed;
        self.work.last_known = saved.gaussians;
        Ok(())
    }

    fn device_bytes(&self) -> u64 {
        self.work.map.buffers.bytes()
    }

    fn into_gaussians(mut self: Box<Self>) -> Gaussians {
        // A failed step is no reason to lose the map.
        let _ = self.work.finish();
        match self.work.map.gaussians() {
            Ok(gaussians) => gaussians,
            Err(_) => self.work.last_known,
        }
    }
}
