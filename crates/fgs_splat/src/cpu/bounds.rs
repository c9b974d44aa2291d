//! Which pixel blocks a gaussian's support touches.
//!
//! The image is divided into tiles of 32x16 pixels, and each tile into 16x4 blocks of 2x4 pixels. A
//! block fills 8 SIMD lanes; kernels with 16 lanes process two neighbouring blocks, 4x4 pixels.
//! Bounds are computed from the ellipse and are conservative: blending tests each pixel anyway.

use std::ops::Range;

use super::lanes::LANES;
use super::project::Splat;
use super::real::Real;
use crate::rendering::ALPHA_MIN;

/// Pixels from left to right of a block.
pub(super) const BLOCK_WIDTH: usize = 2;
/// Pixels from top to bottom of a block.
pub(super) const BLOCK_HEIGHT: usize = 4;
const _: () = assert!(BLOCK_WIDTH * BLOCK_HEIGHT == LANES);
/// Blocks from left to right of a tile. Each tile a gaussian touches adds overhead, so tiles are as
/// large as the L1 cache allows for the state of their pixels.
pub(super) const TILE_COLUMNS: usize = 16;
/// Blocks from top to bottom of a tile.
pub(super) const TILE_ROWS: usize = 4;
/// Blocks of a tile.
pub(super) const BLOCKS: usize = TILE_COLUMNS * TILE_ROWS;
/// Pixels from left to right of a tile.
pub(super) const TILE_WIDTH: usize = BLOCK_WIDTH * TILE_COLUMNS;
/// Pixels from top to bottom of a tile.
pub(super) const TILE_HEIGHT: usize = BLOCK_HEIGHT * TILE_ROWS;
/// Pixels of a tile.
pub(super) const TILE_PIXELS: usize = LANES * BLOCKS;
/// A bit for each block of a tile: bit `TILE_COLUMNS * row + column`.
pub(super) type BlockSet = u64;
const _: () = assert!(BLOCKS == BlockSet::BITS as usize);

/// A gaussian's presence in a tile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Touch {
    /// Row-major number of the tile.
    pub tile: u32,
    /// Index of the gaussian's splat in its chunk.
    pub splat: u16,
    /// Blocks that the gaussian may touch.
    pub blocks: BlockSet,
}

/// The tiles of an image, or of a band of its rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct TileGrid {
    /// The image's row with which the first tiles begin: a multiple of `TILE_HEIGHT`.
    pub top: usize,
    pub width: usize,
    /// Rows of pixels from `top` on.
    pub height: usize,
    pub columns: usize,
    pub rows: usize,
}

impl TileGrid {
    pub fn new(width: usize, rows: Range<usize>) -> Self {
        Self {
            top: rows.start,
            width,
            height: rows.len(),
            columns: width.div_ceil(TILE_WIDTH),
            rows: rows.len().div_ceil(TILE_HEIGHT),
        }
    }

    /// The image's row below the last one.
    pub fn bottom(&self) -> usize {
        self.top + self.height
    }

    pub fn len(&self) -> usize {
        self.columns * self.rows
    }
}

/// The ellipse inside which a splat's alpha reaches `ALPHA_MIN`, and the pixel rows it may touch.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Support<T> {
    /// Squared radius in whitened coordinates.
    radius2: T,
    /// dy of the rightmost point; the leftmost has its negative.
    rightmost_dy: T,
    first_row: i32,
    last_row: i32,
}

/// Margin for rounding, pixels.
pub(crate) const SLACK_PX: f64 = 1e-2;

/// Tiles of a row that are processed together: the block columns of so many tiles, and one more
/// bit, fit into 64 bits.
const STRIP: i32 = 3;

/// Rows of blocks that are processed together.
const BANDS: usize = 8;

/// A bit for each column of blocks of a tile.
const ROW: BlockSet = (1 << TILE_COLUMNS) - 1;

impl<T: Real> Support<T> {
    /// Branch-free: runs over lanes of gaussians.
    #[inline(always)]
    pub fn new(splat: &Splat<T>, grid: &TileGrid) -> Self {
        // Where alpha reaches `ALPHA_MIN`, plus more than the rounding error of a pixel's exponent.
        let exact = (splat.opacity * T::from_f64(1.0 / ALPHA_MIN)).log2_at_least();
        let radius2 = (exact * T::from_f64(1.001) + T::from_f64(1e-3)).max(T::ZERO);
        let radius = radius2.sqrt();
        let (wxy, wyy) = (splat.whiten_xy, splat.whiten_yy);
        let reach_y = radius / wyy + T::from_f64(SLACK_PX);
        let mean_y = splat.mean2d[1];
        let (first_row, last_row) = pixels(mean_y - reach_y, mean_y + reach_y, grid.bottom());
        Self {
            radius2,
            rightmost_dy: -wxy * radius / (wyy * (wyy * wyy + wxy * wxy).sqrt()),
            first_row: first_row.max(grid.top as i32),
            last_row,
        }
    }

