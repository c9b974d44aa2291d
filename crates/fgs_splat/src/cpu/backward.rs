//! The derivative of `forward.rs`: walks a tile's list back to front and sums each entry's
//! contributions to its gaussian's gradient over the pixels. The transmittance in front of an entry
//! is recovered by division; the blend behind it is accumulated along the way. As in the forward
//! pass, all alphas of a batch are computed before the walk over it.

use std::hint::black_box;

use super::bounds::{BLOCKS, BlockSet, TILE_PIXELS, TileGrid};
use super::chunks::Chunk;
use super::forward::TileState;
use super::lanes::{LANES, group, group_mut, ones};
use super::prefetch::prefetch;
use super::project::{ScreenCamera, Splat};
use super::project_vjp::{PixelSums, sum};
use super::real::Real;
use super::sample::{Sample, TilePixels};
use super::tiles::{Entry, load_splats, prefetch_splats};
use crate::kernel::{Kernel, mul_add};
use crate::rendering::{ALPHA_MAX, ALPHA_MIN};

/// Entries per batch.
const BATCH: usize = 8;

/// Differentiates one tile. Run it through [`crate::kernel::dispatch`].
pub(super) struct BlendTileVjp<'a, T: Real> {
    pub tile: usize,
    pub grid: &'a TileGrid,
    pub camera: &'a ScreenCamera<T>,
    /// The tile's list.
    pub entries: &'a [Entry],
    pub order: &'a [T::SortKey],
    /// Slot of `sums[0]`.
    pub first_slot: usize,
    /// Hold the splats.
    pub chunks: &'a [Chunk<T>],
    pub state: &'a TileState<T>,
    /// The image rows of the tile.
    pub d_color: &'a [[T; 3]],
    pub d_depth_m: &'a [T],
    pub d_alpha: &'a [T],
    /// Output, by slot.
    pub sums: &'a mut [PixelSums<T>],
}

/// Derivatives by a tile's pixels, and the state of the walk.
struct Pixels<T> {
    d_red: [T; TILE_PIXELS],
    d_green: [T; TILE_PIXELS],
    d_blue: [T; TILE_PIXELS],
    d_depth: [T; TILE_PIXELS],
    d_alpha: [T; TILE_PIXELS],
    /// In front of the entries visited so far.
    transmittance: [T; TILE_PIXELS],
    /// Sum over the entries visited so far of weight times the loss's derivative by the weight.
    behind: [T; TILE_PIXELS],
}

/// Sums of one entry per lane.
type LaneSums<T, const WIDTH: usize> = [[T; WIDTH]; sum::OF_PIXELS];

impl<T: Real> Kernel for BlendTileVjp<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        let last = self.entries.len().saturating_sub(1) / BATCH * BATCH;
        prefetch_splats(&self.entries[last..], self.chunks);
        let tile = TilePixels::new(self.tile, self.grid, self.camera);
        let zero = [T::ZERO; TILE_PIXELS];
        let mut pixels = Pixels {
            d_red: zero,
            d_green: zero,
            d_blue: zero,
            d_depth: zero,
            d_alpha: zero,
            transmittance: self.state.transmittance,
            behind: zero,
        };
        tile.for_each_row(self.grid, |places, row| {
            let d_color = &self.d_color[row.clone()];
            let d_depth_m = &self.d_depth_m[row.clone()];
            let d_alpha = &self.d_alpha[row];
            for (((d_color, d_depth), d_alpha), place) in
                d_color.iter().zip(d_depth_m).zip(d_alpha).zip(places)
            {
                let place = place % TILE_PIXELS;
                [
                    pixels.d_red[place],
                    pixels.d_green[place],
                    pixels.d_blue[place],
                ] = *d_color;
                pixels.d_depth[place] = *d_depth;
                pixels.d_alpha[place] = *d_alpha;
            }
        });
        let any_depth = pixels
            .d_depth
            .iter()
            .fold(false, |any, d| any | (*d != T::ZERO));

        if any_depth {
            self.walk::<FUSED, WIDTH, true>(&tile, &mut pixels);
        } else {
            self.walk::<FUSED, WIDTH, false>(&tile, &mut pixels);
        }
    }
}

