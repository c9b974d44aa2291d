//! All device buffers of a model, by their names in the shaders, and the cached bind groups. Buffers
//! of one capacity grow together.
//!
//! Invariant: per-gaussian state (parameters, anchors, moments, visibility sets) survives growing;
//! everything else is scratch, which each pass writes before it reads.

use std::collections::BTreeMap;

use wgpu::BufferUsages;

use super::device::GpuDevice;
use super::layout::{
    Count, DISPATCH_WORDS, Dispatch, GROUP, Gaussian, Gradient, LOSS_SIDE, Loss, Optimizer,
    PixelState, Prune, SORT_BLOCK, SortPass, Splat, TILE, View,
};
use crate::GpuError;

/// Initial capacity, in visibility sets.
const FIRST_SETS: usize = 16;
/// Initial capacity, in gaussians.
const FIRST_GAUSSIANS: usize = 1 << 14;

/// Buffer names, with the bytes of one entry.
type Group = &'static [(&'static str, usize)];

const VEC4: usize = 16;
const WORD: usize = 4;

/// Per gaussian, persistent.
const KEPT: Group = &[
    ("gaussians", size_of::<Gaussian>()),
    ("first_moments", 4 * VEC4),
    ("second_moments", 4 * VEC4),
    ("anchors", WORD),
];
/// Per gaussian or splat, scratch.
const PER_GAUSSIAN: Group = &[
    ("splats", size_of::<Splat>()),
    ("gradients", size_of::<Gradient>()),
    ("in_view", WORD),
    ("gaussian_of", WORD),
    ("depth_keys", WORD),
    ("depth_keys_sorted", WORD),
    ("order", WORD),
    ("order_sorted", WORD),
    ("touches", 2 * WORD),
];
/// Per workgroup of the stages over gaussians or splats, scratch.
const PER_GROUP: Group = &[("block_sums", WORD), ("regularizer_sums", WORD)];
/// Per entry of the tile lists, scratch.
const PER_ENTRY: Group = &[
    ("tile_keys", WORD),
    ("tile_keys_sorted", WORD),
    ("slots", WORD),
    ("slots_sorted", WORD),
    ("slot_splats", WORD),
    ("sums", 4 * VEC4),
];
/// Per pixel, scratch.
const PER_PIXEL: Group = &[
    ("rendered", VEC4),
    ("pixel_states", size_of::<PixelState>()),
    ("cotangents", VEC4),
    ("d_alpha", WORD),
    ("moments", 9 * WORD),
];

/// The shaders' name for the current view's measured image.
const MEASURED: &str = "measured";

/// The passes of the two radix sorts; each has its own uniform.
pub const DEPTH_PASSES: [&str; 4] = ["depth_0", "depth_1", "depth_2", "depth_3"];
pub const TILE_PASSES: [&str; 4] = ["tile_0", "tile_1", "tile_2", "tile_3"];

/// Buffers by name, and the cached bind groups.
pub struct Buffers {
    device: GpuDevice,
    table: BTreeMap<&'static str, wgpu::Buffer>,
    /// Measured images by their view's visibility set; each is bound as `measured`.
    targets: BTreeMap<u32, wgpu::Buffer>,
    bound: BTreeMap<(&'static str, usize), wgpu::BindGroup>,
    gaussians: usize,
    entries: usize,
    pixels: usize,
    tiles: usize,
    loss_groups: usize,
    sets: usize,
}

impl Buffers {
    /// Buffers of initial size; the tile lists have a capacity of `entries`.
    ///
    /// # Errors
    /// If the device is out of memory or a buffer exceeds its limits.
    pub fn new(device: &GpuDevice, entries: usize) -> Result<Self, GpuError> {
        let mut buffers = Self {
            device: device.clone(),
            table: BTreeMap::new(),
            targets: BTreeMap::new(),
            bound: BTreeMap::new(),
            gaussians: 0,
            entries: 0,
            pixels: 0,
            tiles: 0,
            loss_groups: 0,
            sets: 0,
        };
        for (name, bytes) in [
            ("view", size_of::<View>()),
            ("loss", size_of::<Loss>()),
            ("optimizer", size_of::<Optimizer>()),
            ("rule", size_of::<Prune>()),
            ("covisibility_", size_of::<super::layout::Covisibility>()),
            ("see_through_", size_of::<super::layout::SeeThrough>()),
        ] {
            buffers.make(name, bytes, BufferUsages::UNIFORM)?;
        }
        let storage = BufferUsages::STORAGE;
        buffers.make("counts", WORD * Count::ALL.len(), storage)?;
        let dispatch_bytes = WORD * DISPATCH_WORDS as usize * Dispatch::ALL.len();
        buffers.make(
            "dispatches",
            dispatch_bytes,
            storage | BufferUsages::INDIRECT,
        )?;
        buffers.make("digit_totals", WORD * GROUP as usize, storage)?;
        for (names, count) in [
            (DEPTH_PASSES, Count::VISIBLE),
            (TILE_PASSES, Count::ENTRIES),
        ] {
            for (pass, name) in (0..).zip(names) {
                let pass = SortPass {
                    shift: 8 * pass,
                    count: count as u32,
                };
                let buffer = device.buffer_of(name, &[pass]);
                buffers.table.insert(name, buffer);
            }
        }
        buffers.make_sets(FIRST_SETS, 0)?;
        buffers.make_room_for_gaussians(FIRST_GAUSSIANS, 0)?;
        buffers.make_room_for_entries(entries)?;
        Ok(buffers)
    }

