//! The model on a graphics device: what lies there, and the calls of [`GaussianModel`]. `steps` has
//! the optimisation, `whole_map` what goes over all gaussians.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use fgs_geom::{Image, KeyframeId, Se3, View};

use super::buffers::Buffers;
use super::device::GpuDevice;
use super::error::GpuError;
use super::layout::{self, Gaussian};
use super::parameters::{from_device, motions_to_device, to_device};
use super::readback::{Landing, read, read_both};
use super::recorder::{Groups, Recorder};
use super::steps::InFlight;
use super::targets::ResidentTargets;
use crate::adam::Corrections;
use crate::model::{
    GaussianModel, ModelError, ModelSettings, PruneRule, Seeds, SparseId, StepStats, check_view,
};
use crate::rigid_motion::{by_keyframe, moved};
use crate::{Gaussians, Rendered, Target};

/// Steps that the device may be behind the host: enough that it never waits for one.
const MAX_IN_FLIGHT: usize = 4;
/// Entries of the tiles' lists that there is room for at first.
const FIRST_ENTRIES: usize = 1 << 18;

/// A [`GaussianModel`] on a graphics device.
pub struct GpuModel {
    pub(super) device: GpuDevice,
    pub(super) settings: ModelSettings,
    pub(super) buffers: Buffers,
    pub(super) count: usize,
    pub(super) views: BTreeMap<KeyframeId, TrainingView>,
    pub(super) free_sets: BTreeSet<u32>,
    pub(super) targets: ResidentTargets,
    /// The view whose target the stages are bound to.
    pub(super) bound_target: Option<KeyframeId>,
    pub(super) in_flight: VecDeque<InFlight>,
    pub(super) landings: Vec<Landing>,
    pub(super) stats: Vec<StepStats>,
    pub(super) repeated_steps: usize,
    /// Pruned gaussians of the sparse map that have not been reported.
    pub(super) removed: Vec<SparseId>,
    /// The map as the host last knew it, for when the device is lost.
    pub(super) last_known: Gaussians,
}

/// A registered view.
pub(super) struct TrainingView {
    pub(super) view: View,
    pub(super) target: Target,
    /// Number of its set of gaussians.
    pub(super) set: u32,
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
            free_sets: (0..buffers.sets() as u32).collect(),
            device,
            settings,
            buffers,
            count: 0,
            views: BTreeMap::new(),
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

    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> Result<(), GpuError> {
        let buffer = self.buffers.get(name)?;
        self.device.queue().write_buffer(buffer, 0, bytes);
        Ok(())
    }
}

impl GaussianModel for GpuModel {
    fn len(&self) -> usize {
        self.count
    }

    fn add_view(&mut self, id: KeyframeId, view: View, target: Target) -> Result<(), ModelError> {
        check_view(self.views.contains_key(&id), id, &view, &target)?;
        self.finish_steps()?;
        let set = match self.free_sets.pop_first() {
            Some(set) => set,
            None => {
                let set = self.buffers.sets() as u32;
                self.buffers.double_sets()?;
                self.free_sets.extend(set + 1..self.buffers.sets() as u32);
                set
            }
        };
        self.views.insert(id, TrainingView { view, target, set });
        if let Err(error) = self.see_again(id) {
            self.drop_view(id)?;
            return Err(error);
        }
        Ok(())
    }

    fn drop_view(&mut self, id: KeyframeId) -> Result<(), ModelError> {
        self.finish_steps()?;
        let dropped = self.views.remove(&id).ok_or(ModelError::NoSuchView(id))?;
        self.free_sets.insert(dropped.set);
        self.targets.remove(id);
        Ok(())
    }

    fn insert(&mut self, seeds: &Seeds, anchor: KeyframeId) -> Result<(), ModelError> {
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
        let mut encoder = self.device.encoder();
        for moments in ["first_moments", "second_moments"] {
            encoder.clear_buffer(self.buffers.get(moments)?, start, Some(bytes));
        }
        self.device.queue().submit([encoder.finish()]);
        let rows = to_device(seeds);
        let gaussians = self.buffers.get("gaussians")?;
        let queue = self.device.queue();
        queue.write_buffer(gaussians, start, bytemuck::cast_slice(&rows));
        let (anchors, start) = (vec![anchor.0; added], 4 * self.count as u64);
        let buffer = self.buffers.get("anchors")?;
        queue.write_buffer(buffer, start, bytemuck::cast_slice(&anchors));
        self.count = count;
        Ok(self.device.check()?)
    }

    fn move_anchored(&mut self, moves: &[(KeyframeId, Se3)]) -> Result<(), ModelError> {
        let motions = by_keyframe(moves)?;
        for (id, training) in &mut self.views {
            if let Some(motion) = motions.get(id) {
                training.view = moved(&training.view, motion);
            }
        }
        if !motions.is_empty() {
            self.submit_move(motions_to_device(&motions))?;
        }
        Ok(())
    }

    fn prune(&mut self, rule: &PruneRule) -> Result<(), ModelError> {
        self.finish_steps()?;
        Ok(self.remove(rule)?)
    }

    fn render(&mut self, view: &View) -> Result<Rendered, ModelError> {
        self.finish_steps()?;
        let (width, height) = (view.camera.width, view.camera.height);
        self.buffers.make_room_for_image(width, height)?;
        self.run_to_the_end(&self.view_uniform(view), None)?;
        let pixels = width * height;
        let (shown, states): (Vec<[f32; 4]>, Vec<layout::PixelState>) = read_both(
            &self.device,
            (self.buffers.get("rendered")?, 0, pixels),
            (self.buffers.get("pixel_states")?, 0, pixels),
        )?;
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

    fn see_through(&mut self, view: &View, min_alpha: f32) -> Result<Image<bool>, ModelError> {
        let rendered = self.render(view)?;
        Ok(rendered.alpha.map(|alpha| *alpha < min_alpha))
    }

    fn step(&mut self, id: KeyframeId) -> Result<(), ModelError> {
        if self.in_flight.len() >= MAX_IN_FLIGHT {
            self.retire()?;
        }
        self.submit_step(id, &self.view_of(id)?, None)
    }

    fn take_stats(&mut self) -> Vec<StepStats> {
        std::mem::take(&mut self.stats)
    }

    fn covisibility(&mut self, id: KeyframeId) -> Result<Vec<(KeyframeId, f32)>, ModelError> {
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

    fn take_removed(&mut self) -> Result<Vec<SparseId>, ModelError> {
        let mut removed = std::mem::take(&mut self.removed);
        removed.sort_unstable();
        Ok(removed)
    }

    fn gaussians(&mut self) -> Result<Gaussians, ModelError> {
        self.finish_steps()?;
        Ok(from_device(&self.read_gaussians()?))
    }

    fn device_bytes(&self) -> u64 {
        self.buffers.bytes() + self.targets.bytes()
    }

    fn into_gaussians(mut self: Box<Self>) -> Gaussians {
        // What a step has found wrong is no reason to lose what the others did.
        let _ = self.finish_steps();
        match self.read_gaussians() {
            Ok(rows) => from_device(&rows),
            Err(_) => self.last_known,
        }
    }
}
