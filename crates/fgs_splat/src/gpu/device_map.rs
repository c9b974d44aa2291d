//! The map on the device: gaussians with their anchors and Adam's moments, and the operations on
//! them other than steps: insertion, rigid motion and pruning.
//!
//! Motions and prunings submitted after a step that turns out to be void are void too; `work_queue`
//! resubmits them.

use fgs_geom::{Image, KeyframeId, View};

use super::buffers::Buffers;
use super::device::GpuDevice;
use super::layout::{self, Count, Gaussian, INFERRED, NONE};
use super::parameters::{
    from_device, moments_from_device, moments_to_device, sparse_ids_from_device, to_device,
};
use super::passes::{groups, view_uniform, workgroups};
use super::readback::{Arrival, Landing, read};
use super::recorder::{Groups, Recorder};
use super::timer::StageTimer;
use crate::adam::Corrections;
use crate::model::{ModelSettings, PruneRule, Seeds, SparseId};
use crate::{Adam, Gaussians, GpuError, SavedModel};

/// Gaussians on a device.
pub struct DeviceMap {
    device: GpuDevice,
    pub buffers: Buffers,
    count: usize,
}

/// The readbacks of a submitted pruning.
pub struct Pruning {
    /// The counts, then the sparse ids of the removed gaussians.
    removed: Arrival,
    /// The surviving gaussians, then the removed ones.
    gaussians: Arrival,
}

