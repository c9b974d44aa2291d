//! Blends a tile's list front to back into colour, depth and transmittance, 64 entries at a time.
//!
//! Within a batch the pixels are processed group by group, so that a group's state stays in
//! registers. Its alphas are all computed before any is blended: they do not depend on each other,
//! while each blend depends on the one before. A group whose pixels are all saturated is skipped,
//! and a tile ends when all its groups are.

use super::bounds::{BLOCKS, TILE_PIXELS, TileGrid};
use super::chunks::Chunk;
use super::lanes::{LANES, any, group, group_mut, ones};
use super::project::{ScreenCamera, Splat};
use super::real::Real;
use super::sample::{Sample, TilePixels};
use super::tiles::{Entry, load_splats, prefetch_splats, take_front};
use crate::kernel::{Kernel, mul_add};
use crate::rendering::{ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN};

/// Entries per batch: one bit of a `u64` each.
const BATCH: usize = u64::BITS as usize;

/// What the backward pass needs of a tile's pixels.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(super) struct TileState<T> {
    /// After the last gaussian; 0 outside the image.
    pub transmittance: [T; TILE_PIXELS],
    /// Length of the list up to the last entry that contributed.
    pub entries_used: [u32; TILE_PIXELS],
}

impl<T: Real> Default for TileState<T> {
    fn default() -> Self {
        Self {
            transmittance: [T::ZERO; TILE_PIXELS],
            entries_used: [0; TILE_PIXELS],
        }
    }
}

/// Blends one tile. Run it through [`crate::kernel::dispatch`].
pub(super) struct BlendTile<'a, T: Real> {
    pub tile: usize,
    pub grid: &'a TileGrid,
    pub camera: &'a ScreenCamera<T>,
    /// The tile's list. Blending leaves each entry only the blocks where a pixel took it.
    pub entries: &'a mut [Entry],
    /// Hold the splats.
    pub chunks: &'a [Chunk<T>],
    pub state: &'a mut TileState<T>,
    /// The image rows of the tile.
    pub color: &'a mut [[T; 3]],
    pub depth_m: &'a mut [T],
    pub alpha: &'a mut [T],
}

/// Blending state of a tile's pixels, or of a group of them.
#[derive(Clone, Copy)]
struct Pixels<T, const N: usize = TILE_PIXELS> {
    red: [T; N],
    green: [T; N],
    blue: [T; N],
    depth: [T; N],
    transmittance: [T; N],
    entries_used: [u32; N],
}

impl<T: Real> Pixels<T> {
    #[inline(always)]
    fn group<const WIDTH: usize>(&self, number: usize) -> Pixels<T, WIDTH> {
        Pixels {
            red: *group(&self.red, number),
            green: *group(&self.green, number),
            blue: *group(&self.blue, number),
            depth: *group(&self.depth, number),
            transmittance: *group(&self.transmittance, number),
            entries_used: *group(&self.entries_used, number),
        }
    }

    #[inline(always)]
    fn set_group<const WIDTH: usize>(&mut self, number: usize, pixels: Pixels<T, WIDTH>) {
        *group_mut(&mut self.red, number) = pixels.red;
        *group_mut(&mut self.green, number) = pixels.green;
        *group_mut(&mut self.blue, number) = pixels.blue;
        *group_mut(&mut self.depth, number) = pixels.depth;
        *group_mut(&mut self.transmittance, number) = pixels.transmittance;
        *group_mut(&mut self.entries_used, number) = pixels.entries_used;
    }
}

