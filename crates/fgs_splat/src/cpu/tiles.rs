//! Per-tile lists of gaussians in blending order.
//!
//! A counting sort distributes the touches to their tiles in gaussian order; each tile then sorts
//! its own list by depth, ties by gaussian order.

use super::bounds::{BlockSet, TileGrid};
use super::chunks::{CHUNK, Chunk, splat};
use super::prefetch::prefetch;
use super::project::Splat;
use super::real::Real;

/// A gaussian's presence in a tile.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Entry {
    /// Global splat number, see [`splat`].
    pub splat: u32,
    pub blocks: BlockSet,
}

/// The concatenated lists of all tiles: tile `t` owns `starts[t]..starts[t + 1]`.
#[derive(Debug, Default)]
pub(super) struct TileLists<T: Real> {
    pub starts: Vec<usize>,
    /// Depth and slot of each entry, in blending order once the tile has been sorted. A slot is an
    /// entry's position before sorting, in gaussian order.
    pub order: Vec<T::SortKey>,
    /// Entries by slot.
    pub dealt: Vec<Entry>,
    /// Entries in blending order; after blending, with only the blocks where a pixel took them.
    pub entries: Vec<Entry>,
    cursors: Vec<u32>,
}

impl<T: Real> TileLists<T> {
    /// Fills `order` and `dealt`, and each chunk's `slots`.
    pub fn deal(&mut self, grid: &TileGrid, chunks: &mut [Chunk<T>]) {
        self.starts.clear();
        self.starts.resize(grid.len() + 1, 0);
        for touch in chunks.iter().flat_map(|chunk| &chunk.touches) {
            self.starts[touch.tile as usize + 1] += 1;
        }
        self.cursors.clear();
        for tile in 0..grid.len() {
            self.cursors.push(self.starts[tile] as u32);
            self.starts[tile + 1] += self.starts[tile];
        }
        let len = self.starts[grid.len()];
        self.order.resize(len, T::SortKey::default());
        self.dealt.resize(len, Entry::default());
        self.entries.resize(len, Entry::default());
        for (first, chunk) in (0_u32..).step_by(CHUNK).zip(chunks) {
            chunk.slots.clear();
            chunk.slots.extend(chunk.touches.iter().map(|touch| {
                let depth = chunk.splats[usize::from(touch.splat)].center_depth;
                let cursor = &mut self.cursors[touch.tile as usize];
                let slot = *cursor;
                *cursor += 1;
                self.order[slot as usize] = depth.sort_key(slot);
                self.dealt[slot as usize] = Entry {
                    splat: first + u32::from(touch.splat),
                    blocks: touch.blocks,
                };
                slot
            }));
        }
    }
}

/// Prefetches the splats of entries.
#[inline(always)]
pub(super) fn prefetch_splats<T: Real>(entries: &[Entry], chunks: &[Chunk<T>]) {
    for entry in entries {
        prefetch(splat(chunks, entry.splat));
    }
}

/// Copies the splats of entries.
#[inline(always)]
pub(super) fn load_splats<T: Real>(entries: &[Entry], chunks: &[Chunk<T>], batch: &mut [Splat<T>]) {
    for (entry, loaded) in entries.iter().zip(batch) {
        *loaded = *splat(chunks, entry.splat);
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