impl<T: Real> BlendTileVjp<'_, T> {
    /// Walks the list and writes its sums. Without `DEPTH` all derivatives by depth are 0, and so
    /// are their sums.
    #[inline(always)]
    fn walk<const FUSED: bool, const WIDTH: usize, const DEPTH: bool>(
        self,
        tile: &TilePixels<T>,
        pixels: &mut Pixels<T>,
    ) {
        let used_sums = if DEPTH { sum::OF_PIXELS } else { sum::OF_DEPTH };
        let mut batch = [Splat::default(); BATCH];
        let mut quarters = [[[T::ZERO; 4]; sum::OF_PIXELS]; BATCH];
        let mut samples = [Evaluated {
            alpha: [T::ZERO; WIDTH],
            inverse_rest: [T::ZERO; WIDTH],
            inverse_n_ray: [T::ZERO; WIDTH],
        }; BATCH * BLOCKS];
        for (index, entries) in self.entries.chunks(BATCH).enumerate().rev() {
            let start = index * BATCH;
            load_splats(entries, self.chunks, &mut batch);
            prefetch_splats(
                &self.entries[start.saturating_sub(BATCH)..start],
                self.chunks,
            );
            let slots = self.order[start..]
                .iter()
                .map(|key| T::sorted_index(*key) as usize - self.first_slot);
            for (slot, _) in slots.clone().zip(entries) {
                prefetch(&self.sums[slot]);
            }
            let mut count = 0;
            for (i, entry) in entries.iter().enumerate().rev() {
                for number in groups::<WIDTH>(entry.blocks) {
                    samples[count % (BATCH * BLOCKS)] = evaluate::<FUSED, WIDTH, DEPTH, T>(
                        &batch[i],
                        tile,
                        number,
                        (start + i) as i32,
                        group(&self.state.entries_used, number),
                    );
                    count += 1;
                }
            }
            let mut evaluated = samples.iter();
            for (i, entry) in entries.iter().enumerate().rev() {
                if entry.blocks == 0 {
                    continue;
                }
                let mut lane_sums = [[T::ZERO; WIDTH]; sum::OF_PIXELS];
                for (number, sample) in groups::<WIDTH>(entry.blocks).zip(evaluated.by_ref()) {
                    blend_vjp::<FUSED, WIDTH, DEPTH, T>(
                        &batch[i],
                        tile,
                        number,
                        sample,
                        pixels,
                        &mut lane_sums,
                    );
                }
                for (quarters, lanes) in quarters[i].iter_mut().zip(&lane_sums).take(used_sums) {
                    *quarters = add_quarters(lanes);
                    // Stops the compiler from vectorising across the sums: that gathers single
                    // lanes and is several times slower.
                    black_box(quarters);
                }
            }
            for ((slot, entry), quarters) in slots.zip(entries).zip(&quarters) {
                let sums = &mut self.sums[slot];
                *sums = PixelSums::default();
                if entry.blocks != 0 {
                    sums.0[sum::TILES] = T::ONE;
                    for (sum, [a, b, c, d]) in sums.0.iter_mut().zip(*quarters) {
                        *sum = (a + b) + (c + d);
                    }
                }
            }
        }
    }
}

/// Sums of every fourth lane. They are added up only at the end of the batch: reading them back at
/// once would stall on store forwarding.
#[inline(always)]
fn add_quarters<T: Real, const WIDTH: usize>(lanes: &[T; WIDTH]) -> [T; 4] {
    std::array::from_fn(|i| {
        let pair = |first: usize| lanes[first + i] + lanes[first + i + 4];
        if WIDTH == 8 {
            pair(0)
        } else {
            pair(0) + pair(8)
        }
    })
}

/// The groups of `WIDTH` pixels that contain any of the blocks.
#[inline(always)]
fn groups<const WIDTH: usize>(blocks: BlockSet) -> impl Iterator<Item = usize> {
    let first_blocks = if WIDTH == LANES {
        blocks
    } else {
        (blocks | blocks >> 1) & (BlockSet::MAX / 3)
    };
    ones(first_blocks).map(|block| block / (WIDTH / LANES))
}

/// A splat evaluated at a group of pixels.
#[derive(Clone, Copy)]
struct Evaluated<T, const WIDTH: usize> {
    /// Not clamped; 0 where the pixel did not take the splat.
    alpha: [T; WIDTH],
    /// 1 / (1 - clamped alpha).
    inverse_rest: [T; WIDTH],
    /// 1 / (normal . ray) where the depth is the plane's, else 0.
    inverse_n_ray: [T; WIDTH],
}

/// Evaluates the splat of entry `position`.
#[inline(always)]
fn evaluate<const FUSED: bool, const WIDTH: usize, const DEPTH: bool, T: Real>(
    splat: &Splat<T>,
    tile: &TilePixels<T>,
    number: usize,
    position: i32,
    entries_used: &[u32; WIDTH],
) -> Evaluated<T, WIDTH> {
    let (splat, entries_used) = (*splat, *entries_used);
    let alpha_min = T::from_f64(ALPHA_MIN);
    let alpha_max = T::from_f64(ALPHA_MAX);
    let [u, v, min_n_ray] = tile.group::<WIDTH>(number);
    let mut evaluated = Evaluated {
        alpha: [T::ZERO; WIDTH],
        inverse_rest: [T::ZERO; WIDTH],
        inverse_n_ray: [T::ZERO; WIDTH],
    };
    for lane in 0..WIDTH {
        let sample = Sample::new::<FUSED>(&splat, u[lane], v[lane], min_n_ray[lane]);
        let took = (sample.alpha >= alpha_min) & (position < entries_used[lane] as i32);
        let alpha = if took { sample.alpha } else { T::ZERO };
        let rest = T::ONE - alpha.min(alpha_max);
        evaluated.alpha[lane] = alpha;
        if DEPTH {
            // Two inverses from one division, the slowest operation here.
            let inverse = T::ONE / (rest * sample.n_ray);
            evaluated.inverse_rest[lane] = inverse * sample.n_ray;
            let inverse_n_ray = inverse * rest;
            evaluated.inverse_n_ray[lane] = if sample.on_plane {
                inverse_n_ray
            } else {
                T::ZERO
            };
        } else {
            evaluated.inverse_rest[lane] = T::ONE / rest;
        }
    }
    evaluated
}