impl<T: Real> Kernel for BlendTile<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        let grid = self.grid;
        prefetch_splats(&self.entries[..BATCH.min(self.entries.len())], self.chunks);
        let tile = TilePixels::new(self.tile, grid, self.camera);
        let mut pixels = Pixels {
            red: [T::ZERO; TILE_PIXELS],
            green: [T::ZERO; TILE_PIXELS],
            blue: [T::ZERO; TILE_PIXELS],
            depth: [T::ZERO; TILE_PIXELS],
            transmittance: [T::ZERO; TILE_PIXELS],
            entries_used: [0; TILE_PIXELS],
        };
        tile.for_each_row(grid, |places, row| {
            for place in &places[..row.len()] {
                pixels.transmittance[*place] = T::ONE;
            }
        });

        let blocks_of_group = WIDTH / LANES;
        let groups = BLOCKS / blocks_of_group;
        let mut open_groups = u64::MAX >> (u64::BITS as usize - groups);
        let mut batch = [Splat::default(); BATCH];
        let mut samples = [Evaluated {
            alpha: [T::ZERO; WIDTH],
            depth: [T::ZERO; WIDTH],
        }; BATCH];
        let mut rest = self.entries;
        let mut first = 0;
        while !rest.is_empty() && open_groups != 0 {
            let len = BATCH.min(rest.len());
            let entries = take_front(&mut rest, len);
            load_splats(entries, self.chunks, &mut batch);
            prefetch_splats(&rest[..BATCH.min(rest.len())], self.chunks);
            // Transposed: for each block the set of entries that touch it.
            let mut touching = [0; BLOCKS];
            for (blocks, entry) in touching.iter_mut().zip(entries.iter()) {
                *blocks = entry.blocks;
            }
            transpose(&mut touching);
            let mut hits = [0; BLOCKS];
            for number in 0..groups {
                let blocks = number * blocks_of_group..(number + 1) * blocks_of_group;
                let touching = touching[blocks.clone()]
                    .iter()
                    .fold(0, |any, row| any | row);
                if touching == 0 || open_groups >> number & 1 == 0 {
                    continue;
                }
                for (i, sample) in ones(touching).zip(&mut samples) {
                    *sample = evaluate::<FUSED, WIDTH, T>(&batch[i], &tile, number);
                }
                let mut group = pixels.group::<WIDTH>(number);
                let mut taken = 0;
                for (i, sample) in ones(touching).zip(&samples) {
                    let used = (first + i) as u32 + 1;
                    let took = blend::<FUSED, WIDTH, T>(&batch[i], sample, used, &mut group);
                    taken |= u64::from(took) << i;
                }
                pixels.set_group(number, group);
                hits[blocks].fill(taken);
                let transmittance_min = T::from_f64(TRANSMITTANCE_MIN);
                if !any(group.transmittance.map(|left| left >= transmittance_min)) {
                    open_groups &= !(1 << number);
                }
            }
            transpose(&mut hits);
            for (entry, blocks) in entries.iter_mut().zip(hits) {
                entry.blocks = blocks;
            }
            first += BATCH;
        }
        for entry in rest {
            entry.blocks = 0;
        }

        tile.for_each_row(grid, |places, row| {
            let color = self.color[row.clone()].iter_mut();
            let depth_m = self.depth_m[row.clone()].iter_mut();
            let alpha = self.alpha[row].iter_mut();
            for (((color, depth_m), alpha), place) in color.zip(depth_m).zip(alpha).zip(places) {
                let place = place % TILE_PIXELS;
                *color = [pixels.red[place], pixels.green[place], pixels.blue[place]];
                *depth_m = pixels.depth[place];
                *alpha = T::ONE - pixels.transmittance[place];
            }
        });
        self.state.transmittance = pixels.transmittance;
        self.state.entries_used = pixels.entries_used;
    }
}

/// Bit `j` of row `i` becomes bit `i` of row `j`.
#[inline(always)]
fn transpose(rows: &mut [u64; 64]) {
    swap_quarters::<32>(rows);
    swap_quarters::<16>(rows);
    swap_quarters::<8>(rows);
    swap_quarters::<4>(rows);
    swap_quarters::<2>(rows);
    swap_quarters::<1>(rows);
}

