//! A gaussian's alpha and depth at a pixel. Forward and backward pass call the same function, so
//! that they agree to the bit. Branch-free: runs over lanes of pixels.

use std::ops::Range;

use super::bounds::{
    BLOCK_HEIGHT, BLOCK_WIDTH, TILE_COLUMNS, TILE_HEIGHT, TILE_PIXELS, TILE_ROWS, TILE_WIDTH,
    TileGrid,
};
use super::lanes::{LANES, group};
use super::project::{ScreenCamera, Splat};
use super::real::Real;
use crate::kernel::mul_add;
use crate::rendering::PLANE_MIN_COS;

/// A splat evaluated at a pixel.
pub(super) struct Sample<T> {
    /// Not clamped.
    pub alpha: T,
    /// normal . ray where `on_plane`, elsewhere some positive value.
    pub n_ray: T,
    /// Whether the depth is the plane's, `plane_offset / n_ray`, not the centre's.
    pub on_plane: bool,
}

impl<T: Real> Sample<T> {
    /// `min_n_ray` is `PLANE_MIN_COS` times the length of the pixel's ray.
    #[inline(always)]
    pub fn new<const FUSED: bool>(splat: &Splat<T>, u: T, v: T, min_n_ray: T) -> Self {
        let dx = u - splat.mean2d[0];
        let dy = v - splat.mean2d[1];
        let [p, q] = splat.whitened::<FUSED>(dx, dy);
        let exponent = mul_add::<FUSED, T>(p, p, q * q);
        let alpha = splat.opacity * exponent.exp2_neg::<FUSED>();
        let n_ray = mul_add::<FUSED, T>(splat.plane[1], dx, splat.plane[0]);
        let n_ray = mul_add::<FUSED, T>(splat.plane[2], dy, n_ray);
        Self {
            alpha,
            n_ray: n_ray.max(min_n_ray),
            on_plane: n_ray >= min_n_ray,
        }
    }
}

/// Pixels of a row of blocks.
const ROW_PIXELS: usize = LANES * TILE_COLUMNS;

/// The pixels of a tile, block by block, row-major within a block.
pub(super) struct TilePixels<T> {
    /// Column and row of the tile's first pixel.
    origin: [usize; 2],
    /// u of the pixels of a row of blocks.
    u: [T; ROW_PIXELS],
    /// v of the pixels of the first two blocks of each row of blocks.
    v: [T; 2 * LANES * TILE_ROWS],
    /// `PLANE_MIN_COS` times the length of each pixel's ray.
    min_n_ray: [T; TILE_PIXELS],
}

impl<T: Real> TilePixels<T> {
    #[inline(always)]
    pub fn new(tile: usize, grid: &TileGrid, camera: &ScreenCamera<T>) -> Self {
        let origin = [
            tile % grid.columns * TILE_WIDTH,
            grid.top + tile / grid.columns * TILE_HEIGHT,
        ];
        let number = |value: usize| T::from_i32(value as i32);
        let u: [T; ROW_PIXELS] = std::array::from_fn(|pixel| {
            number(origin[0] + pixel / LANES * BLOCK_WIDTH + pixel % BLOCK_WIDTH)
        });
        let v: [T; 2 * LANES * TILE_ROWS] = std::array::from_fn(|pixel| {
            let row = pixel / (2 * LANES) * BLOCK_HEIGHT;
            number(origin[1] + row + pixel % LANES / BLOCK_WIDTH)
        });
        // c^2 (x^2 + 1) and c^2 y^2 of the pixels' rays.
        let min_cos2 = T::from_f64(PLANE_MIN_COS * PLANE_MIN_COS);
        let across = u.map(|u| {
            let x = (u - camera.center[0]) / camera.focal[0];
            min_cos2 * (x * x + T::ONE)
        });
        let down = v.map(|v| {
            let y = (v - camera.center[1]) / camera.focal[1];
            min_cos2 * (y * y)
        });
        let mut min_n_ray = [T::ZERO; TILE_PIXELS];
        let rows = min_n_ray.as_chunks_mut::<ROW_PIXELS>().0;
        for (row, down) in rows.iter_mut().zip(down.as_chunks::<{ 2 * LANES }>().0) {
            for (pixel, (min_n_ray, across)) in row.iter_mut().zip(across).enumerate() {
                *min_n_ray = (across + down[pixel % LANES]).sqrt();
            }
        }
        Self {
            origin,
            u,
            v,
            min_n_ray,
        }
    }

    /// u, v and `min_n_ray` of a group of `WIDTH` pixels.
    #[inline(always)]
    pub fn group<const WIDTH: usize>(&self, number: usize) -> [[T; WIDTH]; 3] {
        let row = number * WIDTH / ROW_PIXELS;
        [
            *group(&self.u, number),
            *group(&self.v, row * (2 * LANES / WIDTH)),
            *group(&self.min_n_ray, number),
        ]
    }

    /// Calls `visit(places, pixels)` for each pixel row of the tile, clipped to the image: the
    /// pixels' places in the tile's order, and their range in the image, counted from the tile's
    /// first row.
    #[inline(always)]
    pub fn for_each_row(
        &self,
        grid: &TileGrid,
        mut visit: impl FnMut(&[usize; TILE_WIDTH], Range<usize>),
    ) {
        let [u0, v0] = self.origin;
        let width = TILE_WIDTH.min(grid.width - u0);
        for row in 0..TILE_HEIGHT.min(grid.bottom() - v0) {
            let in_row = row / BLOCK_HEIGHT * ROW_PIXELS + row % BLOCK_HEIGHT * BLOCK_WIDTH;
            let places = std::array::from_fn(|column| {
                in_row + column / BLOCK_WIDTH * LANES + column % BLOCK_WIDTH
            });
            let first = row * grid.width + u0;
            visit(&places, first..first + width);
        }
    }
}
