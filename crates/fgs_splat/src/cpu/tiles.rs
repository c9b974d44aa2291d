//! Per-tile lists of gaussians in the order of blending.
//!
//! The touches are dealt out to their tiles in the order of the gaussians, then each tile sorts
//! its own list by depth, equally near ones by the order of the gaussians. Sizes of lists and their
//! entries come from the same touches.

use super::bounds::TileGrid;
use super::chunks::{CHUNK, Chunk};
use super::prefetch::prefetch;
use super::project::Splat;
use super::real::Real;

/// A gaussian's presence in a tile.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Entry {
    /// Position among the splats.
    pub splat: u32,
    pub blocks: u16,
    /// Whether a pixel took it.
    pub contributed: bool,
}

/// The lists of all tiles, one after the other: tile `t` has places `starts[t]..starts[t + 1]`.
#[derive(Debug, Default)]
pub(super) struct TileLists<T: Real> {
    pub starts: Vec<usize>,
    /// In the order of the gaussians; the place of an entry is its slot.
    pub entries: Vec<Entry>,
    /// Depths and slots of the entries, in the order of blending once each tile has sorted them.
    pub order: Vec<T::SortKey>,
    cursors: Vec<usize>,
}

impl<T: Real> TileLists<T> {
    /// Fills the lists, and tells each chunk where its touches went.
    pub fn deal(&mut self, grid: &TileGrid, chunks: &mut [Chunk], splats: &[Splat<T>]) {
        self.starts.clear();
        self.starts.resize(grid.len() + 1, 0);
        for touch in chunks.iter().flat_map(|chunk| &chunk.touches) {
            self.starts[touch.tile as usize + 1] += 1;
        }
        for tile in 0..grid.len() {
            self.starts[tile + 1] += self.starts[tile];
        }
        self.cursors.clone_from(&self.starts);
        let len = self.starts[grid.len()];
        self.entries.resize(len, Entry::default());
        self.order.resize(len, T::SortKey::default());
        for (first, chunk) in (0..).step_by(CHUNK).zip(chunks) {
            chunk.slots.clear();
            let mut start = 0;
            for (splat, visible) in (first..).zip(&chunk.visible) {
                let end = visible.touches_end as usize;
                let depth = splats[splat].center_depth;
                for touch in &chunk.touches[start..end] {
                    let cursor = &mut self.cursors[touch.tile as usize];
                    let slot = *cursor as u32;
                    self.order[*cursor] = depth.sort_key(slot);
                    self.entries[*cursor] = Entry {
                        splat: splat as u32,
                        blocks: touch.blocks,
                        contributed: false,
                    };
                    chunk.slots.push(slot);
                    *cursor += 1;
                }
                start = end;
            }
        }
    }
}

/// Entries of a tile that are loaded together before they are worked on.
pub(super) const BATCH: usize = 32;

/// Consecutive entries in the order of blending.
pub(super) struct Batch<T> {
    /// The entries' places in the tile's list.
    pub places: [usize; BATCH],
    pub entries: [Entry; BATCH],
    pub splats: [Splat<T>; BATCH],
}

impl<T: Real> Batch<T> {
    #[inline(always)]
    pub fn new() -> Self {
        Self {
            places: [0; BATCH],
            entries: [Entry::default(); BATCH],
            splats: [Splat::default(); BATCH],
        }
    }

    /// Asks for the splats of up to `BATCH` entries, which will be loaded next.
    #[inline(always)]
    pub fn prefetch(
        order: &[T::SortKey],
        entries: &[Entry],
        first_slot: usize,
        splats: &[Splat<T>],
    ) {
        for key in order.iter().take(BATCH) {
            let entry = &entries[T::sorted_index(*key) as usize - first_slot];
            prefetch(&splats[entry.splat as usize]);
        }
    }

    /// Loads up to `BATCH` entries of a list that starts at that slot.
    #[inline(always)]
    pub fn load(
        &mut self,
        order: &[T::SortKey],
        entries: &[Entry],
        first_slot: usize,
        splats: &[Splat<T>],
    ) {
        for (i, key) in order.iter().enumerate().take(BATCH) {
            self.places[i] = T::sorted_index(*key) as usize - first_slot;
            self.entries[i] = entries[self.places[i]];
            self.splats[i] = splats[self.entries[i].splat as usize];
        }
    }
}

/// One slice of `items` (one per list entry) for each row of tiles.
pub(super) fn split_by_tile_row<'a, X>(
    mut items: &'a mut [X],
    starts: &[usize],
    grid: &TileGrid,
) -> Vec<&'a mut [X]> {
    (0..grid.rows)
        .map(|row| {
            let (first, end) = (row * grid.columns, (row + 1) * grid.columns);
            take_front(&mut items, starts[end] - starts[first])
        })
        .collect()
}

/// Splits the first items off.
pub(super) fn take_front<'a, X>(items: &mut &'a mut [X], len: usize) -> &'a mut [X] {
    let (front, rest) = std::mem::take(items).split_at_mut(len);
    *items = rest;
    front
}
