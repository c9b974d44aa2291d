//! Per-tile lists of gaussians in the order of blending.
//!
//! The visible gaussians are sorted once by depth (stable, so that ties keep the order of their
//! indices) and dealt out to their tiles in that order: each list comes out sorted. Sizes of
//! lists and their entries come from the same touches.

use std::ops::Range;

use super::bounds::{TileGrid, Touch};
use super::project::Splat;
use super::real::Real;

/// A gaussian with at least one touch.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Visible {
    pub depth_key: u64,
    pub gaussian: u32,
    /// The gaussian's touches end here; they start where the one before ends.
    pub touches_end: u32,
}

/// One entry of a tile's list.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Entry {
    pub gaussian: u32,
    pub blocks: u16,
}

/// Entries whose splats are loaded together, so that the waits for memory overlap: a tile's
/// gaussians lie anywhere.
pub(super) const BATCH: usize = 32;

/// Copies the splats of up to `BATCH` entries.
#[inline(always)]
pub(super) fn load_splats<T: Real>(
    entries: &[Entry],
    splats: &[Splat<T>],
    batch: &mut [Splat<T>; BATCH],
) {
    for (entry, splat) in entries.iter().zip(batch) {
        *splat = splats[entry.gaussian as usize];
    }
}

/// The lists of all tiles, one after the other.
#[derive(Debug, Default)]
pub(super) struct TileLists {
    pub entries: Vec<Entry>,
    /// Tile `t` has entries `starts[t]..starts[t + 1]`.
    pub starts: Vec<usize>,
    /// For each touch its position in `entries`.
    pub entry_from_touch: Vec<u32>,
    order: Vec<u32>,
    sort_scratch: Vec<(u64, u32)>,
    sorted: Vec<(u64, u32)>,
    cursors: Vec<usize>,
}

impl TileLists {
    /// Where a tile's list lies in `entries`.
    #[inline(always)]
    pub fn range(&self, tile: usize) -> Range<usize> {
        self.starts[tile]..self.starts[tile + 1]
    }

    /// A tile's list, nearest first.
    #[inline(always)]
    pub fn of_tile(&self, tile: usize) -> &[Entry] {
        &self.entries[self.range(tile)]
    }

    /// Fills the lists. `visible` ascends by gaussian, `touches` are theirs in that order.
    pub fn fill<T: Real>(&mut self, grid: &TileGrid, visible: &[Visible], touches: &[Touch]) {
        self.starts.clear();
        self.starts.resize(grid.len() + 1, 0);
        for touch in touches {
            self.starts[touch.tile as usize + 1] += 1;
        }
        for tile in 0..grid.len() {
            self.starts[tile + 1] += self.starts[tile];
        }
        self.cursors.clone_from(&self.starts);
        self.entries.resize(touches.len(), Entry::default());
        self.entry_from_touch.resize(touches.len(), 0);

        self.sort_by_depth::<T>(visible);
        for &index in &self.order {
            let index = index as usize;
            let first = match index {
                0 => 0,
                _ => visible[index - 1].touches_end as usize,
            };
            let Visible {
                gaussian,
                touches_end,
                ..
            } = visible[index];
            let range = first..touches_end as usize;
            for (touch, entry) in touches[range.clone()]
                .iter()
                .zip(&mut self.entry_from_touch[range])
            {
                let cursor = &mut self.cursors[touch.tile as usize];
                self.entries[*cursor] = Entry {
                    gaussian,
                    blocks: touch.blocks,
                };
                *entry = *cursor as u32;
                *cursor += 1;
            }
        }
    }

    /// Sets `order` to the positions in `visible` by ascending depth: a radix sort from the
    /// lowest digit, which is stable.
    fn sort_by_depth<T: Real>(&mut self, visible: &[Visible]) {
        /// Bits a pass: 2048 counters stay in the first-level cache.
        const DIGIT_BITS: u32 = 11;
        const DIGITS: usize = 1 << DIGIT_BITS;
        let keys = visible.iter().zip(0..);
        self.sorted.clear();
        self.sorted
            .extend(keys.map(|(visible, position)| (visible.depth_key, position)));
        self.sort_scratch.resize(visible.len(), (0, 0));
        for shift in (0..T::SORT_KEY_BITS).step_by(DIGIT_BITS as usize) {
            let digit = |key: u64| (key >> shift) as usize & (DIGITS - 1);
            let mut offsets = [0_usize; DIGITS];
            for &(key, _) in &self.sorted {
                offsets[digit(key)] += 1;
            }
            let mut sum = 0;
            for offset in &mut offsets {
                sum += std::mem::replace(offset, sum);
            }
            for &(key, position) in &self.sorted {
                let offset = &mut offsets[digit(key)];
                self.sort_scratch[*offset] = (key, position);
                *offset += 1;
            }
            std::mem::swap(&mut self.sorted, &mut self.sort_scratch);
        }
        self.order.clear();
        self.order
            .extend(self.sorted.iter().map(|&(_, position)| position));
    }
}
