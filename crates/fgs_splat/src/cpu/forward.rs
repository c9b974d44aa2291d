//! Blends one tile's list front to back into colour, depth and transmittance, block by block of
//! 16 pixels. A block whose pixels are all saturated takes no further gaussian, and a tile of such
//! blocks ends its list. Some dozen entries are blended into one block, or into as much of it as
//! registers hold, then into the next: what is known of its pixels stays in registers meanwhile.

use super::bounds::{BLOCKS, BlockSet, TileGrid};
use super::chunks::Chunk;
use super::lanes::{LANES, Lanes, part, set_part};
use super::project::{ScreenCamera, Splat};
use super::real::Real;
use super::sample::{Sample, TilePixels};
use super::tiles::{BATCH, Entry, load_splats, prefetch_splats, take_front};
use crate::kernel::{Kernel, mul_add};
use crate::rendering::{ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN};

/// What the backward pass needs to know of a tile's pixels.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(super) struct TileState<T> {
    /// After the last gaussian; 0 outside the image.
    pub transmittance: [Lanes<T>; BLOCKS],
    /// How many entries of the tile's list precede or are the last that contributed.
    pub entries_used: [Lanes<u32>; BLOCKS],
}

impl<T: Real> Default for TileState<T> {
    fn default() -> Self {
        Self {
            transmittance: [[T::ZERO; LANES]; BLOCKS],
            entries_used: [[0; LANES]; BLOCKS],
        }
    }
}

/// Blends one tile. Run it through [`crate::kernel::dispatch`].
pub(super) struct BlendTile<'a, T: Real> {
    pub tile: usize,
    pub grid: &'a TileGrid,
    pub camera: &'a ScreenCamera<T>,
    /// The tile's list; afterwards of each entry only the blocks where a pixel took it.
    pub entries: &'a mut [Entry],
    /// They hold the splats.
    pub chunks: &'a [Chunk<T>],
    pub state: &'a mut TileState<T>,
    /// The rows of the images in which the tile lies.
    pub color: &'a mut [[T; 3]],
    pub depth_m: &'a mut [T],
    pub alpha: &'a mut [T],
}

/// What the blending knows of a block's pixels, or of some of them.
#[derive(Clone, Copy)]
struct Block<T, const N: usize = LANES> {
    red: [T; N],
    green: [T; N],
    blue: [T; N],
    depth: [T; N],
    transmittance: [T; N],
    entries_used: [u32; N],
}

impl<T: Real> Block<T> {
    /// The pixels from `first` on.
    #[inline(always)]
    fn part<const WIDTH: usize>(&self, first: usize) -> Block<T, WIDTH> {
        Block {
            red: part(&self.red, first),
            green: part(&self.green, first),
            blue: part(&self.blue, first),
            depth: part(&self.depth, first),
            transmittance: part(&self.transmittance, first),
            entries_used: part(&self.entries_used, first),
        }
    }

    /// Puts the pixels from `first` on back.
    #[inline(always)]
    fn set_part<const WIDTH: usize>(&mut self, first: usize, pixels: Block<T, WIDTH>) {
        set_part(&mut self.red, first, pixels.red);
        set_part(&mut self.green, first, pixels.green);
        set_part(&mut self.blue, first, pixels.blue);
        set_part(&mut self.depth, first, pixels.depth);
        set_part(&mut self.transmittance, first, pixels.transmittance);
        set_part(&mut self.entries_used, first, pixels.entries_used);
    }
}

