//! The two per-gaussian stages, in chunks of a fixed size: projection, and its derivative from the
//! sums over pixels.

use super::bounds::{Support, TileGrid, Touch};
use super::cull::Frustum;
use super::lanes::{column, set_column};
use super::prefetch::prefetch;
use super::project::{PARAMETERS, Parameters, Projection, SPLAT, ScreenCamera, Splat};
use super::project_vjp::{PixelSums, SUMS, project_vjp, sum};
use super::real::Real;
use crate::kernel::Kernel;
use crate::{GaussianGradient, GaussianGradients, Gaussians};

/// Gaussians per chunk: large enough to amortise a task's overhead, small enough to balance load.
pub(super) const CHUNK: usize = 2048;
const _: () = assert!(
    CHUNK <= 1 << 16,
    "a touch counts a chunk's splats in 16 bits"
);

/// Prefetch distance in touches: about as many sums as fit into L1.
const PREFETCH: usize = 64;

/// A gaussian with at least one touch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Visible {
    pub gaussian: u32,
    /// End of the gaussian's touches in the chunk's; they start where the previous gaussian's end.
    pub touches_end: u32,
}

/// The splat with a global number: its chunk times [`CHUNK`] plus its index in the chunk.
#[inline(always)]
pub(super) fn splat<T>(chunks: &[Chunk<T>], number: u32) -> &Splat<T> {
    let number = number as usize;
    &chunks[number / CHUNK].splats[number % CHUNK]
}

/// Results for the gaussians of a chunk.
#[derive(Debug, Default)]
pub(super) struct Chunk<T> {
    in_view: Vec<u32>,
    /// Ascending by gaussian.
    pub visible: Vec<Visible>,
    /// Of the visible gaussians.
    pub splats: Vec<Splat<T>>,
    pub touches: Vec<Touch>,
    /// For each touch the slot of its entry in the tiles' lists.
    pub slots: Vec<u32>,
    /// Of its gaussians.
    pub gradients: GaussianGradients<T>,
}

/// Projects the gaussians of a chunk. Run it through [`crate::kernel::dispatch`].
pub(super) struct ProjectChunk<'a, T: Real> {
    pub gaussians: &'a Gaussians<T>,
    /// Index of the chunk's first gaussian.
    pub first: usize,
    pub camera: &'a ScreenCamera<T>,
    pub frustum: &'a Frustum<T>,
    pub grid: &'a TileGrid,
    pub chunk: &'a mut Chunk<T>,
}

impl<T: Real> Kernel for ProjectChunk<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        let Chunk {
            in_view,
            visible,
            splats,
            touches,
            ..
        } = self.chunk;
        in_view.clear();
        visible.clear();
        splats.clear();
        touches.clear();
        let end = self.gaussians.len().min(self.first + CHUNK);
        self.frustum
            .push_in_view::<FUSED>(self.camera, self.gaussians, self.first, end, in_view);
        if in_view.is_empty() {
            // Most of a large map stays out of view: free its buffers.
            *self.chunk = Chunk::default();
            return;
        }
        for indices in in_view.chunks(WIDTH) {
            let parameters = load_parameters::<WIDTH, T>(self.gaussians, indices);
            let mut lanes = [[T::ZERO; WIDTH]; SPLAT];
            let mut supports = [Support::default(); WIDTH];
            let mut drawn = [false; WIDTH];
            for lane in 0..WIDTH {
                let parameters = Parameters::from_array(column(&parameters, lane));
                let projection = Projection::new::<FUSED>(&parameters, self.camera);
                let splat = projection.splat::<FUSED>(self.camera);
                set_column(&mut lanes, lane, splat.to_array());
                supports[lane] = Support::new(&splat, self.grid);
                drawn[lane] = projection.drawn;
            }
            for (lane, &gaussian) in indices.iter().enumerate() {
                if !drawn[lane] {
                    continue;
                }
                let splat = Splat::from_array(column(&lanes, lane));
                let before = touches.len();
                supports[lane].push_touches(&splat, visible.len() as u16, self.grid, touches);
                if touches.len() > before {
                    splats.push(splat);
                    visible.push(Visible {
                        gaussian,
                        touches_end: touches.len() as u32,
                    });
                }
            }
        }
    }
}

/// The parameters of up to `WIDTH` gaussians, one per lane.
#[inline(always)]
fn load_parameters<const WIDTH: usize, T: Real>(
    gaussians: &Gaussians<T>,
    indices: &[u32],
) -> [[T; WIDTH]; PARAMETERS] {
    let mut lanes = [[T::ZERO; WIDTH]; PARAMETERS];
    for (lane, &index) in indices.iter().enumerate().take(WIDTH) {
        let parameters = Parameters::of(gaussians, index as usize);
        set_column(&mut lanes, lane, parameters.to_array());
    }
    lanes
}

/// Adds up each gaussian's sums over its tiles and differentiates its projection. Run it through
/// [`crate::kernel::dispatch`].
pub(super) struct ProjectChunkVjp<'a, T: Real> {
    pub gaussians: &'a Gaussians<T>,
    pub camera: &'a ScreenCamera<T>,
    /// Per slot of the tiles' lists.
    pub sums: &'a [PixelSums<T>],
    pub chunk: &'a mut Chunk<T>,
}

impl<T: Real> Kernel for ProjectChunkVjp<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        let Chunk {
            visible,
            slots,
            gradients: chunk_gradients,
            ..
        } = self.chunk;
        chunk_gradients.touched.clear();
        chunk_gradients.gradients.clear();
        let mut start = 0;
        let mut prefetched = 0;
        for batch in visible.chunks(WIDTH) {
            let indices: [u32; WIDTH] =
                std::array::from_fn(|lane| batch.get(lane).map_or(0, |visible| visible.gaussian));
            let indices = &indices[..batch.len()];
            let parameters = load_parameters::<WIDTH, T>(self.gaussians, indices);
            let end = batch.last().map_or(start, |last| last.touches_end as usize);
            let ahead = (end + PREFETCH).min(slots.len());
            for &slot in &slots[prefetched..ahead] {
                prefetch(&self.sums[slot as usize]);
            }
            prefetched = ahead;
            let mut sums = [[T::ZERO; WIDTH]; SUMS];
            for (lane, visible) in batch.iter().enumerate() {
                let end = visible.touches_end as usize;
                let mut total = PixelSums::default();
                for &slot in &slots[start..end] {
                    total.add(&self.sums[slot as usize]);
                }
                start = end;
                set_column(&mut sums, lane, total.0);
            }
            let mut gradients = [[T::ZERO; WIDTH]; PARAMETERS];
            for lane in 0..WIDTH {
                let parameters = Parameters::from_array(column(&parameters, lane));
                let projection = Projection::new::<FUSED>(&parameters, self.camera);
                let gradient =
                    project_vjp::<FUSED, T>(&projection, self.camera, &column(&sums, lane));
                set_column(&mut gradients, lane, gradient.to_array());
            }
            for (lane, &index) in indices.iter().enumerate() {
                if sums[sum::TILES][lane] == T::ZERO {
                    continue;
                }
                let gradient = Parameters::from_array(column(&gradients, lane));
                chunk_gradients.touched.push(index);
                chunk_gradients.gradients.push(GaussianGradient {
                    d_mean: gradient.mean,
                    d_quat: gradient.quat,
                    d_log_scales: gradient.log_scales,
                    d_opacity_logit: gradient.opacity_logit,
                    d_sh: gradient.sh,
                });
            }
        }
    }
}