    /// Capacity of the tile lists, entries.
    pub fn entries(&self) -> usize {
        self.entries
    }

    /// Pretends that the capacity is smaller.
    #[cfg(test)]
    pub fn shrink_entries(&mut self, entries: usize) {
        self.entries = self.entries.min(entries);
    }

    /// Number of visibility sets there is room for.
    pub fn sets(&self) -> usize {
        self.sets
    }

    /// Words of each visibility set.
    pub fn set_words(&self) -> usize {
        self.gaussians / 32
    }

    /// Total size, bytes.
    pub fn bytes(&self) -> u64 {
        let own: u64 = self.table.values().map(wgpu::Buffer::size).sum();
        own + self.target_bytes()
    }

    /// Size of the measured images, bytes.
    pub fn target_bytes(&self) -> u64 {
        self.targets.values().map(wgpu::Buffer::size).sum()
    }

    /// Stores the measured image of the view with this visibility set.
    pub fn set_target(&mut self, set: u32, buffer: wgpu::Buffer) {
        self.remove_target(set);
        self.targets.insert(set, buffer);
    }

    /// Frees a measured image and drops the bind groups that use it.
    pub fn remove_target(&mut self, set: u32) {
        self.targets.remove(&set);
        let device = &self.device;
        self.bound.retain(|(stage, variant), _| {
            *variant != set as usize || device.stage(stage).is_ok_and(|stage| !stage.uses(MEASURED))
        });
    }

    /// The measured images and the cached bind groups.
    #[cfg(test)]
    pub fn resident(&self) -> (Vec<wgpu::Buffer>, Vec<wgpu::BindGroup>) {
        let targets = self.targets.values().cloned().collect();
        (targets, self.bound.values().cloned().collect())
    }

    /// The buffer of that name, or an error.
    pub fn get(&self, name: &str) -> Result<&wgpu::Buffer, GpuError> {
        let found = self.table.get(name);
        found.ok_or_else(|| GpuError::Other(format!("there is no buffer {name}")))
    }

    /// Replaces a buffer and drops all bind groups.
    pub fn set(&mut self, name: &'static str, buffer: wgpu::Buffer) {
        self.table.insert(name, buffer);
        self.bound.clear();
    }

    /// Replaces a buffer that is never bound through an alias; drops only the bind groups that use it.
    pub fn replace(&mut self, name: &'static str, buffer: wgpu::Buffer) {
        self.table.insert(name, buffer);
        let device = &self.device;
        self.bound
            .retain(|(stage, _), _| device.stage(stage).is_ok_and(|stage| !stage.uses(name)));
    }

    /// Frees a buffer.
    pub fn remove(&mut self, name: &'static str) {
        self.table.remove(name);
        self.bound.clear();
    }

    /// Swaps two buffers.
    pub fn swap(&mut self, a: &'static str, b: &'static str) {
        if let (Some(old_a), Some(old_b)) = (self.table.remove(a), self.table.remove(b)) {
            self.table.insert(a, old_b);
            self.table.insert(b, old_a);
        }
        self.bound.clear();
    }

