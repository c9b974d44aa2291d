//! The CPU rasteriser: renders gaussians to colour, depth and alpha, and propagates image
//! derivatives back to the gaussians' parameters.
//!
//! Forward: project each gaussian and find the pixel blocks it touches (`project`, `bounds`), build
//! a depth-sorted list per tile (`tiles`), blend each tile (`sample`, `forward`). Backward: walk
//! each tile's list in reverse (`backward`), then differentiate the projection (`project_vjp`).
//! Invariant: every sum has a fixed order, so results do not depend on the number of threads.

mod backward;
mod bounds;
mod chunks;
mod cull;
mod forward;
mod lanes;
mod prefetch;
mod project;
mod project_vjp;
mod real;
mod render_pass;
mod sample;
mod tiles;

use std::ops::Range;

use fgs_geom::View;
use rayon::prelude::*;

pub(crate) use bounds::SLACK_PX;
use bounds::{TILE_HEIGHT, TileGrid};
use chunks::{CHUNK, Chunk, ProjectChunk};
pub(crate) use cull::Frustum;
use forward::{BlendTile, TileState};
pub(crate) use project::{ScreenCamera, WHITEN_SCALE};
use project_vjp::PixelSums;
pub use real::Real;
pub use render_pass::RenderPass;
use tiles::{TileLists, split_by_tile_row, take_front};

use crate::kernel::dispatch;
use crate::{Gaussians, Rendered};

/// Renders gaussians. Keeps its buffers, so that repeated passes hardly allocate.
#[derive(Debug, Default)]
pub struct Rasterizer<T: Real = f32> {
    chunks: Vec<Chunk<T>>,
    lists: TileLists<T>,
    /// Per tile.
    states: Vec<TileState<T>>,
    /// Per slot of the tiles' lists.
    sums: Vec<PixelSums<T>>,
    rendered: Rendered<T>,
}

impl<T: Real> Rasterizer<T> {
    /// Renders a view. Skips damaged gaussians: non-finite or absurdly large values, zero
    /// quaternions.
    ///
    /// # Panics
    /// If the gaussians' arrays differ in length.
    pub fn render<'a>(&'a mut self, gaussians: &'a Gaussians<T>, view: &View) -> RenderPass<'a, T> {
        self.render_rows(gaussians, view, 0..view.camera.height)
    }

    /// Renders a view from top to bottom in bands, so that pictures of any size take little memory: hands
    /// over each band's images, which together are those of [`render`](Self::render) to the last bit. A
    /// band has at most `max_pixels`, unless a row of tiles (16 rows of pixels) has more. An error ends it.
    ///
    /// # Errors
    /// Those of `take`.
    ///
    /// # Panics
    /// As [`render`](Self::render).
    pub fn render_bands<E>(
        &mut self,
        gaussians: &Gaussians<T>,
        view: &View,
        max_pixels: usize,
        mut take: impl FnMut(&Rendered<T>) -> Result<(), E>,
    ) -> Result<(), E> {
        let (width, height) = (view.camera.width, view.camera.height);
        let tile_rows = (max_pixels / (TILE_HEIGHT * width.max(1))).max(1);
        let rows = tile_rows * TILE_HEIGHT;
        for top in (0..height).step_by(rows) {
            let band = top..height.min(top + rows);
            take(self.render_rows(gaussians, view, band).rendered())?;
        }
        Ok(())
    }

    /// `rows` begins at a multiple of `TILE_HEIGHT`.
    fn render_rows<'a>(
        &'a mut self,
        gaussians: &'a Gaussians<T>,
        view: &View,
        rows: Range<usize>,
    ) -> RenderPass<'a, T> {
        let camera = ScreenCamera::new(view);
        let grid = TileGrid::new(camera.width, rows);
        self.project(gaussians, &camera, &grid);
        self.lists.deal(&grid, &mut self.chunks);
        self.blend(&camera, &grid);
        RenderPass {
            scratch: self,
            gaussians,
            camera,
            grid,
        }
    }

    /// Fills `chunks`.
    fn project(&mut self, gaussians: &Gaussians<T>, camera: &ScreenCamera<T>, grid: &TileGrid) {
        let frustum = &Frustum::new(camera);
        let tasks = gaussians.len().div_ceil(CHUNK);
        self.chunks.resize_with(tasks, Chunk::default);
        self.chunks
            .par_iter_mut()
            .enumerate()
            .for_each(|(task, chunk)| {
                dispatch(ProjectChunk {
                    gaussians,
                    first: task * CHUNK,
                    camera,
                    frustum,
                    grid,
                    chunk,
                });
            });
    }

    /// Sorts each tile's list and blends it: fills `rendered`, `states` and `lists.entries`.
    fn blend(&mut self, camera: &ScreenCamera<T>, grid: &TileGrid) {
        let Self {
            chunks,
            lists,
            states,
            rendered,
            ..
        } = self;
        rendered.resize(grid.width, grid.height);
        states.resize_with(grid.len(), TileState::default);
        let (starts, dealt) = (&lists.starts, &lists.dealt);
        let row_pixels = TILE_HEIGHT * grid.width.max(1);
        (
            rendered.color.data_mut().par_chunks_mut(row_pixels),
            rendered.depth_m.data_mut().par_chunks_mut(row_pixels),
            rendered.alpha.data_mut().par_chunks_mut(row_pixels),
            states.par_chunks_mut(grid.columns.max(1)),
            split_by_tile_row(&mut lists.order, starts, grid),
            split_by_tile_row(&mut lists.entries, starts, grid),
        )
            .into_par_iter()
            .enumerate()
            .for_each(
                |(row, (color, depth_m, alpha, states, mut order, mut entries))| {
                    for (column, state) in states.iter_mut().enumerate() {
                        let tile = row * grid.columns + column;
                        let len = starts[tile + 1] - starts[tile];
                        let order = take_front(&mut order, len);
                        let entries = take_front(&mut entries, len);
                        order.sort_unstable();
                        for (entry, key) in entries.iter_mut().zip(order) {
                            *entry = dealt[T::sorted_index(*key) as usize];
                        }
                        dispatch(BlendTile {
                            tile,
                            grid,
                            camera,
                            entries,
                            chunks,
                            state,
                            color: &mut *color,
                            depth_m: &mut *depth_m,
                            alpha: &mut *alpha,
                        });
                    }
                },
            );
    }
}

#[cfg(test)]
pub(crate) mod tests;
