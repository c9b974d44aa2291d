//! Blends one tile's list front to back into colour, depth and transmittance, block by block of
//! 16 lanes. A block whose pixels are all saturated takes no further gaussian, and a tile of such
//! blocks ends its list.

use super::bounds::{BLOCKS, TileGrid};
use super::kernel::{Kernel, mul_add};
use super::lanes::{LANES, Lanes};
use super::project::{ScreenCamera, Splat};
use super::real::Real;
use super::sample::{Sample, TilePixels};
use super::tiles::{BATCH, Batch, Entry};
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

/// Blends one tile. Run it through [`super::kernel::dispatch`].
pub(super) struct BlendTile<'a, T: Real> {
    pub tile: usize,
    pub grid: &'a TileGrid,
    pub camera: &'a ScreenCamera<T>,
    /// The tile's list; tells afterwards which entries contributed.
    pub entries: &'a mut [Entry],
    pub order: &'a [T::SortKey],
    pub first_slot: usize,
    /// Of all gaussians.
    pub splats: &'a [Splat<T>],
    pub state: &'a mut TileState<T>,
    /// The rows of the images in which the tile lies.
    pub color: &'a mut [[T; 3]],
    pub depth_m: &'a mut [T],
    pub alpha: &'a mut [T],
}

/// What is summed up at the pixels of a block.
#[derive(Clone, Copy)]
struct BlockImage<T> {
    red: Lanes<T>,
    green: Lanes<T>,
    blue: Lanes<T>,
    depth: Lanes<T>,
}

impl<T: Real> Kernel for BlendTile<'_, T> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let grid = self.grid;
        Batch::prefetch(self.order, self.entries, self.first_slot, self.splats);
        let pixels = TilePixels::new(self.tile, grid, self.camera);
        let mut state = TileState::default();
        pixels.for_each_pixel(grid, |block, lane, _| {
            state.transmittance[block][lane] = T::ONE;
        });
        let zero = [T::ZERO; LANES];
        let mut images = [BlockImage {
            red: zero,
            green: zero,
            blue: zero,
            depth: zero,
        }; BLOCKS];

        let mut open_blocks = u16::MAX;
        let mut batch = Batch::new();
        'list: for (start, order) in (0..).step_by(BATCH).zip(self.order.chunks(BATCH)) {
            batch.load(order, self.entries, self.first_slot, self.splats);
            let next = &self.order[start + order.len()..];
            Batch::prefetch(next, self.entries, self.first_slot, self.splats);
            for i in 0..order.len() {
                let mut blocks = batch.entries[i].blocks & open_blocks;
                let mut hit = false;
                while blocks != 0 {
                    let block = blocks.trailing_zeros() as usize % BLOCKS;
                    blocks &= blocks - 1;
                    let outcome = blend_block::<FUSED, T>(
                        &batch.splats[i],
                        &pixels,
                        block,
                        (start + i) as u32 + 1,
                        &mut state,
                        &mut images[block],
                    );
                    hit |= outcome & HIT != 0;
                    if outcome & OPEN == 0 {
                        open_blocks &= !(1 << block);
                    }
                }
                self.entries[batch.places[i]].contributed = hit;
                if open_blocks == 0 {
                    break 'list;
                }
            }
        }

        pixels.for_each_pixel(grid, |block, lane, pixel| {
            let image = &images[block];
            self.color[pixel] = [image.red[lane], image.green[lane], image.blue[lane]];
            self.depth_m[pixel] = image.depth[lane];
            self.alpha[pixel] = T::ONE - state.transmittance[block][lane];
        });
        *self.state = state;
    }
}

/// A pixel took the gaussian.
const HIT: u32 = 1;
/// A pixel can take more.
const OPEN: u32 = 2;

/// Blends a splat, entry number `entries` from 1, over a block.
#[inline(always)]
fn blend_block<const FUSED: bool, T: Real>(
    splat: &Splat<T>,
    pixels: &TilePixels<T>,
    block: usize,
    entries: u32,
    state: &mut TileState<T>,
    image: &mut BlockImage<T>,
) -> u32 {
    // A copy, so that a lane's choice between two fields is no conditional load.
    let splat = *splat;
    let alpha_min = T::from_f64(ALPHA_MIN);
    let alpha_max = T::from_f64(ALPHA_MAX);
    let transmittance_min = T::from_f64(TRANSMITTANCE_MIN);
    let x = pixels.block_x[block] - splat.mean2d[0];
    let y = pixels.block_y[block] - splat.mean2d[1];
    let min_n_ray = &pixels.min_n_ray[block];
    let transmittance = &mut state.transmittance[block];
    let entries_used = &mut state.entries_used[block];
    let mut taken = [0_u32; LANES];
    let mut open = [0_u32; LANES];
    for lane in 0..LANES {
        let dx = x + pixels.lane_x[lane];
        let dy = y + pixels.lane_y[lane];
        let sample = Sample::new::<FUSED>(&splat, dx, dy, min_n_ray[lane]);
        let depth = if sample.on_plane {
            splat.plane_offset / sample.n_ray
        } else {
            splat.center_depth
        };
        let before = transmittance[lane];
        let takes = (sample.alpha >= alpha_min) & (before >= transmittance_min);
        let alpha = if takes {
            sample.alpha.min(alpha_max)
        } else {
            T::ZERO
        };
        let weight = before * alpha;
        image.red[lane] = mul_add::<FUSED, T>(weight, splat.color[0], image.red[lane]);
        image.green[lane] = mul_add::<FUSED, T>(weight, splat.color[1], image.green[lane]);
        image.blue[lane] = mul_add::<FUSED, T>(weight, splat.color[2], image.blue[lane]);
        image.depth[lane] = mul_add::<FUSED, T>(weight, depth, image.depth[lane]);
        let after = before * (T::ONE - alpha);
        transmittance[lane] = after;
        taken[lane] = u32::from(takes);
        open[lane] = u32::from(after >= transmittance_min);
    }
    let mut outcome = 0;
    for lane in 0..LANES {
        // No branch: `entries` only grows.
        entries_used[lane] = entries_used[lane].max(entries * taken[lane]);
        outcome |= (HIT * taken[lane]) | (OPEN * open[lane]);
    }
    outcome
}
