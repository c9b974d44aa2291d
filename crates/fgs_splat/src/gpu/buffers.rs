//! The memory of a model on its device: buffers found by the names that the shaders give them, each
//! group growing when it must.
//!
//! Invariant: what belongs to gaussians (parameters, moments, sets) survives growing; the rest is
//! written anew by each pass before it is read.

use std::collections::BTreeMap;

use wgpu::BufferUsages;

use super::device::GpuDevice;
use super::layout::{
    Count, DISPATCH_WORDS, Dispatch, GROUP, Gaussian, Gradient, LOSS_SIDE, Loss, Optimizer,
    PixelState, Prune, SORT_BLOCK, SortPass, Splat, TILE, View,
};
use crate::GpuError;

/// Sets of gaussians to begin with.
const FIRST_SETS: usize = 16;
/// Gaussians to begin with.
const FIRST_GAUSSIANS: usize = 1 << 14;

/// Names and bytes of an entry.
type Group = &'static [(&'static str, usize)];

const VEC4: usize = 16;
const WORD: usize = 4;

/// By gaussian, to be kept.
const KEPT: Group = &[
    ("gaussians", size_of::<Gaussian>()),
    ("first_moments", 4 * VEC4),
    ("second_moments", 4 * VEC4),
    ("anchors", WORD),
];
/// By gaussian or splat, of one pass.
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
/// By workgroup that goes over gaussians or splats.
const PER_GROUP: Group = &[("block_sums", WORD), ("regularizer_sums", WORD)];
/// By entry of the tiles' lists.
const PER_ENTRY: Group = &[
    ("tile_keys", WORD),
    ("tile_keys_sorted", WORD),
    ("slots", WORD),
    ("slots_sorted", WORD),
    ("slot_splats", WORD),
    ("sums", 4 * VEC4),
];
const PER_PIXEL: Group = &[
    ("rendered", VEC4),
    ("pixel_states", size_of::<PixelState>()),
    ("cotangents", VEC4),
    ("d_alpha", WORD),
    ("moments", 9 * WORD),
];

/// What shaders call the measured image of the view that they work for.
const MEASURED: &str = "measured";

/// The passes of the two sorts, each with a uniform of its own.
pub const DEPTH_PASSES: [&str; 4] = ["depth_0", "depth_1", "depth_2", "depth_3"];
pub const TILE_PASSES: [&str; 4] = ["tile_0", "tile_1", "tile_2", "tile_3"];

/// Buffers by name, and the stages' bindings to them.
pub struct Buffers {
    device: GpuDevice,
    table: BTreeMap<&'static str, wgpu::Buffer>,
    /// Measured images, by the set of their view. To shaders each is `measured`.
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
    /// With room for that many entries of the tiles' lists.
    ///
    /// # Errors
    /// If the device's memory does not suffice.
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

    /// Entries that the tiles' lists have room for.
    pub fn entries(&self) -> usize {
        self.entries
    }

    /// Counts on so much room only.
    #[cfg(test)]
    pub fn shrink_entries(&mut self, entries: usize) {
        self.entries = self.entries.min(entries);
    }

    /// Sets that there is room for.
    pub fn sets(&self) -> usize {
        self.sets
    }

    /// Words of each set.
    pub fn set_words(&self) -> usize {
        self.gaussians / 32
    }

    /// All bytes.
    pub fn bytes(&self) -> u64 {
        let own: u64 = self.table.values().map(wgpu::Buffer::size).sum();
        own + self.target_bytes()
    }

    /// Bytes of the measured images.
    pub fn target_bytes(&self) -> u64 {
        self.targets.values().map(wgpu::Buffer::size).sum()
    }

    /// Keeps the measured image of the view that has this set.
    pub fn set_target(&mut self, set: u32, buffer: wgpu::Buffer) {
        self.remove_target(set);
        self.targets.insert(set, buffer);
    }

    /// Gives the memory of a measured image back.
    pub fn remove_target(&mut self, set: u32) {
        self.targets.remove(&set);
        let device = &self.device;
        self.bound.retain(|(stage, variant), _| {
            *variant != set as usize || device.stage(stage).is_ok_and(|stage| !stage.uses(MEASURED))
        });
    }

    /// The measured images and all bindings there are.
    #[cfg(test)]
    pub fn resident(&self) -> (Vec<wgpu::Buffer>, Vec<wgpu::BindGroup>) {
        let targets = self.targets.values().cloned().collect();
        (targets, self.bound.values().cloned().collect())
    }

    /// The buffer of that name.
    pub fn get(&self, name: &str) -> Result<&wgpu::Buffer, GpuError> {
        let found = self.table.get(name);
        found.ok_or_else(|| GpuError::Other(format!("there is no buffer {name}")))
    }

    /// Puts a buffer in place of another.
    pub fn set(&mut self, name: &'static str, buffer: wgpu::Buffer) {
        self.table.insert(name, buffer);
        self.bound.clear();
    }

    /// Puts a buffer in place of another that stages know by no other name.
    pub fn replace(&mut self, name: &'static str, buffer: wgpu::Buffer) {
        self.table.insert(name, buffer);
        let device = &self.device;
        self.bound
            .retain(|(stage, _), _| device.stage(stage).is_ok_and(|stage| !stage.uses(name)));
    }

    /// Gives a buffer's memory back.
    pub fn remove(&mut self, name: &'static str) {
        self.table.remove(name);
        self.bound.clear();
    }

    /// Exchanges two buffers.
    pub fn swap(&mut self, a: &'static str, b: &'static str) {
        if let (Some(old_a), Some(old_b)) = (self.table.remove(a), self.table.remove(b)) {
            self.table.insert(a, old_b);
            self.table.insert(b, old_a);
        }
        self.bound.clear();
    }

    /// A stage's bindings. Names of the shader that are no buffer's are looked up in `aliases`
    /// first; `variant` tells apart what one stage is bound to with different ones. To a stage that
    /// compares with a measured image it is the set of the image's view.
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

    /// Room for that many gaussians, of which the first `used` are kept.
    ///
    /// # Errors
    /// If the device's memory does not suffice; then nothing has changed.
    pub fn make_room_for_gaussians(&mut self, count: usize, used: usize) -> Result<(), GpuError> {
        if count <= self.gaussians {
            return Ok(());
        }
        // Whole words of sets, and whole workgroups.
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

    /// Room for that many entries of the tiles' lists.
    ///
    /// # Errors
    /// If the device's memory does not suffice; then nothing has changed.
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

    /// Room for images of that size.
    ///
    /// # Errors
    /// If the device's memory does not suffice.
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

    /// Room for twice as many sets.
    ///
    /// # Errors
    /// If the device's memory does not suffice.
    pub fn double_sets(&mut self) -> Result<(), GpuError> {
        self.make_sets(2 * self.sets, self.sets)
    }

    /// Sets in the layout of those there are, all empty.
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

    /// For sorting so many keys.
    fn make_digit_counts(
        &self,
        keys: usize,
    ) -> Result<BTreeMap<&'static str, wgpu::Buffer>, GpuError> {
        let blocks = keys.div_ceil(SORT_BLOCK as usize);
        let per_block = [("digit_counts", WORD * GROUP as usize)];
        self.make_all(per_block.iter(), blocks)
    }

    /// Half as much again as there was, if the device binds so much, and no less than needed: whole
    /// workgroups of `group` items of so many bytes.
    ///
    /// # Errors
    /// If more workgroups are needed than the device dispatches.
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
            let message = format!("it works on no more than {most} items, and there are {needed}");
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