/// Swaps the off-diagonal quarters of each square of `2 HALF` bits.
#[inline(always)]
fn swap_quarters<const HALF: usize>(rows: &mut [u64; 64]) {
    let left = u64::MAX / ((1 << HALF) + 1);
    for square in rows.chunks_exact_mut(2 * HALF) {
        let (upper, lower) = square.split_at_mut(HALF);
        for (upper, lower) in upper.iter_mut().zip(lower) {
            let changed = (*upper >> HALF ^ *lower) & left;
            *upper ^= changed << HALF;
            *lower ^= changed;
        }
    }
}

/// A splat evaluated at a group of pixels.
#[derive(Clone, Copy)]
struct Evaluated<T, const WIDTH: usize> {
    /// At most `ALPHA_MAX`; 0 where it is under `ALPHA_MIN`.
    alpha: [T; WIDTH],
    depth: [T; WIDTH],
}

#[inline(always)]
fn evaluate<const FUSED: bool, const WIDTH: usize, T: Real>(
    splat: &Splat<T>,
    tile: &TilePixels<T>,
    number: usize,
) -> Evaluated<T, WIDTH> {
    // A copy: choosing between two fields of a reference would become a conditional load.
    let splat = *splat;
    let alpha_min = T::from_f64(ALPHA_MIN);
    let alpha_max = T::from_f64(ALPHA_MAX);
    let [u, v, min_n_ray] = tile.group::<WIDTH>(number);
    let mut evaluated = Evaluated {
        alpha: [T::ZERO; WIDTH],
        depth: [T::ZERO; WIDTH],
    };
    for lane in 0..WIDTH {
        let sample = Sample::new::<FUSED>(&splat, u[lane], v[lane], min_n_ray[lane]);
        let alpha = sample.alpha.min(alpha_max);
        let drawn = sample.alpha >= alpha_min;
        evaluated.alpha[lane] = if drawn { alpha } else { T::ZERO };
        let plane_depth = splat.plane_offset / sample.n_ray;
        evaluated.depth[lane] = if sample.on_plane {
            plane_depth
        } else {
            splat.center_depth
        };
    }
    evaluated
}

/// Blends a splat over a group of pixels. `number` counts the list's entries from 1. Returns
/// whether any pixel took it.
#[inline(always)]
fn blend<const FUSED: bool, const WIDTH: usize, T: Real>(
    splat: &Splat<T>,
    sample: &Evaluated<T, WIDTH>,
    number: u32,
    pixels: &mut Pixels<T, WIDTH>,
) -> bool {
    let (splat, sample) = (*splat, *sample);
    let transmittance_min = T::from_f64(TRANSMITTANCE_MIN);
    let mut taken = [false; WIDTH];
    for (lane, taken) in taken.iter_mut().enumerate() {
        let alpha = sample.alpha[lane];
        let before = pixels.transmittance[lane];
        let (weight, after) = (before * alpha, before * (T::ONE - alpha));
        let open = before >= transmittance_min;
        let takes = open & (alpha > T::ZERO);
        let weight = if open { weight } else { T::ZERO };
        pixels.red[lane] = mul_add::<FUSED, T>(weight, splat.color[0], pixels.red[lane]);
        pixels.green[lane] = mul_add::<FUSED, T>(weight, splat.color[1], pixels.green[lane]);
        pixels.blue[lane] = mul_add::<FUSED, T>(weight, splat.color[2], pixels.blue[lane]);
        let depth = sample.depth[lane];
        pixels.depth[lane] = mul_add::<FUSED, T>(weight, depth, pixels.depth[lane]);
        pixels.transmittance[lane] = if open { after } else { before };
        let used = pixels.entries_used[lane];
        pixels.entries_used[lane] = if takes { number } else { used };
        *taken = takes;
    }
    any(taken)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_become_columns() {
        let mut state = 1_u64;
        let rows: [u64; 64] = std::array::from_fn(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            state ^ state >> 29
        });
        let mut columns = rows;
        transpose(&mut columns);
        for (i, row) in rows.iter().enumerate() {
            for (j, column) in columns.iter().enumerate() {
                assert_eq!(row >> j & 1, column >> i & 1, "{i} {j}");
            }
        }
    }
}
