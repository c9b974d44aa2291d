//! One gaussian at one pixel: its alpha and its depth. The forward and the backward pass call the
//! same function, so that both see the same bits. Branch-free: runs over the lanes of a block.

use super::bounds::{BLOCK, BLOCKS, TILE_COLUMNS, TILE_HEIGHT, TILE_ROWS, TILE_WIDTH, TileGrid};
use super::lanes::{LANES, Lanes};
use super::project::{ScreenCamera, Splat};
use super::real::Real;
use crate::kernel::mul_add;
use crate::rendering::PLANE_MIN_COS;

/// A splat evaluated at a pixel.
pub(super) struct Sample<T> {
    pub dx: T,
    pub dy: T,
    pub p: T,
    pub q: T,
    /// Not clamped.
    pub alpha: T,
    /// normal . ray where `on_plane`, else some positive value.
    pub n_ray: T,
    /// Whether the depth is the plane's, `plane_offset / n_ray`, not the centre's.
    pub on_plane: bool,
}

impl<T: Real> Sample<T> {
    /// `min_n_ray` is `PLANE_MIN_COS` times the length of the pixel's ray.
    #[inline(always)]
    pub fn new<const FUSED: bool>(splat: &Splat<T>, dx: T, dy: T, min_n_ray: T) -> Self {
        let p = mul_add::<FUSED, T>(splat.whiten_xx, dx, splat.whiten_xy * dy);
        let q = splat.whiten_yy * dy;
        let exponent = mul_add::<FUSED, T>(p, p, q * q);
        let alpha = splat.opacity * exponent.exp2_neg::<FUSED>();
        let n_ray = mul_add::<FUSED, T>(splat.plane[1], dx, splat.plane[0]);
        let n_ray = mul_add::<FUSED, T>(splat.plane[2], dy, n_ray);
        Self {
            dx,
            dy,
            p,
            q,
            alpha,
            n_ray: n_ray.max(min_n_ray),
            on_plane: n_ray >= min_n_ray,
        }
    }
}

/// The pixels of one tile.
pub(super) struct TilePixels<T> {
    /// Column and row of the tile's first pixel.
    pub origin: [usize; 2],
    /// Per block, the coordinates of its first pixel.
    pub block_x: [T; BLOCKS],
    pub block_y: [T; BLOCKS],
    /// Per lane, the offset from the block's first pixel.
    pub lane_x: Lanes<T>,
    pub lane_y: Lanes<T>,
    /// Per block and lane, `PLANE_MIN_COS` times the length of the pixel's ray.
    pub min_n_ray: [Lanes<T>; BLOCKS],
}

impl<T: Real> TilePixels<T> {
    #[inline(always)]
    pub fn new(tile: usize, grid: &TileGrid, camera: &ScreenCamera<T>) -> Self {
        let origin = [
            tile % grid.columns * TILE_WIDTH,
            tile / grid.columns * TILE_HEIGHT,
        ];
        let number = |value: usize| T::from_f64(value as f64);
        let lane_x = std::array::from_fn(|lane| number(lane % BLOCK));
        let lane_y = std::array::from_fn(|lane| number(lane / BLOCK));
        let block_x = std::array::from_fn(|b| number(origin[0] + b % TILE_COLUMNS * BLOCK));
        let block_y = std::array::from_fn(|b| number(origin[1] + b / TILE_COLUMNS * BLOCK));
        // c^2 (x^2 + 1) and c^2 y^2 of the rays through the pixels of each column and row of blocks.
        let min_cos2 = T::from_f64(PLANE_MIN_COS * PLANE_MIN_COS);
        let mut columns = [[T::ZERO; LANES]; TILE_COLUMNS];
        let mut rows = [[T::ZERO; LANES]; TILE_ROWS];
        for (column, lanes) in columns.iter_mut().enumerate() {
            for lane in 0..LANES {
                let x = (block_x[column] + lane_x[lane] - camera.center[0]) / camera.focal[0];
                lanes[lane] = min_cos2 * (x * x + T::ONE);
            }
        }
        for (row, lanes) in rows.iter_mut().enumerate() {
            for lane in 0..LANES {
                let v = block_y[row * TILE_COLUMNS] + lane_y[lane];
                let y = (v - camera.center[1]) / camera.focal[1];
                lanes[lane] = min_cos2 * (y * y);
            }
        }
        let min_n_ray = std::array::from_fn(|block| {
            let (column, row) = (&columns[block % TILE_COLUMNS], &rows[block / TILE_COLUMNS]);
            std::array::from_fn(|lane| (column[lane] + row[lane]).sqrt())
        });
        Self {
            origin,
            block_x,
            block_y,
            lane_x,
            lane_y,
            min_n_ray,
        }
    }

    /// Calls `visit(block, lane, pixel)` for each pixel of the tile that lies in the image;
    /// `pixel` counts row-major from the first row of the tile.
    #[inline(always)]
    pub fn for_each_pixel(&self, grid: &TileGrid, mut visit: impl FnMut(usize, usize, usize)) {
        let [u0, v0] = self.origin;
        for row in 0..TILE_HEIGHT.min(grid.height - v0) {
            for column in 0..TILE_WIDTH.min(grid.width - u0) {
                let block = row / BLOCK * TILE_COLUMNS + column / BLOCK;
                let lane = row % BLOCK * BLOCK + column % BLOCK;
                visit(block, lane, row * grid.width + u0 + column);
            }
        }
    }
}
