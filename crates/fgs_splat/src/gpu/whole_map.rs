//! Passes over the whole map: pruning by compaction, and what has moved of the sparse map.

use super::error::GpuError;
use super::gpu_model::GpuModel;
use super::layout::{self, Count, Gaussian, NONE};
use super::parameters::from_device;
use super::passes::{groups, workgroups};
use super::readback::{read, read_both};
use super::recorder::{Groups, Recorder};
use crate::model::{PruneRule, SparseId};

/// Least number of moved sparse gaussians that are fetched unasked.
pub(super) const MIN_EXPECTED_MOVES: usize = 1024;

impl GpuModel {
    /// Removes gaussians; returns how many.
    pub(super) fn remove(&mut self, rule: &PruneRule) -> Result<usize, GpuError> {
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
        Ok(pruned)
    }

    /// The gaussians of the sparse map that steps touched since they were last taken, in their order.
    pub(super) fn take_moved(&mut self) -> Result<Vec<Gaussian>, GpuError> {
        let all = layout::Prune {
            count: self.count as u32,
            ..Default::default()
        };
        self.write("rule", bytemuck::bytes_of(&all))?;
        let by_gaussian = groups(self.count);
        let set_bytes = 4 * self.buffers.set_words() as u64;
        let mut recorder = Recorder::new(&self.device, &mut self.buffers, None);
        let aliases = [("moved_gaussians", "gradients")];
        recorder.run("count_moved", by_gaussian)?;
        recorder.run("place_kept", Groups::Fixed(1, 1))?;
        recorder.run_as("write_moved", 0, &aliases, by_gaussian)?;
        let sets = recorder.buffers.get("visible_sets")?.clone();
        recorder.encoder().clear_buffer(&sets, 0, Some(set_bytes));
        recorder.submit();
        // How many there are is known only with them: about as many as last time.
        let guess = self.expected_moves.min(self.count);
        let (counts, rows) = (self.buffers.get("counts")?, self.buffers.get("gradients")?);
        let (kept, mut moved): (Vec<u32>, Vec<Gaussian>) = read_both(
            &self.device,
            (counts, Count::KEPT as usize, 1),
            (rows, 0, guess),
        )?;
        let kept = kept[0] as usize;
        if kept > guess {
            moved.extend(read::<Gaussian>(&self.device, rows, guess, kept - guess)?);
        }
        moved.truncate(kept);
        self.expected_moves = kept + kept / 4 + MIN_EXPECTED_MOVES;
        Ok(moved)
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
        ];
        recorder.run_as("move_survivors", 0, &aliases, by_gaussian)?;
        recorder.run_as("move_sets", 0, &[NEW_PLACES], by_word)?;
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
