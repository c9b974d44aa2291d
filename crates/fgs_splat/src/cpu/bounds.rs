//! Which pixel blocks a gaussian's support touches.
//!
//! An image is cut into tiles of 16x16 pixels and each tile into 4x4 blocks of 4x4 pixels, whose
//! 16 pixels the blending handles as 16 lanes. Bounds come from the ellipse itself and are never
//! too small: blending decides each pixel anyway.

use super::lanes::{LANES, Lanes};
use super::project::Splat;
use super::real::Real;
use crate::rendering::ALPHA_MIN;

/// Pixels along a side of a block. 4x4 blocks waste fewer lanes at an ellipse's rim than 16x1.
pub(super) const BLOCK: usize = 4;
/// A block's pixels are worked on together.
const _: () = assert!(BLOCK * BLOCK == LANES);
/// Blocks along a side of a tile.
pub(super) const TILE_BLOCKS: usize = 4;
/// Blocks of a tile.
pub(super) const BLOCKS: usize = TILE_BLOCKS * TILE_BLOCKS;
/// Pixels along a side of a tile.
pub(super) const TILE: usize = BLOCK * TILE_BLOCKS;

/// A gaussian's presence in a tile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Touch {
    /// Row-major number of the tile.
    pub tile: u32,
    /// Bit `TILE_BLOCKS * row + column` is set for each block that may be touched.
    pub blocks: u16,
}

/// The tiles of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct TileGrid {
    pub width: usize,
    pub height: usize,
    pub columns: usize,
    pub rows: usize,
}

impl TileGrid {
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            columns: width.div_ceil(TILE),
            rows: height.div_ceil(TILE),
        }
    }

    pub fn len(&self) -> usize {
        self.columns * self.rows
    }
}

/// Columns of blocks `first..end` that a splat touches in each of 16 bands: rows of blocks, one
/// below the other.
struct Bands {
    first: Lanes<i32>,
    end: Lanes<i32>,
}

/// The ellipse of a splat's support, and the rows of pixels that it may touch.
struct Support<T> {
    /// Squared radius in whitened coordinates.
    radius2: T,
    /// The rightmost point has this dy, the leftmost its negative.
    rightmost_dy: T,
    first_row: i32,
    last_row: i32,
}

/// Pixels that the ellipse is larger than it should be, for what rounding does.
const SLACK_PX: f64 = 1e-2;

impl<T: Real> Support<T> {
    #[inline(always)]
    fn new(splat: &Splat<T>, grid: &TileGrid) -> Self {
        // Where alpha reaches `ALPHA_MIN`. Rounding may put a pixel's exponent a little off: the
        // support grows by more than that.
        let exact = (splat.opacity * T::from_f64(1.0 / ALPHA_MIN)).log2();
        let radius2 = (exact * T::from_f64(1.001) + T::from_f64(1e-3)).max(T::ZERO);
        let radius = radius2.sqrt();
        let (wxy, wyy) = (splat.whiten_xy, splat.whiten_yy);
        let reach_y = radius / wyy + T::from_f64(SLACK_PX);
        let mean_y = splat.mean2d[1];
        let (first_row, last_row) = pixels(mean_y - reach_y, mean_y + reach_y, grid.height);
        Self {
            radius2,
            rightmost_dy: -wxy * radius / (wyy * (wyy * wyy + wxy * wxy).sqrt()),
            first_row,
            last_row,
        }
    }

    /// The bands from the one whose first row of pixels is `row`.
    #[inline(always)]
    fn bands(&self, splat: &Splat<T>, grid: &TileGrid, row: i32) -> Bands {
        let slack = T::from_f64(SLACK_PX);
        let (wxy, wyy) = (splat.whiten_xy, splat.whiten_yy);
        let [mean_x, mean_y] = splat.mean2d;
        let block = BLOCK as i32;
        let width = T::ONE / splat.whiten_xx;
        let edge = |dy: T, side: T| {
            let q = wyy * dy;
            (side * (self.radius2 - q * q).max(T::ZERO).sqrt() - wxy * dy) * width
        };
        let mut bands = Bands {
            first: [i32::MAX; LANES],
            end: [0; LANES],
        };
        for lane in 0..LANES {
            let top = row + lane as i32 * block;
            let bottom = (top + block - 1).min(self.last_row);
            let top = top.max(self.first_row);
            let dy_top = T::from_i32(top) - mean_y - slack;
            let dy_bottom = T::from_i32(bottom) - mean_y + slack;
            let right = edge(self.rightmost_dy.max(dy_top).min(dy_bottom), T::ONE) + slack;
            let left = edge((-self.rightmost_dy).max(dy_top).min(dy_bottom), -T::ONE) - slack;
            let (first, last) = pixels(mean_x + left, mean_x + right, grid.width);
            let touched = (top <= bottom) & (first <= last);
            bands.first[lane] = if touched { first / block } else { i32::MAX };
            bands.end[lane] = if touched { last / block + 1 } else { 0 };
        }
        bands
    }
}

/// Appends every tile that the splat's support touches, row by row.
#[inline(always)]
pub(super) fn push_touches<T: Real>(splat: &Splat<T>, grid: &TileGrid, touches: &mut Vec<Touch>) {
    let support = Support::new(splat, grid);
    let (tile, tile_blocks) = (TILE as i32, TILE_BLOCKS as i32);
    let first_tile_row = support.first_row / tile;
    let last_tile_row = support.last_row.div_euclid(tile);
    let rows_at_once = LANES / TILE_BLOCKS;
    for group in (first_tile_row..=last_tile_row).step_by(rows_at_once) {
        let bands = support.bands(splat, grid, group * tile);
        let rows = bands
            .first
            .chunks_exact(TILE_BLOCKS)
            .zip(bands.end.chunks_exact(TILE_BLOCKS));
        for (tile_row, (first, end)) in (group..=last_tile_row).zip(rows) {
            let first_column = first.iter().fold(i32::MAX, |a, &b| a.min(b)) / tile_blocks;
            let end_column = (end.iter().fold(0, |a, &b| a.max(b)) + tile_blocks - 1) / tile_blocks;
            for tile_column in first_column..end_column {
                let origin = tile_column * tile_blocks;
                let mut blocks = 0_u32;
                for band in 0..TILE_BLOCKS {
                    let from = first[band].clamp(origin, origin + tile_blocks) - origin;
                    let to = end[band].clamp(origin, origin + tile_blocks) - origin;
                    let columns = (1_u32 << to.max(from)) - (1 << from);
                    blocks |= columns << (band * TILE_BLOCKS);
                }
                if blocks != 0 {
                    touches.push(Touch {
                        tile: (tile_row * grid.columns as i32 + tile_column) as u32,
                        blocks: blocks as u16,
                    });
                }
            }
        }
    }
}

/// First and last integer in `[low, high]` and in `[0, size)`; the first is greater than the last
/// where there is none.
#[inline(always)]
fn pixels<T: Real>(low: T, high: T, size: usize) -> (i32, i32) {
    let end = T::from_i32(size as i32);
    let first = -(-low.max(-T::ONE).min(end)).floor_i32();
    let last = high.max(-T::ONE).min(end).floor_i32();
    (first.max(0), last.min(size as i32 - 1))
}