    /// Appends a touch for every tile touched, row by row. `number` is the splat's index in its
    /// chunk.
    #[inline(always)]
    pub fn push_touches(
        &self,
        splat: &Splat<T>,
        number: u16,
        grid: &TileGrid,
        touches: &mut Vec<Touch>,
    ) {
        if self.first_row > self.last_row {
            return;
        }
        let (tile, tile_blocks) = (TILE_HEIGHT as i32, TILE_COLUMNS as i32);
        let last_tile_row = self.last_row / tile;
        let top_tile_row = grid.top as i32 / tile;
        for group in (self.first_row / tile..=last_tile_row).step_by(BANDS / TILE_ROWS) {
            let (first, end) = self.columns(splat, grid, group * tile);
            let first_tile = first.iter().fold(i32::MAX, |a, &b| a.min(b)) / tile_blocks;
            let end_tile = (end.iter().fold(0, |a, &b| a.max(b)) + tile_blocks - 1) / tile_blocks;
            for strip in (first_tile..end_tile).step_by(STRIP as usize) {
                let origin = strip * tile_blocks;
                let width = STRIP * tile_blocks;
                // The blocks touched in each row of blocks.
                let mut bands: [BlockSet; BANDS] = [0; BANDS];
                for lane in 0..BANDS {
                    let from = (first[lane] - origin).max(0).min(width);
                    let to = (end[lane] - origin).min(width).max(from);
                    bands[lane] = (1 << to) - (1 << from);
                }
                let rows = bands.chunks_exact(TILE_ROWS);
                for (tile_row, bands) in (group..=last_tile_row).zip(rows) {
                    let first_of_row = (tile_row - top_tile_row) * grid.columns as i32;
                    for tile_column in strip..end_tile.min(strip + STRIP) {
                        let shift = (tile_column - strip) * tile_blocks;
                        let mut blocks = 0;
                        for (band, columns) in bands.iter().enumerate() {
                            blocks |= (columns >> shift & ROW) << (band * TILE_COLUMNS);
                        }
                        if blocks != 0 {
                            touches.push(Touch {
                                tile: (first_of_row + tile_column) as u32,
                                splat: number,
                                blocks,
                            });
                        }
                    }
                }
            }
        }
    }

    /// The half-open range of block columns touched in each of `BANDS` rows of blocks, the first of
    /// which starts at pixel row `row`. An empty range is `i32::MAX / 2..0`.
    #[inline(always)]
    fn columns(&self, splat: &Splat<T>, grid: &TileGrid, row: i32) -> ([i32; BANDS], [i32; BANDS]) {
        let slack = T::from_f64(SLACK_PX);
        let (wxy, wyy) = (splat.whiten_xy, splat.whiten_yy);
        let [mean_x, mean_y] = splat.mean2d;
        let (block_width, block_height) = (BLOCK_WIDTH as i32, BLOCK_HEIGHT as i32);
        let width = T::ONE / splat.whiten_xx;
        let edge = |dy: T, side: T| {
            let q = wyy * dy;
            (side * (self.radius2 - q * q).max(T::ZERO).sqrt() - wxy * dy) * width
        };
        let (mut firsts, mut ends) = ([0; BANDS], [0; BANDS]);
        for lane in 0..BANDS {
            let top = row + lane as i32 * block_height;
            let bottom = (top + block_height - 1).min(self.last_row);
            let top = top.max(self.first_row);
            let dy_top = T::from_i32(top) - mean_y - slack;
            let dy_bottom = T::from_i32(bottom) - mean_y + slack;
            let right = edge(self.rightmost_dy.max(dy_top).min(dy_bottom), T::ONE) + slack;
            let left = edge((-self.rightmost_dy).max(dy_top).min(dy_bottom), -T::ONE) - slack;
            let (first, last) = pixels(mean_x + left, mean_x + right, grid.width);
            let touched = (top <= bottom) & (first <= last);
            firsts[lane] = if touched {
                first / block_width
            } else {
                i32::MAX / 2
            };
            ends[lane] = if touched { last / block_width + 1 } else { 0 };
        }
        (firsts, ends)
    }
}

/// First and last integer within both `[low, high]` and `[0, size)`; first > last if there is none.
#[inline(always)]
fn pixels<T: Real>(low: T, high: T, size: usize) -> (i32, i32) {
    let end = T::from_i32(size as i32);
    let first = -(-low.max(-T::ONE).min(end)).floor_i32();
    let last = high.max(-T::ONE).min(end).floor_i32();
    (first.max(0), last.min(size as i32 - 1))
}
