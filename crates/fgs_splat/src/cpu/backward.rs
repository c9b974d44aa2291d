//! The derivative of `forward.rs`: walks one tile's list back to front and sums, for each entry,
//! what its pixels contribute to the gaussian's gradient. The transmittance in front of an entry
//! is recovered by dividing; the blend behind it is accumulated on the way.

use std::hint::black_box;

use pulp::NullaryFnOnce;

use super::bounds::{BLOCKS, LANES, TileGrid};
use super::forward::TileState;
use super::project::{ScreenCamera, Splat};
use super::project_vjp::{PixelSums, SUMS, sum};
use super::real::Real;
use super::sample::{Lanes, Sample, TilePixels};
use super::tiles::{BATCH, Entry, load_splats};
use crate::rendering::{ALPHA_MAX, ALPHA_MIN};

/// Differentiates one tile. Run it through [`pulp::Arch::dispatch`].
pub(super) struct BlendTileVjp<'a, T: Real> {
    pub tile: usize,
    pub grid: &'a TileGrid,
    pub camera: &'a ScreenCamera<T>,
    /// The tile's list.
    pub entries: &'a [Entry],
    /// Of all gaussians.
    pub splats: &'a [Splat<T>],
    pub state: &'a TileState<T>,
    /// Per entry.
    pub contributed: &'a [bool],
    /// The rows of the images in which the tile lies.
    pub d_color: &'a [[T; 3]],
    pub d_depth_m: &'a [T],
    pub d_alpha: &'a [T],
    /// Written for each entry.
    pub sums: &'a mut [PixelSums<T>],
}

/// What the walk over the list knows of a block's pixels.
#[derive(Clone, Copy)]
struct Block<T> {
    d_red: Lanes<T>,
    d_green: Lanes<T>,
    d_blue: Lanes<T>,
    d_depth: Lanes<T>,
    d_alpha: Lanes<T>,
    /// In front of what has been walked over.
    transmittance: Lanes<T>,
    /// The loss's derivative along all that has been walked over, as one colour.
    behind: Lanes<T>,
    entries_used: Lanes<u32>,
    /// The largest.
    most_entries_used: u32,
}

/// Lane sums of one entry.
type LaneSums<T> = [Lanes<T>; SUMS];

impl<T: Real> NullaryFnOnce for BlendTileVjp<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let pixels = TilePixels::new(self.tile, self.grid, self.camera);
        let zero = [T::ZERO; LANES];
        let mut blocks: [Block<T>; BLOCKS] = std::array::from_fn(|block| Block {
            d_red: zero,
            d_green: zero,
            d_blue: zero,
            d_depth: zero,
            d_alpha: zero,
            transmittance: self.state.transmittance[block],
            behind: zero,
            entries_used: self.state.entries_used[block],
            most_entries_used: self.state.entries_used[block]
                .iter()
                .fold(0, |a, &b| a.max(b)),
        });
        pixels.for_each_pixel(self.grid, |block, lane, pixel| {
            let block = &mut blocks[block];
            [block.d_red[lane], block.d_green[lane], block.d_blue[lane]] = self.d_color[pixel];
            block.d_depth[lane] = self.d_depth_m[pixel];
            block.d_alpha[lane] = self.d_alpha[pixel];
        });

        let mut batch = [Splat::default(); BATCH];
        for (index, entries) in self.entries.chunks(BATCH).enumerate().rev() {
            load_splats(entries, self.splats, &mut batch);
            for (offset, (entry, splat)) in entries.iter().zip(&batch).enumerate().rev() {
                let position = index * BATCH + offset;
                if !self.contributed[position] {
                    continue;
                }
                let mut lane_sums = [zero; SUMS];
                let mut touched = entry.blocks;
                while touched != 0 {
                    let block = touched.trailing_zeros() as usize % BLOCKS;
                    touched &= touched - 1;
                    if (position as u32) < blocks[block].most_entries_used {
                        blend_block_vjp(
                            splat,
                            &pixels,
                            block,
                            position as u32,
                            &mut blocks[block],
                            &mut lane_sums,
                        );
                    }
                }
                self.sums[position] = add_lanes(&lane_sums);
            }
        }
    }
}

