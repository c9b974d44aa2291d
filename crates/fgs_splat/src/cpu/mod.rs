//! The rasteriser on the CPU: gaussians and a view in, colour, depth and alpha out, and the way
//! back from their derivatives to the gaussians'.
//!
//! Stages: project each gaussian and find the pixel blocks it touches (`project`, `bounds`), make
//! a depth-sorted list for each tile (`tiles`), blend each tile (`sample`, `forward`); then each
//! tile backwards (`backward`) and each gaussian back to its parameters (`project_vjp`).
//! Invariant: every sum has a fixed order, so results do not depend on the number of threads.

mod backward;
mod bounds;
mod chunks;
mod forward;
mod project;
mod project_vjp;
mod real;
mod render_pass;
mod sample;
mod tiles;

use fgs_geom::{Image, View};
use pulp::Arch;
use rayon::prelude::*;

use bounds::{TILE, TileGrid, Touch};
use chunks::{CHUNK, Chunk, ProjectChunk};
use forward::{BlendTile, TileState};
use project::{ScreenCamera, Splat};
use project_vjp::PixelSums;
pub use real::Real;
pub use render_pass::RenderPass;
use tiles::{TileLists, Visible};

use crate::{Gaussians, Rendered};

/// Renders gaussians. Owns the memory of a pass, so that passes of the same size allocate next to
/// nothing.
#[derive(Debug)]
pub struct Rasterizer<T: Real = f32> {
    /// Per gaussian; stale where it is not visible.
    splats: Vec<Splat<T>>,
    chunks: Vec<Chunk>,
    visible: Vec<Visible>,
    touches: Vec<Touch>,
    lists: TileLists,
    /// Per tile.
    states: Vec<TileState<T>>,
    /// Per entry of the tiles' lists.
    contributed: Vec<bool>,
    sums: Vec<PixelSums<T>>,
    rendered: Rendered<T>,
}

impl<T: Real> Default for Rasterizer<T> {
    fn default() -> Self {
        Self {
            splats: Vec::new(),
            chunks: Vec::new(),
            visible: Vec::new(),
            touches: Vec::new(),
            lists: TileLists::default(),
            states: Vec::new(),
            contributed: Vec::new(),
            sums: Vec::new(),
            rendered: empty_images(0, 0),
        }
    }
}

fn empty_images<T: Real>(width: usize, height: usize) -> Rendered<T> {
    Rendered {
        color: Image::filled(width, height, [T::ZERO; 3]),
        depth_m: Image::filled(width, height, T::ZERO),
        alpha: Image::filled(width, height, T::ZERO),
    }
}

impl<T: Real> Rasterizer<T> {
    /// Renders a view. Damaged gaussians (a value not finite or absurd, a zero quaternion) are
    /// not drawn.
    ///
    /// # Panics
    /// If the gaussians' arrays differ in length.
    pub fn render<'a>(&'a mut self, gaussians: &'a Gaussians<T>, view: &View) -> RenderPass<'a, T> {
        let camera = ScreenCamera::new(view);
        let grid = TileGrid::new(camera.width, camera.height);
        self.project(gaussians, &camera, &grid);
        self.lists.fill::<T>(&grid, &self.visible, &self.touches);
        self.blend(&camera, &grid);
        RenderPass {
            scratch: self,
            gaussians,
            camera,
            grid,
        }
    }

    /// Fills `splats`, `visible` and `touches`.
    fn project(&mut self, gaussians: &Gaussians<T>, camera: &ScreenCamera<T>, grid: &TileGrid) {
        let arch = Arch::new();
        self.splats.resize_with(gaussians.len(), Splat::default);
        let tasks = gaussians.len().div_ceil(CHUNK);
        self.chunks.resize_with(tasks, Chunk::default);
        self.splats
            .par_chunks_mut(CHUNK)
            .zip(&mut self.chunks)
            .enumerate()
            .for_each(|(task, (splats, chunk))| {
                arch.dispatch(ProjectChunk {
                    gaussians,
                    first: task * CHUNK,
                    camera,
                    grid,
                    splats,
                    chunk,
                });
            });
        self.visible.clear();
        self.touches.clear();
        for chunk in &mut self.chunks {
            chunk.first_touch = self.touches.len();
            let first_touch = chunk.first_touch as u32;
            self.visible
                .extend(chunk.visible.iter().map(|&visible| Visible {
                    touches_end: visible.touches_end + first_touch,
                    ..visible
                }));
            self.touches.extend_from_slice(&chunk.touches);
        }
    }

    /// Fills `rendered`, `states` and `contributed`.
    fn blend(&mut self, camera: &ScreenCamera<T>, grid: &TileGrid) {
        let arch = Arch::new();
        let Self {
            splats,
            lists,
            states,
            contributed,
            rendered,
            ..
        } = self;
        if (rendered.alpha.width(), rendered.alpha.height()) != (grid.width, grid.height) {
            *rendered = empty_images(grid.width, grid.height);
        }
        states.resize_with(grid.len(), TileState::default);
        contributed.resize(lists.entries.len(), false);
        let row_pixels = TILE * grid.width.max(1);
        (
            rendered.color.data_mut().par_chunks_mut(row_pixels),
            rendered.depth_m.data_mut().par_chunks_mut(row_pixels),
            rendered.alpha.data_mut().par_chunks_mut(row_pixels),
            states.par_chunks_mut(grid.columns.max(1)),
            split_by_tile_row(contributed, lists, grid),
        )
            .into_par_iter()
            .enumerate()
            .for_each(|(row, (color, depth_m, alpha, states, mut contributed))| {
                for (column, state) in states.iter_mut().enumerate() {
                    let tile = row * grid.columns + column;
                    let entries = lists.of_tile(tile);
                    let (tile_contributed, rest) =
                        std::mem::take(&mut contributed).split_at_mut(entries.len());
                    contributed = rest;
                    arch.dispatch(BlendTile {
                        tile,
                        grid,
                        camera,
                        entries,
                        splats,
                        state,
                        contributed: tile_contributed,
                        color: &mut *color,
                        depth_m: &mut *depth_m,
                        alpha: &mut *alpha,
                    });
                }
            });
    }
}

/// One slice of `items` (one per list entry) for each row of tiles.
fn split_by_tile_row<'a, X>(
    mut items: &'a mut [X],
    lists: &TileLists,
    grid: &TileGrid,
) -> Vec<&'a mut [X]> {
    (0..grid.rows)
        .map(|row| {
            let tiles = row * grid.columns..(row + 1) * grid.columns;
            let len = lists.starts[tiles.end] - lists.starts[tiles.start];
            let (first, rest) = std::mem::take(&mut items).split_at_mut(len);
            items = rest;
            first
        })
        .collect()
}

#[cfg(test)]
mod tests;
