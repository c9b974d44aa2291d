//! Blends one tile's list front to back into colour, depth and transmittance, block by block of
//! 16 lanes. A block whose pixels are all saturated takes no further gaussian, and a tile of such
//! blocks ends its list.

use super::bounds::{BLOCKS, LANES};
use super::project::Splat;
use super::real::Real;
use super::sample::{Lanes, Sample, TilePixels};
use super::tiles::Entry;
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

/// A tile's blended colour (per block and channel) and depth.
#[repr(align(64))]
pub(super) struct TileImage<T> {
    pub color: [[Lanes<T>; 3]; BLOCKS],
    pub depth: [Lanes<T>; BLOCKS],
}

/// `state.transmittance` starts as 1 at the image's pixels. Sets `contributed` for each entry.
#[inline(always)]
pub(super) fn blend_tile<T: Real>(
    pixels: &TilePixels<T>,
    entries: &[Entry],
    splats: &[Splat<T>],
    state: &mut TileState<T>,
    contributed: &mut [bool],
) -> TileImage<T> {
    let mut image = TileImage {
        color: [[[T::ZERO; LANES]; 3]; BLOCKS],
        depth: [[T::ZERO; LANES]; BLOCKS],
    };
    contributed.fill(false);
    let mut open_blocks = u16::MAX;
    for (position, entry) in entries.iter().enumerate() {
        let splat = &splats[entry.gaussian as usize];
        let mut blocks = entry.blocks & open_blocks;
        let mut hit = false;
        while blocks != 0 {
            let block = blocks.trailing_zeros() as usize % BLOCKS;
            blocks &= blocks - 1;
            let outcome = blend_block(
                splat,
                [
                    pixels.block_x[block] - splat.mean2d[0],
                    pixels.block_y[block] - splat.mean2d[1],
                ],
                pixels,
                &pixels.min_n_ray[block],
                &mut state.transmittance[block],
                &mut state.entries_used[block],
                position as u32 + 1,
                &mut image.color[block],
                &mut image.depth[block],
            );
            hit |= outcome & HIT != 0;
            if outcome & OPEN == 0 {
                open_blocks &= !(1 << block);
            }
        }
        contributed[position] = hit;
        if open_blocks == 0 {
            break;
        }
    }
    image
}

/// A pixel took the gaussian.
const HIT: u32 = 1;
/// A pixel can take more.
const OPEN: u32 = 2;

#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "arrays of one block, apart so that none aliases")]
fn blend_block<T: Real>(
    splat: &Splat<T>,
    offset: [T; 2],
    pixels: &TilePixels<T>,
    min_n_ray: &Lanes<T>,
    transmittance: &mut Lanes<T>,
    entries_used: &mut Lanes<u32>,
    entries: u32,
    [red, green, blue]: &mut [Lanes<T>; 3],
    depth: &mut Lanes<T>,
) -> u32 {
    let alpha_min = T::from_f64(ALPHA_MIN);
    let alpha_max = T::from_f64(ALPHA_MAX);
    let transmittance_min = T::from_f64(TRANSMITTANCE_MIN);
    let mut outcome = 0;
    for lane in 0..LANES {
        let sample = Sample::new(
            splat,
            offset[0] + pixels.lane_x[lane],
            offset[1] + pixels.lane_y[lane],
            min_n_ray[lane],
        );
        let before = transmittance[lane];
        let takes = (sample.alpha >= alpha_min) & (before >= transmittance_min);
        let alpha = if takes { sample.alpha.min(alpha_max) } else { T::ZERO };
        let weight = before * alpha;
        red[lane] += weight * splat.color[0];
        green[lane] += weight * splat.color[1];
        blue[lane] += weight * splat.color[2];
        depth[lane] += weight * sample.depth;
        let after = before * (T::ONE - alpha);
        transmittance[lane] = after;
        entries_used[lane] = if takes { entries } else { entries_used[lane] };
        outcome |= if takes { HIT } else { 0 };
        outcome |= if after >= transmittance_min { OPEN } else { 0 };
    }
    outcome
}
