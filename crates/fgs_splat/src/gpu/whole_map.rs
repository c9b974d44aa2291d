//! Passes over the whole map: pruning by compaction, and rigid motions of keyframes' gaussians.

use super::error::GpuError;
use super::gpu_model::GpuModel;
use super::layout::{self, Count, Gaussian, NONE};
use super::parameters::from_device;
use super::passes::{groups, workgroups};
use super::readback::read;
use super::recorder::{Groups, Recorder};
use super::steps::InFlight;
use crate::model::{PruneRule, SparseId};

impl GpuModel {
    /// Removes the gaussians that the rule rejects.
    pub(super) fn remove(&mut self, rule: &PruneRule) -> Result<(), GpuError> {
        let rule = layout::Prune {
            count: self.count as u32,
            set_words: self.buffers.set_words() as u32,
            min_opacity: rule.min_opacity,
            max_log_scale: rule.max_scale_m.ln(),
            max_log_aspect: rule.max_aspect.ln(),
        };
        self.write("rule", bytemuck::bytes_of(&rule))?;
        let mut recorder = Recorder::new(&self.device, &mut self.buffers, None);
        recorder.run("count_survivors", groups(self.count))?;
        recorder.run("place_kept", Groups::Fixed(1, 1))?;
        recorder.submit();
        let pruned = self.count - self.read_counts()?[Count::KEPT as usize] as usize;
        if pruned > 0 {
            self.compact()?;
            let ids: Vec<u32> = read(&self.device, self.buffers.get("order")?, 0, pruned)?;
            let ids = ids.into_iter().filter(|id| *id != NONE);
            self.removed.extend(ids.map(SparseId));
            self.count -= pruned;
            self.last_known = from_device(&self.read_gaussians()?);
        }
        Ok(())
    }

    /// Moves the gaussians that the motions name, unless a step before this is void.
    pub(super) fn submit_move(&mut self, motions: Vec<layout::Motion>) -> Result<(), GpuError> {
        self.device.check()?;
        let buffer = self.device.buffer_of("motions", &motions);
        self.buffers.replace("motions", buffer);
        let mut recorder = Recorder::new(&self.device, &mut self.buffers, None);
        recorder.run("move_anchored", groups(self.count))?;
        recorder.submit();
        // With no step in flight, nothing can be void.
        if !self.in_flight.is_empty() {
            self.in_flight.push_back(InFlight::Move(motions));
        }
        Ok(())
    }

    pub(super) fn read_gaussians(&self) -> Result<Vec<Gaussian>, GpuError> {
        read(&self.device, self.buffers.get("gaussians")?, 0, self.count)
    }

    /// Moves the gaussians that survive together, and all that belongs to them.
    fn compact(&mut self) -> Result<(), GpuError> {
        const NEW_PLACES: (&str, &str) = ("new_from_old", "depth_keys");
        let by_gaussian = groups(self.count);
        let by_word = Groups::Fixed(
            workgroups(self.count.div_ceil(32)),
            self.buffers.sets() as u32,
        );
        let moved_sets = self.buffers.empty_sets()?;
        self.buffers.set("moved_sets", moved_sets);

        let mut recorder = Recorder::new(&self.device, &mut self.buffers, None);
        let aliases = [
            NEW_PLACES,
            ("moved_gaussians", "gradients"),
            ("removed_ids", "order"),
            ("moved_anchors", "in_view"),
        ];
        recorder.run_as("move_survivors", 0, &aliases, by_gaussian)?;
        recorder.run_as("move_sets", 0, &[NEW_PLACES], by_word)?;
        recorder.submit();
        self.buffers.swap("gaussians", "gradients");
        self.buffers.swap("anchors", "in_view");
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
