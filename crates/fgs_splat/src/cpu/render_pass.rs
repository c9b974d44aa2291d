//! A finished render: its images, the gaussians seen in it, and the way back from the derivatives by
//! the images to those by the gaussians' parameters. Invariant: the gaussians and the memory of the
//! pass are borrowed, so nothing can change between the pass and its derivative.

use fgs_geom::Image;
use pulp::Arch;
use rayon::prelude::*;

use super::backward::BlendTileVjp;
use super::bounds::{LANES, TILE, TileGrid};
use super::chunks::{CHUNK, ProjectChunkVjp};
use super::project::ScreenCamera;
use super::project_vjp::PixelSums;
use super::real::Real;
use super::{Rasterizer, split_by_tile_row};
use crate::{Cotangents, GaussianGradients, Gaussians, Rendered};

/// A finished render, which can be differentiated. Borrows the gaussians, so that they cannot
/// change in between.
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

    /// How many times a gaussian meets a pixel of the blocks it touches: the work of blending, but
    /// for what saturated pixels spare.
    pub fn evaluations(&self) -> usize {
        let blocks = self
            .scratch
            .lists
            .entries
            .iter()
            .map(|entry| entry.blocks.count_ones());
        LANES * blocks.sum::<u32>() as usize
    }

    /// The gaussians that contributed to a pixel, ascending.
    pub fn visible(&self) -> Vec<u32> {
        let Rasterizer {
            visible,
            lists,
            contributed,
            ..
        } = &*self.scratch;
        let mut start = 0;
        visible
            .iter()
            .filter_map(|gaussian| {
                let end = gaussian.touches_end as usize;
                let entries = &lists.entry_from_touch[start..end];
                start = end;
                let hit = entries.iter().any(|&entry| contributed[entry as usize]);
                hit.then_some(gaussian.gaussian)
            })
            .collect()
    }

    /// The loss's derivatives by the gaussians' parameters, from those by the images.
    /// `gradients` is reset first.
    ///
    /// # Panics
    /// If the cotangents' images are not of the camera's size.
    pub fn vjp(&mut self, cotangents: &Cotangents<T>, gradients: &mut GaussianGradients<T>) {
        let size = (self.grid.width, self.grid.height);
        assert_eq!(size, size_of_image(&cotangents.d_color), "d_color");
        assert_eq!(size, size_of_image(&cotangents.d_depth_m), "d_depth_m");
        assert_eq!(size, size_of_image(&cotangents.d_alpha), "d_alpha");
        self.blend_vjp(cotangents);
        gradients.reset(self.gaussians.len());
        self.project_vjp(gradients);
    }

    /// Fills `sums`.
    fn blend_vjp(&mut self, cotangents: &Cotangents<T>) {
        let arch = Arch::new();
        let Rasterizer {
            splats,
            lists,
            states,
            contributed,
            sums,
            ..
        } = &mut *self.scratch;
        let (grid, camera) = (&self.grid, &self.camera);
        sums.resize_with(lists.entries.len(), PixelSums::default);
        let row_pixels = TILE * grid.width.max(1);
        (
            split_by_tile_row(sums, lists, grid),
            cotangents.d_color.data().par_chunks(row_pixels),
            cotangents.d_depth_m.data().par_chunks(row_pixels),
            cotangents.d_alpha.data().par_chunks(row_pixels),
        )
            .into_par_iter()
            .enumerate()
            .for_each(|(row, (mut sums, d_color, d_depth_m, d_alpha))| {
                for tile in row * grid.columns..(row + 1) * grid.columns {
                    let entries = lists.of_tile(tile);
                    let (tile_sums, rest) = std::mem::take(&mut sums).split_at_mut(entries.len());
                    sums = rest;
                    arch.dispatch(BlendTileVjp {
                        tile,
                        grid,
                        camera,
                        entries,
                        splats,
                        state: &states[tile],
                        contributed: &contributed[lists.range(tile)],
                        d_color,
                        d_depth_m,
                        d_alpha,
                        sums: tile_sums,
                    });
                }
            });
    }

    /// Adds up each gaussian's sums and carries them to its parameters.
    fn project_vjp(&mut self, gradients: &mut GaussianGradients<T>) {
        let arch = Arch::new();
        let Rasterizer {
            chunks,
            lists,
            contributed,
            sums,
            ..
        } = &mut *self.scratch;
        let (gaussians, camera) = (self.gaussians, &self.camera);
        (
            chunks.par_iter_mut(),
            gradients.d_means.par_chunks_mut(CHUNK),
            gradients.d_quats.par_chunks_mut(CHUNK),
            gradients.d_log_scales.par_chunks_mut(CHUNK),
            gradients.d_opacity_logits.par_chunks_mut(CHUNK),
            gradients.d_sh.par_chunks_mut(CHUNK),
        )
            .into_par_iter()
            .for_each(
                |(chunk, d_means, d_quats, d_log_scales, d_opacity_logits, d_sh)| {
                    arch.dispatch(ProjectChunkVjp {
                        gaussians,
                        camera,
                        lists,
                        contributed,
                        sums,
                        chunk,
                        d_means,
                        d_quats,
                        d_log_scales,
                        d_opacity_logits,
                        d_sh,
                    });
                },
            );
        for chunk in chunks {
            gradients.touched.extend_from_slice(&chunk.touched);
        }
    }
}

fn size_of_image<X>(image: &Image<X>) -> (usize, usize) {
    (image.width(), image.height())
}