/// The sum over all lanes of each quantity; the last two stay 0.
#[inline(always)]
fn add_lanes<T: Real>(sums: &LaneSums<T>) -> PixelSums<T> {
    // The black boxes keep the steps apart: seen as one, they become gathers of single lanes,
    // which are several times slower.
    let mut quarters = [[T::ZERO; 4]; 16];
    for (lanes, quarter) in sums.iter().zip(&mut quarters) {
        *quarter = black_box(std::array::from_fn(|i| {
            (lanes[i] + lanes[i + 4]) + (lanes[i + 8] + lanes[i + 12])
        }));
    }
    PixelSums(black_box(quarters).map(|[a, b, c, d]| (a + b) + (c + d)))
}

/// Walks over a splat, entry number `position` from 0, at the pixels of a block.
#[inline(always)]
fn blend_block_vjp<T: Real>(
    splat: &Splat<T>,
    pixels: &TilePixels<T>,
    block: usize,
    position: u32,
    pixel: &mut Block<T>,
    sums: &mut LaneSums<T>,
) {
    // A copy, so that a lane's choice between two fields is no conditional load.
    let splat = *splat;
    let alpha_min = T::from_f64(ALPHA_MIN);
    let alpha_max = T::from_f64(ALPHA_MAX);
    let x = pixels.block_x[block] - splat.mean2d[0];
    let y = pixels.block_y[block] - splat.mean2d[1];
    let min_n_ray = &pixels.min_n_ray[block];
    for lane in 0..LANES {
        let dx = x + pixels.lane_x[lane];
        let dy = y + pixels.lane_y[lane];
        let sample = Sample::new(&splat, dx, dy, min_n_ray[lane]);
        let took = (sample.alpha >= alpha_min) & (position < pixel.entries_used[lane]);
        let alpha = if took {
            sample.alpha.min(alpha_max)
        } else {
            T::ZERO
        };
        let inverse_rest = T::ONE / (T::ONE - alpha);
        let before = pixel.transmittance[lane] * inverse_rest;
        let weight = before * alpha;
        // The loss's derivative by this entry's weight, all else equal.
        let value = pixel.d_red[lane] * splat.color[0]
            + pixel.d_green[lane] * splat.color[1]
            + pixel.d_blue[lane] * splat.color[2]
            + pixel.d_depth[lane] * sample.depth
            + pixel.d_alpha[lane];
        // d weight / d alpha = before; each weight behind scales with 1 - alpha.
        let d_sample_alpha = before * value - pixel.behind[lane] * inverse_rest;
        pixel.transmittance[lane] = before;
        pixel.behind[lane] += weight * value;

        sums[sum::COLOR][lane] += weight * pixel.d_red[lane];
        sums[sum::COLOR + 1][lane] += weight * pixel.d_green[lane];
        sums[sum::COLOR + 2][lane] += weight * pixel.d_blue[lane];

        let free = took & (sample.alpha <= alpha_max);
        let g = if free {
            d_sample_alpha * alpha
        } else {
            T::ZERO
        };
        let (gp, gq) = (g * sample.p, g * sample.q);
        sums[sum::G][lane] += g;
        sums[sum::GP][lane] += gp;
        sums[sum::GQ][lane] += gq;
        sums[sum::GPP][lane] += gp * sample.p;
        sums[sum::GPQ][lane] += gp * sample.q;
        sums[sum::GQQ][lane] += gq * sample.q;

        let h = weight * pixel.d_depth[lane];
        let (h_plane, h_center) = if sample.on_plane {
            (h, T::ZERO)
        } else {
            (T::ZERO, h)
        };
        let ht = h_plane * sample.inverse_n_ray;
        let htt = ht * sample.inverse_n_ray;
        sums[sum::CENTER][lane] += h_center;
        sums[sum::HT][lane] += ht;
        sums[sum::HTT][lane] += htt;
        sums[sum::HTT_DX][lane] += htt * sample.dx;
        sums[sum::HTT_DY][lane] += htt * sample.dy;
    }
}
