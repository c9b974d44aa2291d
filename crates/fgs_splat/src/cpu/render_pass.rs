//! A finished render: its images, the gaussians visible in it, and its backward pass. Invariant: it
//! borrows the gaussians and the rasteriser's buffers, so that nothing changes before the backward
//! pass.

use fgs_geom::Image;
use rayon::prelude::*;

use super::Rasterizer;
use super::backward::BlendTileVjp;
use super::bounds::{TILE_HEIGHT, TileGrid};
use super::chunks::{CHUNK, ProjectChunkVjp};
use super::lanes::LANES;
use super::project::ScreenCamera;
use super::project_vjp::PixelSums;
use super::real::Real;
use super::tiles::{TileLists, split_by_tile_row, take_front};
use crate::kernel::dispatch;
use crate::{Cotangents, GaussianGradients, Gaussians, Rendered};

/// A finished render, ready to be differentiated. Borrows the gaussians, so that they cannot change
/// before that.
#[derive(Debug)]
pub struct RenderPass<'a, T: Real = f32> {
    pub(super) scratch: &'a mut Rasterizer<T>,
    pub(super) gaussians: &'a Gaussians<T>,
    pub(super) camera: ScreenCamera<T>,
    pub(super) grid: TileGrid,
}

impl<T: Real> RenderPass<'_, T> {
    /// The images.
    pub fn rendered(&self) -> &Rendered<T> {
        &self.scratch.rendered
    }

    /// Pairs of a gaussian and a pixel of the blocks it touches: the cost of blending, were no
    /// pixel ever saturated.
    pub fn evaluations(&self) -> usize {
        let blocks = self
            .scratch
            .lists
            .dealt
            .iter()
            .map(|entry| entry.blocks.count_ones());
        LANES * blocks.sum::<u32>() as usize
    }

    /// Indices of the gaussians that contributed to a pixel, ascending.
    pub fn visible(&self) -> Vec<u32> {
        let Rasterizer { chunks, lists, .. } = &*self.scratch;
        let mut contributed = vec![false; chunks.len() * CHUNK];
        for entry in &lists.entries {
            contributed[entry.splat as usize] |= entry.blocks != 0;
        }
        let chunks = contributed.chunks(CHUNK).zip(chunks);
        let gaussians =
            chunks.flat_map(|(contributed, chunk)| contributed.iter().zip(&chunk.visible));
        gaussians
            .filter_map(|(contributed, visible)| contributed.then_some(visible.gaussian))
            .collect()
    }

    /// Vector-Jacobian product: from the loss's derivatives by the images to those by the
    /// gaussians' parameters. Overwrites `gradients`.
    ///
    /// # Panics
    /// If the cotangents' images are not of the camera's size.
    pub fn vjp(&mut self, cotangents: &Cotangents<T>, gradients: &mut GaussianGradients<T>) {
        let size = (self.grid.width, self.grid.height);
        assert_eq!(size, size_of_image(&cotangents.d_color), "d_color");
        assert_eq!(size, size_of_image(&cotangents.d_depth_m), "d_depth_m");
        assert_eq!(size, size_of_image(&cotangents.d_alpha), "d_alpha");
        self.blend_vjp(cotangents);
        self.project_vjp(gradients);
    }

    /// Fills `sums`.
    fn blend_vjp(&mut self, cotangents: &Cotangents<T>) {
        let Rasterizer {
            chunks,
            lists:
                TileLists {
                    starts,
                    entries,
                    order,
                    ..
                },
            states,
            sums,
            ..
        } = &mut *self.scratch;
        let (grid, camera) = (&self.grid, &self.camera);
        sums.resize_with(entries.len(), PixelSums::default);
        let row_pixels = TILE_HEIGHT * grid.width.max(1);
        (
            split_by_tile_row(sums, starts, grid),
            cotangents.d_color.data().par_chunks(row_pixels),
            cotangents.d_depth_m.data().par_chunks(row_pixels),
            cotangents.d_alpha.data().par_chunks(row_pixels),
        )
            .into_par_iter()
            .enumerate()
            .for_each(|(row, (mut sums, d_color, d_depth_m, d_alpha))| {
                for tile in row * grid.columns..(row + 1) * grid.columns {
                    let list = starts[tile]..starts[tile + 1];
                    dispatch(BlendTileVjp {
                        tile,
                        grid,
                        camera,
                        entries: &entries[list.clone()],
                        order: &order[list.clone()],
                        first_slot: list.start,
                        chunks,
                        state: &states[tile],
                        d_color,
                        d_depth_m,
                        d_alpha,
                        sums: take_front(&mut sums, list.len()),
                    });
                }
            });
    }

    /// Differentiates the projection of each gaussian.
    fn project_vjp(&mut self, gradients: &mut GaussianGradients<T>) {
        let Rasterizer { chunks, sums, .. } = &mut *self.scratch;
        let (gaussians, camera) = (self.gaussians, &self.camera);
        chunks.par_iter_mut().for_each(|chunk| {
            dispatch(ProjectChunkVjp {
                gaussians,
                camera,
                sums,
                chunk,
            });
        });
        gradients.touched.clear();
        gradients.gradients.clear();
        for chunk in chunks {
            let GaussianGradients {
                touched,
                gradients: rows,
            } = &chunk.gradients;
            gradients.touched.extend_from_slice(touched);
            gradients.gradients.extend_from_slice(rows);
        }
    }
}

fn size_of_image<X>(image: &Image<X>) -> (usize, usize) {
    (image.width(), image.height())
}
