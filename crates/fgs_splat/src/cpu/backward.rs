//! The derivative of `forward.rs`: walks one tile's list back to front and sums, for each entry,
//! what its pixels contribute to the gaussian's gradient. The transmittance in front of an entry
//! is recovered by dividing; the blend behind it is accumulated on the way.

use super::bounds::{BLOCKS, LANES};
use super::forward::TileState;
use super::project::Splat;
use super::project_vjp::{PixelSums, SUMS, sum};
use super::real::Real;
use super::sample::{Lanes, Sample, TilePixels};
use super::tiles::Entry;
use crate::rendering::{ALPHA_MAX, ALPHA_MIN};

/// The loss's derivatives by the pixels of a tile, 0 outside the image.
#[repr(align(64))]
pub(super) struct TileCotangents<T> {
    /// By red, green, blue, depth and alpha.
    pub d_pixel: [[Lanes<T>; 5]; BLOCKS],
}

/// Lane sums of one entry.
type LaneSums<T> = [Lanes<T>; SUMS];

/// Writes the sums of each entry.
#[inline(always)]
pub(super) fn blend_tile_vjp<T: Real>(
    pixels: &TilePixels<T>,
    entries: &[Entry],
    splats: &[Splat<T>],
    state: &TileState<T>,
    contributed: &[bool],
    cotangents: &TileCotangents<T>,
    sums: &mut [PixelSums<T>],
) {
    let mut transmittance = state.transmittance;
    let mut behind = [[T::ZERO; LANES]; BLOCKS];
    let block_entries_used: [u32; BLOCKS] =
        std::array::from_fn(|block| state.entries_used[block].iter().fold(0, |a, &b| a.max(b)));
    for (position, entry) in entries.iter().enumerate().rev() {
        sums[position] = PixelSums::default();
        if !contributed[position] {
            continue;
        }
        let splat = &splats[entry.gaussian as usize];
        let mut lane_sums = [[T::ZERO; LANES]; SUMS];
        let mut blocks = entry.blocks;
        while blocks != 0 {
            let block = blocks.trailing_zeros() as usize % BLOCKS;
            blocks &= blocks - 1;
            if position as u32 >= block_entries_used[block] {
                continue;
            }
            blend_block_vjp(
                splat,
                [
                    pixels.block_x[block] - splat.mean2d[0],
                    pixels.block_y[block] - splat.mean2d[1],
                ],
                pixels,
                &pixels.min_n_ray[block],
                &cotangents.d_pixel[block],
                position as u32,
                &state.entries_used[block],
                &mut transmittance[block],
                &mut behind[block],
                &mut lane_sums,
            );
        }
        for (lanes, total) in lane_sums.iter().zip(&mut sums[position].0) {
            *total = add_lanes(lanes);
        }
    }
}

/// The sum of all lanes, by halves.
#[inline(always)]
fn add_lanes<T: Real>(lanes: &Lanes<T>) -> T {
    let eight: [T; 8] = std::array::from_fn(|i| lanes[i] + lanes[i + 8]);
    let four: [T; 4] = std::array::from_fn(|i| eight[i] + eight[i + 4]);
    (four[0] + four[2]) + (four[1] + four[3])
}

#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "arrays of one block, apart so that none aliases")]
fn blend_block_vjp<T: Real>(
    splat: &Splat<T>,
    offset: [T; 2],
    pixels: &TilePixels<T>,
    min_n_ray: &Lanes<T>,
    [d_red, d_green, d_blue, d_depth, d_alpha]: &[Lanes<T>; 5],
    position: u32,
    entries_used: &Lanes<u32>,
    transmittance: &mut Lanes<T>,
    behind: &mut Lanes<T>,
    sums: &mut LaneSums<T>,
) {
    let alpha_min = T::from_f64(ALPHA_MIN);
    let alpha_max = T::from_f64(ALPHA_MAX);
    for lane in 0..LANES {
        let sample = Sample::new(
            splat,
            offset[0] + pixels.lane_x[lane],
            offset[1] + pixels.lane_y[lane],
            min_n_ray[lane],
        );
        let took = (sample.alpha >= alpha_min) & (position < entries_used[lane]);
        let alpha = if took { sample.alpha.min(alpha_max) } else { T::ZERO };
        let inverse_rest = T::ONE / (T::ONE - alpha);
        let before = transmittance[lane] * inverse_rest;
        let weight = before * alpha;
        // The loss's derivative by this entry's weight, all else equal.
        let value = d_red[lane] * splat.color[0]
            + d_green[lane] * splat.color[1]
            + d_blue[lane] * splat.color[2]
            + d_depth[lane] * sample.depth
            + d_alpha[lane];
        // d weight / d alpha = before; each weight behind scales with 1 - alpha.
        let d_sample_alpha = before * value - behind[lane] * inverse_rest;
        transmittance[lane] = before;
        behind[lane] += weight * value;

        sums[sum::COLOR][lane] += weight * d_red[lane];
        sums[sum::COLOR + 1][lane] += weight * d_green[lane];
        sums[sum::COLOR + 2][lane] += weight * d_blue[lane];

        let free = took & (sample.alpha <= alpha_max);
        let g = if free { d_sample_alpha * alpha } else { T::ZERO };
        let (gp, gq) = (g * sample.p, g * sample.q);
        sums[sum::G][lane] += g;
        sums[sum::GP][lane] += gp;
        sums[sum::GQ][lane] += gq;
        sums[sum::GPP][lane] += gp * sample.p;
        sums[sum::GPQ][lane] += gp * sample.q;
        sums[sum::GQQ][lane] += gq * sample.q;

        let h = weight * d_depth[lane];
        let ht = if sample.on_plane { h * sample.inverse_n_ray } else { T::ZERO };
        let htt = if sample.on_plane { ht * sample.inverse_n_ray } else { T::ZERO };
        sums[sum::CENTER][lane] += if sample.on_plane { T::ZERO } else { h };
        sums[sum::HT][lane] += ht;
        sums[sum::HTT][lane] += htt;
        sums[sum::HTT_DX][lane] += htt * sample.dx;
        sums[sum::HTT_DY][lane] += htt * sample.dy;
    }
}
