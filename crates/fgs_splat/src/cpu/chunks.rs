//! The two stages that go over gaussians, each cut into chunks of a fixed size: projection, and
//! the way back from the sums over pixels to the parameters.

use pulp::NullaryFnOnce;

use super::bounds::{TileGrid, Touch, push_touches};
use super::project::{Projection, ScreenCamera, Splat};
use super::project_vjp::{PixelSums, project_vjp};
use super::real::Real;
use super::tiles::{BATCH, TileLists, Visible};
use crate::Gaussians;

/// Gaussians of a chunk: large enough that starting a task costs nothing, small enough to spread.
pub(super) const CHUNK: usize = 2048;

/// What is found among the gaussians of a chunk.
#[derive(Debug, Default)]
pub(super) struct Chunk {
    /// Their `touches_end` counts from the chunk's first touch.
    pub visible: Vec<Visible>,
    pub touches: Vec<Touch>,
    /// Where the chunk's touches start among all.
    pub first_touch: usize,
    /// Gaussians that got a gradient.
    pub touched: Vec<u32>,
}

/// Projects the gaussians of a chunk. Run it through [`pulp::Arch::dispatch`].
pub(super) struct ProjectChunk<'a, T: Real> {
    pub gaussians: &'a Gaussians<T>,
    /// Index of the chunk's first gaussian.
    pub first: usize,
    pub camera: &'a ScreenCamera<T>,
    pub grid: &'a TileGrid,
    pub splats: &'a mut [Splat<T>],
    pub chunk: &'a mut Chunk,
}

impl<T: Real> NullaryFnOnce for ProjectChunk<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Chunk {
            visible, touches, ..
        } = self.chunk;
        visible.clear();
        touches.clear();
        for (index, splat) in (self.first..).zip(self.splats) {
            let Some(projection) = Projection::new(self.gaussians, index, self.camera) else {
                continue;
            };
            *splat = projection.splat(self.camera);
            let before = touches.len();
            push_touches(splat, self.grid, touches);
            if touches.len() > before {
                visible.push(Visible {
                    depth_key: splat.center_depth.sort_key(),
                    gaussian: index as u32,
                    touches_end: touches.len() as u32,
                });
            }
        }
    }
}

/// Adds up the sums of each gaussian of a chunk and carries them to its parameters. Run it
/// through [`pulp::Arch::dispatch`].
pub(super) struct ProjectChunkVjp<'a, T: Real> {
    pub gaussians: &'a Gaussians<T>,
    pub camera: &'a ScreenCamera<T>,
    pub lists: &'a TileLists,
    /// Per entry of the lists.
    pub contributed: &'a [bool],
    pub sums: &'a [PixelSums<T>],
    pub chunk: &'a mut Chunk,
    /// Of the chunk's gaussians.
    pub d_means: &'a mut [[T; 3]],
    pub d_quats: &'a mut [[T; 4]],
    pub d_log_scales: &'a mut [[T; 3]],
    pub d_opacity_logits: &'a mut [T],
    pub d_sh: &'a mut [[T; 3]],
}

impl<T: Real> NullaryFnOnce for ProjectChunkVjp<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let chunk = self.chunk;
        chunk.touched.clear();
        let mut start = chunk.first_touch;
        let mut totals = [PixelSums::default(); BATCH];
        let mut hits = [false; BATCH];
        for batch in chunk.visible.chunks(BATCH) {
            for ((visible, total), hit) in batch.iter().zip(&mut totals).zip(&mut hits) {
                let end = chunk.first_touch + visible.touches_end as usize;
                *total = PixelSums::default();
                *hit = false;
                for &entry in &self.lists.entry_from_touch[start..end] {
                    if self.contributed[entry as usize] {
                        *hit = true;
                        total.add(&self.sums[entry as usize]);
                    }
                }
                start = end;
            }
            for ((visible, total), hit) in batch.iter().zip(&totals).zip(&hits) {
                let index = visible.gaussian as usize;
                let projection = Projection::new(self.gaussians, index, self.camera);
                let (true, Some(projection)) = (*hit, projection) else {
                    continue;
                };
                let gradient = project_vjp(&projection, self.camera, total);
                let local = index % CHUNK;
                self.d_means[local] = gradient.d_mean;
                self.d_quats[local] = gradient.d_quat;
                self.d_log_scales[local] = gradient.d_log_scale;
                self.d_opacity_logits[local] = gradient.d_opacity_logit;
                self.d_sh[local] = gradient.d_sh;
                chunk.touched.push(visible.gaussian);
            }
        }
    }
}