    /// A stage's bind group, created once and cached. `aliases` maps names in the shader to names of
    /// buffers; `variant` tells apart the bind groups of a stage that is used with several lists of
    /// aliases. For a stage that binds `measured` it is the visibility set of the image's view.
    ///
    /// # Errors
    /// If a buffer is missing.
    pub fn bind(
        &mut self,
        stage: &'static str,
        variant: usize,
        aliases: &[(&str, &str)],
    ) -> Result<&wgpu::BindGroup, GpuError> {
        let key = (stage, variant);
        if !self.bound.contains_key(&key) {
            let resolve = |name: &str| {
                if name == MEASURED {
                    let target = self.targets.get(&(variant as u32));
                    return target
                        .ok_or_else(|| GpuError::Other("a measured image is missing".into()));
                }
                let alias = aliases.iter().find(|(from, _)| *from == name);
                let name = alias.map_or(name, |(_, to)| to);
                self.get(name)
            };
            let group = self.device.stage(stage)?.bind(self.device.raw(), resolve)?;
            self.bound.insert(key, group);
        }
        Ok(&self.bound[&key])
    }

    /// Makes room for that many gaussians; the state of the first `used` is preserved.
    ///
    /// # Errors
    /// If the device is out of memory or its limits are exceeded; then nothing has changed.
    pub fn make_room_for_gaussians(&mut self, count: usize, used: usize) -> Result<(), GpuError> {
        if count <= self.gaussians {
            return Ok(());
        }
        // A multiple of GROUP: whole workgroups, and whole words of sets.
        let room = self.grown(size_of::<Gaussian>(), GROUP, count, self.gaussians)?;
        let mut fresh = self.make_all(KEPT.iter().chain(PER_GAUSSIAN), room)?;
        fresh.extend(self.make_all(PER_GROUP.iter(), room / GROUP as usize)?);
        fresh.extend(self.make_digit_counts(room.max(self.entries))?);
        let sets = self.new_sets(self.sets, room / 32)?;
        let mut encoder = self.device.encoder();
        for (name, bytes) in KEPT {
            if let Some(old) = self.table.get(name) {
                encoder.copy_buffer_to_buffer(old, 0, &fresh[name], 0, (used * bytes) as u64);
            }
        }
        let words = used.div_ceil(32);
        if let (Some(old), true) = (self.table.get("visible_sets"), words > 0) {
            for set in 0..self.sets {
                let (from, to) = (set * self.set_words(), set * room / 32);
                let [from, to, len] = [from, to, words].map(|words| (WORD * words) as u64);
                encoder.copy_buffer_to_buffer(old, from, &sets, to, len);
            }
        }
        self.device.queue().submit([encoder.finish()]);
        self.table.extend(fresh);
        self.table.insert("visible_sets", sets);
        self.gaussians = room;
        self.bound.clear();
        Ok(())
    }

    /// Makes room for that many entries of the tile lists; their contents are lost.
    ///
    /// # Errors
    /// If the device is out of memory or its limits are exceeded; then nothing has changed.
    pub fn make_room_for_entries(&mut self, count: usize) -> Result<(), GpuError> {
        if count <= self.entries {
            return Ok(());
        }
        let room = self.grown(4 * VEC4, SORT_BLOCK, count, self.entries)?;
        let mut fresh = self.make_all(PER_ENTRY.iter(), room)?;
        fresh.extend(self.make_digit_counts(room.max(self.gaussians))?);
        self.table.extend(fresh);
        self.entries = room;
        self.bound.clear();
        Ok(())
    }