/// Visits a splat at a group of pixels: updates their state and adds to the splat's sums.
#[inline(always)]
fn blend_vjp<const FUSED: bool, const WIDTH: usize, const DEPTH: bool, T: Real>(
    splat: &Splat<T>,
    tile: &TilePixels<T>,
    number: usize,
    sample: &Evaluated<T, WIDTH>,
    pixels: &mut Pixels<T>,
    sums: &mut LaneSums<T, WIDTH>,
) {
    // Copies: choosing between two fields of a reference would become a conditional load.
    let (splat, sample) = (*splat, *sample);
    let alpha_max = T::from_f64(ALPHA_MAX);
    let [u, v, _] = tile.group::<WIDTH>(number);
    let d_red: [T; WIDTH] = *group(&pixels.d_red, number);
    let d_green: [T; WIDTH] = *group(&pixels.d_green, number);
    let d_blue: [T; WIDTH] = *group(&pixels.d_blue, number);
    let d_depth: [T; WIDTH] = *group(&pixels.d_depth, number);
    let d_alpha: [T; WIDTH] = *group(&pixels.d_alpha, number);
    let mut transmittances: [T; WIDTH] = *group(&pixels.transmittance, number);
    let mut behinds: [T; WIDTH] = *group(&pixels.behind, number);
    for lane in 0..WIDTH {
        let raw_alpha = sample.alpha[lane];
        let alpha = raw_alpha.min(alpha_max);
        let inverse_rest = sample.inverse_rest[lane];
        let inverse_n_ray = sample.inverse_n_ray[lane];
        let on_plane = inverse_n_ray > T::ZERO;
        let before = transmittances[lane] * inverse_rest;
        let weight = before * alpha;
        // The loss's derivative by this entry's weight.
        let value = mul_add::<FUSED, T>(d_red[lane], splat.color[0], d_alpha[lane]);
        let value = mul_add::<FUSED, T>(d_green[lane], splat.color[1], value);
        let value = mul_add::<FUSED, T>(d_blue[lane], splat.color[2], value);
        let value = if DEPTH {
            let plane_depth = splat.plane_offset * inverse_n_ray;
            let depth = if on_plane {
                plane_depth
            } else {
                splat.center_depth
            };
            mul_add::<FUSED, T>(d_depth[lane], depth, value)
        } else {
            value
        };
        // d weight / d alpha = before; each weight behind scales with 1 - alpha.
        let behind = behinds[lane];
        let d_sample_alpha = mul_add::<FUSED, T>(before, value, -(behind * inverse_rest));
        transmittances[lane] = before;
        behinds[lane] = mul_add::<FUSED, T>(weight, value, behind);

        let mut add = |sum: usize, a: T, b: T| {
            sums[sum][lane] = mul_add::<FUSED, T>(a, b, sums[sum][lane]);
        };
        add(sum::COLOR, weight, d_red[lane]);
        add(sum::COLOR + 1, weight, d_green[lane]);
        add(sum::COLOR + 2, weight, d_blue[lane]);

        let dx = u[lane] - splat.mean2d[0];
        let dy = v[lane] - splat.mean2d[1];
        let [p, q] = splat.whitened::<FUSED>(dx, dy);
        let g = d_sample_alpha * alpha;
        let g = if raw_alpha <= alpha_max { g } else { T::ZERO };
        let (gp, gq) = (g * p, g * q);
        add(sum::GPP, gp, p);
        add(sum::GPQ, gp, q);
        add(sum::GQQ, gq, q);

        sums[sum::G][lane] += g;
        sums[sum::GP][lane] += gp;
        sums[sum::GQ][lane] += gq;

        if DEPTH {
            let h = weight * d_depth[lane];
            let h_center = if on_plane { T::ZERO } else { h };
            let ht = h * inverse_n_ray;
            let htt = ht * inverse_n_ray;
            sums[sum::HTT_DX][lane] = mul_add::<FUSED, T>(htt, dx, sums[sum::HTT_DX][lane]);
            sums[sum::HTT_DY][lane] = mul_add::<FUSED, T>(htt, dy, sums[sum::HTT_DY][lane]);
            sums[sum::CENTER][lane] += h_center;
            sums[sum::HT][lane] += ht;
            sums[sum::HTT][lane] += htt;
        }
    }
    *group_mut(&mut pixels.transmittance, number) = transmittances;
    *group_mut(&mut pixels.behind, number) = behinds;
}
