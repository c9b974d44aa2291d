//! Absolute error of the rendered depth, where depth was measured.
//!
//! Input: rendered depth (the sum of `weight * z`, metres) and alpha, and the target. Output: the
//! mean of `|depth - measured| / 10 m`, and the weighted derivatives by depth and alpha.

use super::{LossSettings, Target, l1::sign};
use fgs_geom::{Image, has_depth};
use rayon::prelude::*;

/// One unit of depth error, which the weight of the depth loss refers to (the authors' code).
pub(crate) const DEPTH_UNIT_M: f32 = 10.0;
/// Depth is divided by at least this alpha: what covers less of a pixel tells no depth, and the
/// quotient's derivatives grow without bound.
pub(crate) const MIN_ALPHA: f32 = 0.05;
/// Pixels that are summed together, whatever the number of threads.
const CHUNK: usize = 16 * 1024;

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
    let weight = settings.depth_weight / (count as f32 * DEPTH_UNIT_M);
    let sums: Vec<f64> = d_depth_m
        .data_mut()
        .par_chunks_mut(CHUNK)
        .zip(d_alpha.data_mut().par_chunks_mut(CHUNK))
        .zip(depth_m.data().par_chunks(CHUNK))
        .zip(alpha.data().par_chunks(CHUNK))
        .zip(target.depth_m.data().par_chunks(CHUNK))
        .map(|((((d_depth, d_alpha), depth), alpha), measured)| {
            let mut sum = 0.0;
            for i in 0..depth.len() {
                (d_depth[i], d_alpha[i]) = (0.0, 0.0);
                if !has_depth(measured[i]) {
                    continue;
                }
                let divisor = if settings.normalize_depth {
                    alpha[i].max(MIN_ALPHA)
                } else {
                    1.0
                };
                let rendered = depth[i] / divisor;
                let error = rendered - measured[i];
                sum += f64::from(error.abs());
                d_depth[i] = weight * sign(error) / divisor;
                if settings.normalize_depth && alpha[i] > MIN_ALPHA {
                    d_alpha[i] = -rendered * d_depth[i];
                }
            }
            sum
        })
        .collect();
    sums.iter().sum::<f64>() / (count * f64::from(DEPTH_UNIT_M))
}
