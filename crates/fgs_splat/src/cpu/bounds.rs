//! Which pixel blocks a gaussian's support touches.
//!
//! An image is cut into tiles of 16x16 pixels and each tile into 4x4 blocks of 4x4 pixels, whose
//! 16 pixels the blending handles as 16 lanes. Bounds come from the ellipse itself and are never
//! too small: blending decides each pixel anyway.

use super::project::Splat;
use super::real::Real;

/// Pixels along a side of a block. 4x4 blocks waste fewer lanes at an ellipse's rim than 16x1.
pub(super) const BLOCK: usize = 4;
/// Pixels of a block.
pub(super) const LANES: usize = BLOCK * BLOCK;
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

/// Appends every tile that the splat's support touches, row by row.
#[inline(always)]
pub(super) fn push_touches<T: Real>(splat: &Splat<T>, grid: &TileGrid, touches: &mut Vec<Touch>) {
    // Rounding may put a pixel's exponent a little off: the support grows by more than that.
    let support = (splat.support * T::from_f64(1.001) + T::from_f64(1e-3)).max(T::ZERO);
    let slack = T::from_f64(1e-2);
    let (wxx, wxy, wyy) = (splat.whiten_xx, splat.whiten_xy, splat.whiten_yy);
    let radius = support.sqrt();
    let reach_y = radius / wyy + slack;
    let [mean_x, mean_y] = splat.mean2d;
    let Some((first_row, last_row)) = pixels(mean_y - reach_y, mean_y + reach_y, grid.height)
    else {
        return;
    };
    // The rightmost point of the ellipse has this dy, the leftmost its negative.
    let rightmost_dy = -wxy * radius / (wyy * (wyy * wyy + wxy * wxy).sqrt());
    let edge = |dy: T, side: T| {
        let q = wyy * dy;
        (side * (support - q * q).max(T::ZERO).sqrt() - wxy * dy) / wxx
    };

    let mut band_columns = [(0, 0); TILE_BLOCKS];
    for tile_row in first_row / TILE..=last_row / TILE {
        let (mut first, mut end) = (usize::MAX, 0);
        for (band, columns) in band_columns.iter_mut().enumerate() {
            let top = (tile_row * TILE + band * BLOCK).max(first_row);
            let bottom = (tile_row * TILE + band * BLOCK + BLOCK - 1).min(last_row);
            *columns = (0, 0);
            if top > bottom {
                continue;
            }
            let dy_top = T::from_f64(top as f64) - mean_y - slack;
            let dy_bottom = T::from_f64(bottom as f64) - mean_y + slack;
            let right = edge(rightmost_dy.max(dy_top).min(dy_bottom), T::ONE) + slack;
            let left = edge((-rightmost_dy).max(dy_top).min(dy_bottom), -T::ONE) - slack;
            if let Some((u_first, u_last)) = pixels(mean_x + left, mean_x + right, grid.width) {
                *columns = (u_first / BLOCK, u_last / BLOCK + 1);
                first = first.min(columns.0);
                end = end.max(columns.1);
            }
        }
        for tile_column in first / TILE_BLOCKS..end.div_ceil(TILE_BLOCKS) {
            let origin = tile_column * TILE_BLOCKS;
            let mut blocks = 0_u16;
            for (band, columns) in band_columns.iter().enumerate() {
                let from = columns.0.max(origin) - origin;
                let to = columns.1.clamp(origin, origin + TILE_BLOCKS) - origin;
                if from < to {
                    blocks |= ((1 << to) - (1 << from)) << (band * TILE_BLOCKS);
                }
            }
            if blocks != 0 {
                touches.push(Touch {
                    tile: (tile_row * grid.columns + tile_column) as u32,
                    blocks,
                });
            }
        }
    }
}

/// First and last integer in `[low, high]` and in `[0, size)`.
#[inline(always)]
fn pixels<T: Real>(low: T, high: T, size: usize) -> Option<(usize, usize)> {
    let first = (-(-low).floor_i64()).max(0);
    let last = high.floor_i64().min(size as i64 - 1);
    (first <= last).then_some((first as usize, last as usize))
}
