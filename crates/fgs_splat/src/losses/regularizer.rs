//! Keeps gaussians round within their plane and flat across it, Eq. (15).
//!
//! Input: the gaussians and which of them are in view. Output:
//! `mean_i(|s_i1 - m_i| + |s_i2 - m_i|) + mean_i |s_i3 - epsilon|` with `m_i` the mean of gaussian
//! i's first two scales, and its derivative by the log-scales. Scales are activated, in metres.
//!
//! Eq. (15) writes the bar over `S` without an index; the text's "consistency of gaussian scales
//! across dimensions" makes it each gaussian's own mean, and `|.|` of its two deviations their
//! sum, so that the first term is `mean_i |s_i1 - s_i2|`.
//! Differs from the paper: its code averages the first term over the 2 n deviations, which is half
//! of Eq. (15), and over the whole map in place of what is in view.

use super::l1::{sign, sum_lanes};
use crate::kernel::{Kernel, dispatch};
use crate::{Gaussians, Real};
use rayon::prelude::*;

/// Target length of the flat axis, metres: the third scale of a new gaussian.
pub(crate) const FLAT_SCALE_M: f32 = 5e-6;
/// Log-scales count as at most this (5e8 m), so that no scale overflows.
pub(crate) const MAX_LOG_SCALE: f32 = 20.0;
/// Gaussians per task, for any number of threads.
const CHUNK: usize = 4096;

/// Eq. (15) in metres over the gaussians `in_view`, and its derivative by their log-scales, one
/// entry for each entry of `in_view`. Zero if none is in view; not multiplied by any weight.
///
/// # Panics
/// If an index is not below `gaussians.len()`, like slice indexing.
pub fn scale_regularizer(gaussians: &Gaussians, in_view: &[u32]) -> (f64, Vec<[f32; 3]>) {
    let count = in_view.len().max(1) as f64;
    let mut d_log_scales = vec![[0.0; 3]; in_view.len()];
    let sums: Vec<f64> = d_log_scales
        .par_chunks_mut(CHUNK)
        .zip(in_view.par_chunks(CHUNK))
        .map(|(d_log_scales, in_view)| {
            dispatch(RegularizeChunk {
                log_scales: &gaussians.log_scales,
                in_view,
                weight: 1.0 / count as f32,
                d_log_scales,
            })
        })
        .collect();
    (sums.iter().sum::<f64>() / count, d_log_scales)
}

/// The work on up to `CHUNK` gaussians, compiled for each instruction set.
struct RegularizeChunk<'a> {
    log_scales: &'a [[f32; 3]],
    in_view: &'a [u32],
    weight: f32,
    d_log_scales: &'a mut [[f32; 3]],
}

impl Kernel for RegularizeChunk<'_> {
    /// The sum of Eq. (15)'s terms.
    type Output = f64;

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) -> f64 {
        let scales = self.d_log_scales;
        for (scales, index) in scales.iter_mut().zip(self.in_view) {
            *scales = self.log_scales[*index as usize];
        }
        for scale in scales.as_flattened_mut() {
            *scale = Real::exp::<FUSED>(scale.min(MAX_LOG_SCALE));
        }
        let mut terms = [0.0; CHUNK];
        let n = scales.len().min(CHUNK);
        for (term, scales) in terms.iter_mut().zip(&mut *scales) {
            let [s1, s2, s3] = *scales;
            let (in_plane, across) = (s1 - s2, s3 - FLAT_SCALE_M);
            *term = in_plane.abs() + across.abs();
            let by_in_plane = self.weight * sign(in_plane);
            let by_across = self.weight * sign(across);
            *scales = [by_in_plane * s1, -by_in_plane * s2, by_across * s3];
        }
        sum_lanes(&terms[..n])
    }
}