impl DeviceMap {
    /// An empty map; the tile lists have an initial capacity of `entries`.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn new(
        device: GpuDevice,
        settings: &ModelSettings,
        entries: usize,
    ) -> Result<Self, GpuError> {
        let mut map = Self {
            buffers: Buffers::new(&device, entries)?,
            device,
            count: 0,
        };
        let rates = &settings.learning_rates;
        let optimizer = layout::Optimizer {
            means: rates.means,
            quats: rates.quats,
            log_scales: rates.log_scales,
            opacity_logits: rates.opacity_logits,
            sh: rates.sh,
            scale_weight: settings.loss.scale_weight,
        };
        map.write("optimizer", bytemuck::bytes_of(&optimizer))?;
        let corrections: Vec<[f32; 2]> = Corrections::table()
            .iter()
            .map(|correction| [correction.first, correction.second_root])
            .collect();
        let corrections = map.device.buffer_of("corrections", &corrections);
        map.buffers.set("corrections", corrections);
        Ok(map)
    }

    /// The device that holds the map.
    pub fn device(&self) -> &GpuDevice {
        &self.device
    }

    /// Number of gaussians, including those that work in flight prunes.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Overwrites the start of a buffer.
    ///
    /// # Errors
    /// If there is no such buffer.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), GpuError> {
        let buffer = self.buffers.get(name)?;
        self.device.queue().write_buffer(buffer, 0, bytes);
        Ok(())
    }

    /// Starts recording commands on the map's buffers.
    pub fn recorder<'a>(&'a mut self, timer: Option<&'a mut StageTimer>) -> Recorder<'a> {
        Recorder::new(&self.device, &mut self.buffers, timer)
    }

    /// Adds gaussians; the seeds' arrays must have equal lengths. Nothing may be in flight.
    ///
    /// # Errors
    /// If the device fails or is out of memory.
    pub fn insert(&mut self, seeds: &Seeds, anchor: KeyframeId) -> Result<(), GpuError> {
        let added = seeds.sparse_ids.len();
        let count = self.count + added;
        self.buffers.make_room_for_gaussians(count, self.count)?;
        let row = size_of::<Gaussian>() as u64;
        let (start, bytes) = (row * self.count as u64, row * added as u64);
        let mut encoder = self.device.encoder();
        for moments in ["first_moments", "second_moments"] {
            encoder.clear_buffer(self.buffers.get(moments)?, start, Some(bytes));
        }
        let queue = self.device.queue();
        queue.submit([encoder.finish()]);
        let (rows, anchors) = (to_device(seeds), vec![anchor.0; added]);
        let gaussians = self.buffers.get("gaussians")?;
        queue.write_buffer(gaussians, start, bytemuck::cast_slice(&rows));
        let start = size_of::<u32>() as u64 * self.count as u64;
        let buffer = self.buffers.get("anchors")?;
        queue.write_buffer(buffer, start, bytemuck::cast_slice(&anchors));
        self.count = count;
        self.device.check()
    }

    /// Submits motions, sorted by anchor.
    ///
    /// # Errors
    /// If the device fails.
    pub fn move_anchored(&mut self, motions: &[layout::Motion]) -> Result<(), GpuError> {
        self.device.check()?;
        let buffer = self.device.buffer_of("motions", motions);
        self.buffers.replace("motions", buffer);
        let by_gaussian = groups(self.count);
        let mut recorder = self.recorder(None);
        recorder.run("move_anchored", by_gaussian)?;
        recorder.submit();
        Ok(())
    }

    /// Hides or fades the gaussians that a depth image of the view's size contradicts. Nothing may be
    /// in flight.
    ///
    /// # Errors
    /// If the device fails.
    pub fn fade_contradicted(&mut self, view: &View, depth_m: &Image<f32>) -> Result<(), GpuError> {
        let uniform = view_uniform(view, self.count, self.buffers.entries());
        self.write("view", bytemuck::bytes_of(&uniform))?;
        let buffer = self.device.buffer_of("depth_m", depth_m.data());
        self.buffers.replace("depth_m", buffer);
        let by_gaussian = groups(self.count);
        let mut recorder = self.recorder(None);
        recorder.run("fade_contradicted", by_gaussian)?;
        recorder.submit();
        self.device.check()
    }

    /// Submits a pruning. Survivors are compacted to the front; the removed gaussians stay behind
    /// them, never drawn, until [`DeviceMap::finish_pruning`] learns how many survived.
    ///
    /// # Errors
    /// If the device fails or is out of memory.
    pub fn prune(&mut self, rule: &PruneRule) -> Result<Pruning, GpuError> {
        self.device.check()?;
        let rule = layout::Prune {
            count: self.count as u32,
            set_words: self.buffers.set_words() as u32,
            min_opacity: rule.min_opacity,
            max_log_scale: rule.max_scale_m.ln(),
            max_log_aspect: rule.max_aspect.ln(),
        };
        self.write("rule", bytemuck::bytes_of(&rule))?;
        self.compact()?;

        let id_bytes = 4 * self.count as u64;
        let count_bytes = 4 * Count::ALL.len() as u64;
        let gaussian_bytes = (size_of::<Gaussian>() * self.count) as u64;
        let removed = Landing::new(&self.device, count_bytes + id_bytes)?;
        let gaussians = Landing::new(&self.device, gaussian_bytes)?;
        let mut encoder = self.device.encoder();
        for (buffer, landing, at, bytes) in [
            ("counts", &removed, 0, count_bytes),
            ("order", &removed, count_bytes, id_bytes),
            ("gaussians", &gaussians, 0, gaussian_bytes),
        ] {
            let buffer = self.buffers.get(buffer)?;
            encoder.copy_buffer_to_buffer(buffer, 0, landing.buffer(), at, bytes);
        }
        let submission = self.device.queue().submit([encoder.finish()]);
        Ok(Pruning {
            removed: removed.expect(submission.clone()),
            gaussians: gaussians.expect(submission),
        })
    }

    /// Waits for a pruning that took effect and drops the removed gaussians. Returns the ids of those
    /// that belonged to the sparse map, and all survivors.
    ///
    /// # Errors
    /// If the device fails.
    pub fn finish_pruning(
        &mut self,
        pruning: Pruning,
    ) -> Result<(Vec<SparseId>, Gaussians), GpuError> {
        let (words, _) = pruning
            .removed
            .take(&self.device, bytemuck::pod_collect_to_vec::<u8, u32>)?;
        let (counts, ids) = words.split_at(Count::ALL.len());
        let kept = counts[Count::KEPT as usize] as usize;
        let ids = ids[..ids.len() - kept].iter();
        let removed = ids.filter(|id| ![NONE, INFERRED].contains(id));
        let (rows, _) = pruning
            .gaussians
            .take(&self.device, bytemuck::pod_collect_to_vec::<u8, Gaussian>)?;
        self.count = kept;
        Ok((
            removed.map(|id| SparseId(*id)).collect(),
            from_device(&rows[..kept]),
        ))
    }

    /// Makes gaussians' opacities NaN, so that any pruning takes them. Nothing may be in flight.
    ///
    /// # Errors
    /// If the device fails.
    pub fn mark_unwanted(&self, unwanted: &[usize]) -> Result<(), GpuError> {
        let mut rows: Vec<Gaussian> = self.read_all("gaussians")?;
        for i in unwanted {
            if let Some(row) = rows.get_mut(*i) {
                row.opacity_logit = f32::NAN;
            }
        }
        self.write("gaussians", bytemuck::cast_slice(&rows))
    }

    /// Waits for a void pruning.
    ///
    /// # Errors
    /// If the device fails.
    pub fn forget_pruning(&self, pruning: Pruning) -> Result<(), GpuError> {
        pruning.removed.take(&self.device, |_| ())?;
        pruning.gaussians.take(&self.device, |_| ())?;
        Ok(())
    }

    /// Records and submits the stable partition of the gaussians and all of their state.
    fn compact(&mut self) -> Result<(), GpuError> {
        const NEW_PLACES: (&str, &str) = ("new_from_old", "depth_keys");
        let by_gaussian = groups(self.count);
        let by_word = Groups::Fixed(
            workgroups(self.count.div_ceil(32)),
            self.buffers.sets() as u32,
        );
        let moved_sets = self.buffers.empty_sets()?;
        self.buffers.set("moved_sets", moved_sets);

        let mut recorder = self.recorder(None);
        recorder.run_as("count_survivors", 0, &[NEW_PLACES], by_gaussian)?;
        recorder.run("place_survivors", Groups::Fixed(1, 1))?;
        let aliases = [
            NEW_PLACES,
            ("moved_gaussians", "gradients"),
            ("moved_anchors", "in_view"),
            ("removed_ids", "order"),
        ];
        recorder.run_as("move_survivors", 0, &aliases, by_gaussian)?;
        recorder.run_as("move_sets", 0, &[NEW_PLACES], by_word)?;
        recorder.submit();
        self.buffers.swap("gaussians", "gradients");
        self.buffers.swap("anchors", "in_view");
        for moments in ["first_moments", "second_moments"] {
            let mut recorder = self.recorder(None);
            let aliases = [NEW_PLACES, ("rows", moments), ("moved_rows", "gradients")];
            recorder.run_as("move_rows", 0, &aliases, by_gaussian)?;
            recorder.submit();
            self.buffers.swap(moments, "gradients");
        }
        self.buffers.swap("visible_sets", "moved_sets");
        self.buffers.remove("moved_sets");
        Ok(())
    }

    /// Waits for the device and reads back all gaussians.
    ///
    /// # Errors
    /// If the device fails.
    pub fn gaussians(&self) -> Result<Gaussians, GpuError> {
        Ok(from_device(&self.read_all::<Gaussian>("gaussians")?))
    }

    /// Waits for the device and reads back the gaussians with all their state; there are no views in
    /// what is returned.
    ///
    /// # Errors
    /// If the device fails.
    pub fn save(&self) -> Result<SavedModel, GpuError> {
        let rows: Vec<Gaussian> = self.read_all("gaussians")?;
        let anchors: Vec<u32> = self.read_all("anchors")?;
        let moments = |name| -> Result<Vec<_>, GpuError> {
            let rows: Vec<[f32; 16]> = self.read_all(name)?;
            Ok(rows.iter().map(moments_from_device).collect())
        };
        Ok(SavedModel {
            gaussians: from_device(&rows),
            sparse_ids: sparse_ids_from_device(&rows),
            anchors: anchors.into_iter().map(KeyframeId).collect(),
            adam: Adam {
                first: moments("first_moments")?,
                second: moments("second_moments")?,
                steps: rows.iter().map(|row| row.steps).collect(),
            },
            ..SavedModel::default()
        })
    }

    /// Puts saved gaussians into an empty map. Nothing may be in flight.
    ///
    /// # Errors
    /// If the device fails or is out of memory.
    pub fn restore(&mut self, saved: &SavedModel) -> Result<(), GpuError> {
        let count = saved.sparse_ids.len();
        self.buffers.make_room_for_gaussians(count, 0)?;
        let mut rows = to_device(&Seeds {
            gaussians: saved.gaussians.clone(),
            sparse_ids: saved.sparse_ids.clone(),
        });
        for (row, steps) in rows.iter_mut().zip(&saved.adam.steps) {
            row.steps = *steps;
        }
        let anchors: Vec<u32> = saved.anchors.iter().map(|anchor| anchor.0).collect();
        self.write("gaussians", bytemuck::cast_slice(&rows))?;
        self.write("anchors", bytemuck::cast_slice(&anchors))?;
        for (name, moments) in [
            ("first_moments", &saved.adam.first),
            ("second_moments", &saved.adam.second),
        ] {
            let rows: Vec<[f32; 16]> = moments.iter().map(moments_to_device).collect();
            self.write(name, bytemuck::cast_slice(&rows))?;
        }
        self.count = count;
        self.device.check()
    }

    /// Waits for the device and reads back an entry for each gaussian.
    fn read_all<T: bytemuck::Pod>(&self, name: &str) -> Result<Vec<T>, GpuError> {
        read(&self.device, self.buffers.get(name)?, 0, self.count)
    }

    /// Zeroes the counts, and with them the overflow and out-of-range flags that void all later work.
    ///
    /// # Errors
    /// If there is no such buffer.
    pub fn clear_counts(&self) -> Result<(), GpuError> {
        self.write("counts", &[0; 4 * Count::ALL.len()])
    }

    /// Grows the tile lists to that many entries and a quarter more.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn make_room_for_entries(&mut self, entries: u32) -> Result<(), GpuError> {
        let entries = entries as usize;
        self.buffers.make_room_for_entries(entries + entries / 4)
    }
}