impl<T: Real> Kernel for BlendTile<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        let grid = self.grid;
        prefetch_splats(self.entries, self.chunks);
        let pixels = TilePixels::new(self.tile, grid, self.camera);
        let transmittance_min = T::from_f64(TRANSMITTANCE_MIN);
        let zero = [T::ZERO; LANES];
        let mut blocks = [Block {
            red: zero,
            green: zero,
            blue: zero,
            depth: zero,
            transmittance: zero,
            entries_used: [0; LANES],
        }; BLOCKS];
        pixels.for_each_pixel(grid, |block, lane, _| {
            blocks[block].transmittance[lane] = T::ONE;
        });

        let mut open_blocks = BlockSet::MAX;
        let mut batch = [Splat::default(); BATCH];
        let mut rest = self.entries;
        let mut position = 0;
        while !rest.is_empty() && open_blocks != 0 {
            let len = BATCH.min(rest.len());
            let entries = take_front(&mut rest, len);
            load_splats(entries, self.chunks, &mut batch);
            prefetch_splats(rest, self.chunks);
            let touching = transpose(entries);
            let mut hits = [0; BATCH];
            for block in 0..BLOCKS {
                if open_blocks & 1 << block == 0 {
                    continue;
                }
                let mut open = false;
                for first in (0..LANES).step_by(WIDTH) {
                    let mut state = blocks[block].part::<WIDTH>(first);
                    let mut touching = touching[block];
                    while touching != 0 {
                        let i = touching.trailing_zeros() as usize % BATCH;
                        touching &= touching - 1;
                        let number = (position + i) as u32 + 1;
                        let hit = blend_part::<FUSED, WIDTH, T>(
                            &batch[i], &pixels, block, first, number, &mut state,
                        );
                        hits[i] |= BlockSet::from(hit) << block;
                    }
                    open |= any(state.transmittance.map(|left| left >= transmittance_min));
                    blocks[block].set_part(first, state);
                }
                if !open {
                    open_blocks &= !(1 << block);
                }
            }
            for (entry, hits) in entries.iter_mut().zip(hits) {
                entry.blocks = hits;
            }
            position += BATCH;
        }
        for entry in rest {
            entry.blocks = 0;
        }

        pixels.for_each_pixel(grid, |block, lane, pixel| {
            let block = &blocks[block];
            self.color[pixel] = [block.red[lane], block.green[lane], block.blue[lane]];
            self.depth_m[pixel] = block.depth[lane];
            self.alpha[pixel] = T::ONE - block.transmittance[lane];
        });
        self.state.transmittance = blocks.map(|block| block.transmittance);
        self.state.entries_used = blocks.map(|block| block.entries_used);
    }
}

/// For each block the entries that touch it, as bits.
#[inline(always)]
fn transpose(entries: &[Entry]) -> [u32; BLOCKS] {
    let mut by_block = [0; BLOCKS];
    for (i, entry) in entries.iter().enumerate().take(BATCH) {
        for (block, bits) in by_block.iter_mut().enumerate() {
            *bits |= (entry.blocks >> block & 1) << i;
        }
    }
    by_block
}

/// Whether one is true.
#[inline(always)]
fn any<const WIDTH: usize>(lanes: [bool; WIDTH]) -> bool {
    lanes.iter().fold(false, |any, lane| any | lane)
}

/// Blends a splat, entry number `number` from 1, over the pixels of a block from `first` on.
/// Whether a pixel took it.
#[inline(always)]
fn blend_part<const FUSED: bool, const WIDTH: usize, T: Real>(
    splat: &Splat<T>,
    pixels: &TilePixels<T>,
    block: usize,
    first: usize,
    number: u32,
    pixel: &mut Block<T, WIDTH>,
) -> bool {
    // A copy, so that a lane's choice between two fields is no conditional load.
    let splat = *splat;
    let alpha_min = T::from_f64(ALPHA_MIN);
    let alpha_max = T::from_f64(ALPHA_MAX);
    let transmittance_min = T::from_f64(TRANSMITTANCE_MIN);
    let x = pixels.block_x[block] - splat.mean2d[0];
    let y = pixels.block_y[block] - splat.mean2d[1];
    let lane_x: [T; WIDTH] = part(&pixels.lane_x, first);
    let lane_y: [T; WIDTH] = part(&pixels.lane_y, first);
    let min_n_ray: [T; WIDTH] = part(&pixels.min_n_ray[block], first);
    let mut taken = [false; WIDTH];
    for lane in 0..WIDTH {
        let dx = x + lane_x[lane];
        let dy = y + lane_y[lane];
        let sample = Sample::new::<FUSED>(&splat, dx, dy, min_n_ray[lane]);
        let depth = if sample.on_plane {
            splat.plane_offset / sample.n_ray
        } else {
            splat.center_depth
        };
        let before = pixel.transmittance[lane];
        let takes = (sample.alpha >= alpha_min) & (before >= transmittance_min);
        let alpha = if takes {
            sample.alpha.min(alpha_max)
        } else {
            T::ZERO
        };
        let weight = before * alpha;
        pixel.red[lane] = mul_add::<FUSED, T>(weight, splat.color[0], pixel.red[lane]);
        pixel.green[lane] = mul_add::<FUSED, T>(weight, splat.color[1], pixel.green[lane]);
        pixel.blue[lane] = mul_add::<FUSED, T>(weight, splat.color[2], pixel.blue[lane]);
        pixel.depth[lane] = mul_add::<FUSED, T>(weight, depth, pixel.depth[lane]);
        pixel.transmittance[lane] = before * (T::ONE - alpha);
        let used = pixel.entries_used[lane];
        pixel.entries_used[lane] = if takes { number } else { used };
        taken[lane] = takes;
    }
    any(taken)
}