    /// Makes room for images of that size, pixels.
    ///
    /// # Errors
    /// If the device is out of memory or its limits are exceeded.
    pub fn make_room_for_image(&mut self, width: usize, height: usize) -> Result<(), GpuError> {
        let cells = |side: u32| width.div_ceil(side as usize) * height.div_ceil(side as usize);
        let (pixels, tiles, loss_groups) = (width * height, cells(TILE), cells(LOSS_SIDE));
        if pixels > self.pixels {
            let fresh = self.make_all(PER_PIXEL.iter(), pixels)?;
            self.table.extend(fresh);
            let bytes = WORD * pixels.div_ceil(32);
            self.make("see_through_words", bytes, BufferUsages::STORAGE)?;
            self.pixels = pixels;
            self.bound.clear();
        }
        if tiles > self.tiles {
            self.make("ranges", 2 * WORD * tiles, BufferUsages::STORAGE)?;
            self.tiles = tiles;
        }
        if loss_groups > self.loss_groups {
            self.make("loss_sums", 3 * WORD * loss_groups, BufferUsages::STORAGE)?;
            self.loss_groups = loss_groups;
        }
        Ok(())
    }

    /// Doubles the number of visibility sets.
    ///
    /// # Errors
    /// If the device is out of memory or its limits are exceeded.
    pub fn double_sets(&mut self) -> Result<(), GpuError> {
        self.make_sets(2 * self.sets, self.sets)
    }

    /// A buffer of empty visibility sets, laid out as the present ones.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn empty_sets(&self) -> Result<wgpu::Buffer, GpuError> {
        self.new_sets(self.sets, self.set_words())
    }

    fn make_sets(&mut self, sets: usize, used: usize) -> Result<(), GpuError> {
        let fresh = self.new_sets(sets, self.set_words())?;
        self.make("overlaps", WORD * sets, BufferUsages::STORAGE)?;
        if let (Some(old), true) = (self.table.get("visible_sets"), used > 0) {
            let mut encoder = self.device.encoder();
            let bytes = (WORD * used * self.set_words()) as u64;
            encoder.copy_buffer_to_buffer(old, 0, &fresh, 0, bytes);
            self.device.queue().submit([encoder.finish()]);
        }
        self.set("visible_sets", fresh);
        self.sets = sets;
        Ok(())
    }

    fn new_sets(&self, sets: usize, words: usize) -> Result<wgpu::Buffer, GpuError> {
        let bytes = (WORD * sets * words) as u64;
        self.device
            .buffer("sets of visible gaussians", bytes, BufferUsages::STORAGE)
    }

    /// The radix sort's digit counts for that many keys.
    fn make_digit_counts(
        &self,
        keys: usize,
    ) -> Result<BTreeMap<&'static str, wgpu::Buffer>, GpuError> {
        let blocks = keys.div_ceil(SORT_BLOCK as usize);
        let per_block = [("digit_counts", WORD * GROUP as usize)];
        self.make_all(per_block.iter(), blocks)
    }

    /// The capacity to grow to, in items of `bytes` bytes: one and a half times `before` within the
    /// device's limits, but at least `needed`, and a multiple of `group`.
    ///
    /// # Errors
    /// If `needed` takes more workgroups than the device can dispatch.
    fn grown(
        &self,
        bytes: usize,
        group: u32,
        needed: usize,
        before: usize,
    ) -> Result<usize, GpuError> {
        let limits = self.device.raw().limits();
        let (group, groups) = (group as usize, limits.max_compute_workgroups_per_dimension);
        let most = group.saturating_mul(groups as usize);
        if needed > most {
            let message = format!("a dispatch covers at most {most} items, but there are {needed}");
            return Err(GpuError::Other(message));
        }
        let limit = self.device.binding_limit();
        let bound = usize::try_from(limit).unwrap_or(usize::MAX) / bytes / group * group;
        let room = (before + before / 2).min(bound).min(most).max(needed);
        Ok(room.next_multiple_of(group))
    }

    fn make_all<'a>(
        &self,
        group: impl Iterator<Item = &'a (&'static str, usize)>,
        count: usize,
    ) -> Result<BTreeMap<&'static str, wgpu::Buffer>, GpuError> {
        let make = |&(name, bytes): &(&'static str, usize)| {
            let bytes = (bytes * count) as u64;
            Ok((
                name,
                self.device.buffer(name, bytes, BufferUsages::STORAGE)?,
            ))
        };
        group.map(make).collect()
    }

    fn make(
        &mut self,
        name: &'static str,
        bytes: usize,
        usage: BufferUsages,
    ) -> Result<(), GpuError> {
        let buffer = self.device.buffer(name, bytes as u64, usage)?;
        self.set(name, buffer);
        Ok(())
    }
}
