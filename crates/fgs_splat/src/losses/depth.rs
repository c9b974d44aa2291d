//! Absolute error of the rendered depth, where depth was measured.
//!
//! Input: rendered depth (the sum of `weight * z`, metres) and alpha, and the target. Output: the
//! mean of `|depth - measured| / 10 m`, and the weighted derivatives by depth and alpha.

use super::l1::{sign, sum_lanes};
use super::{LossSettings, Target};
use crate::kernel::{Kernel, dispatch};
use fgs_geom::Image;
use rayon::prelude::*;

/// One unit of depth error, which the weight of the depth loss refers to (the authors' code).
pub(crate) const DEPTH_UNIT_M: f32 = 10.0;
/// Smallest alpha that depth is divided by: fainter pixels carry no depth, and the quotient's
/// derivatives would grow without bound.
pub(crate) const MIN_ALPHA: f32 = 0.05;
/// Pixels per task, for any number of threads.
const CHUNK: usize = 4 * 1024;

/// The mean over measured pixels, in units of 10 m; 0 if there is none.
pub fn depth_loss(
    depth_m: &Image<f32>,
    alpha: &Image<f32>,
    target: &Target,
    settings: &LossSettings,
    d_depth_m: &mut Image<f32>,
    d_alpha: &mut Image<f32>,
) -> f64 {
    let count = target.measured.max(1) as f64;
    let sums: Vec<f64> = d_depth_m
        .data_mut()
        .par_chunks_mut(CHUNK)
        .zip(d_alpha.data_mut().par_chunks_mut(CHUNK))
        .zip(depth_m.data().par_chunks(CHUNK))
        .zip(alpha.data().par_chunks(CHUNK))
        .zip(target.depth_m.data().par_chunks(CHUNK))
        .map(|((((d_depth, d_alpha), depth), alpha), measured)| {
            dispatch(ChunkLoss {
                depth,
                alpha,
                measured,
                normalize: settings.normalize_depth,
                weight: settings.depth_weight / (count as f32 * DEPTH_UNIT_M),
                d_depth,
                d_alpha,
            })
        })
        .collect();
    sums.iter().sum::<f64>() / (count * f64::from(DEPTH_UNIT_M))
}

/// The work on up to `CHUNK` pixels, compiled for each instruction set.
struct ChunkLoss<'a> {
    depth: &'a [f32],
    alpha: &'a [f32],
    measured: &'a [f32],
    normalize: bool,
    weight: f32,
    d_depth: &'a mut [f32],
    d_alpha: &'a mut [f32],
}

impl Kernel for ChunkLoss<'_> {
    /// The sum of the errors, metres.
    type Output = f64;

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) -> f64 {
        let mut errors = [0.0; CHUNK];
        let n = self.depth.len().min(CHUNK);
        let (depth, alpha, measured) = (&self.depth[..n], &self.alpha[..n], &self.measured[..n]);
        let (d_depth, d_alpha) = (&mut self.d_depth[..n], &mut self.d_alpha[..n]);
        for i in 0..n {
            let (measured, alpha) = (measured[i], alpha[i]);
            // As `has_depth`, without a branch.
            let valid = (measured > 0.0) & (measured < f32::INFINITY);
            let inverse = if self.normalize {
                1.0 / alpha.max(MIN_ALPHA)
            } else {
                1.0
            };
            let rendered = depth[i] * inverse;
            let error = rendered - measured;
            let d = self.weight * sign(error) * inverse;
            errors[i] = if valid { error.abs() } else { 0.0 };
            d_depth[i] = if valid { d } else { 0.0 };
            let by_alpha = valid & self.normalize & (alpha > MIN_ALPHA);
            d_alpha[i] = if by_alpha { -rendered * d } else { 0.0 };
        }
        sum_lanes(&errors[..n])
    }
}
