//! One gaussian at one pixel: its alpha and its depth. The forward and the backward pass call the
//! same function, so that both see the same bits. Branch-free: runs over the lanes of a block.

use super::bounds::{BLOCK, BLOCKS, LANES, TILE, TILE_BLOCKS, TileGrid};
use super::project::{ScreenCamera, Splat};
use super::real::Real;
use crate::rendering::PLANE_MIN_COS;

/// A value for each pixel of a block.
pub(super) type Lanes<T> = [T; LANES];

/// A splat evaluated at a pixel.
pub(super) struct Sample<T> {
    pub dx: T,
    pub dy: T,
    pub p: T,
    pub q: T,
    /// Not clamped.
    pub alpha: T,
    /// 1 / (normal . ray) where `on_plane`, else some finite value.
    pub inverse_n_ray: T,
    /// Whether the depth is the plane's, not the centre's.
    pub on_plane: bool,
    pub depth: T,
}

impl<T: Real> Sample<T> {
    /// `min_n_ray` is `PLANE_MIN_COS` times the length of the pixel's ray.
    #[inline(always)]
    pub fn new(splat: &Splat<T>, dx: T, dy: T, min_n_ray: T) -> Self {
        let p = splat.whiten_xx * dx + splat.whiten_xy * dy;
        let q = splat.whiten_yy * dy;
        let alpha = splat.opacity * (-(p * p + q * q)).exp2_nonpositive();
        let n_ray = splat.plane[0] + splat.plane[1] * dx + splat.plane[2] * dy;
        let on_plane = n_ray >= min_n_ray;
        let inverse_n_ray = T::ONE / n_ray.max(min_n_ray);
        let depth = if on_plane {
            splat.plane_offset * inverse_n_ray
        } else {
            splat.center_depth
        };
        Self {
            dx,
            dy,
            p,
            q,
            alpha,
            inverse_n_ray,
            on_plane,
            depth,
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
        let origin = [tile % grid.columns * TILE, tile / grid.columns * TILE];
        let number = |value: usize| T::from_f64(value as f64);
        let lane_x = std::array::from_fn(|lane| number(lane % BLOCK));
        let lane_y = std::array::from_fn(|lane| number(lane / BLOCK));
        let block_x = std::array::from_fn(|b| number(origin[0] + b % TILE_BLOCKS * BLOCK));
        let block_y = std::array::from_fn(|b| number(origin[1] + b / TILE_BLOCKS * BLOCK));
        let mut min_n_ray = [[T::ZERO; LANES]; BLOCKS];
        for (block, lanes) in min_n_ray.iter_mut().enumerate() {
            for lane in 0..LANES {
                let x = (block_x[block] + lane_x[lane] - camera.center[0]) / camera.focal[0];
                let y = (block_y[block] + lane_y[lane] - camera.center[1]) / camera.focal[1];
                lanes[lane] = T::from_f64(PLANE_MIN_COS) * (x * x + y * y + T::ONE).sqrt();
            }
        }
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
        for row in 0..TILE.min(grid.height - v0) {
            for column in 0..TILE.min(grid.width - u0) {
                let block = row / BLOCK * TILE_BLOCKS + column / BLOCK;
                let lane = row % BLOCK * BLOCK + column % BLOCK;
                visit(block, lane, row * grid.width + u0 + column);
            }
        }
    }
}
