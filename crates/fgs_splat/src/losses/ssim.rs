//! Structural similarity (Wang et al. 2004) and its derivative by one of the images.
//!
//! Input: rows of the difference `d = x - y` and the sum `s = x + y` of two images, and where they
//! are valid. Output: `1 - SSIM` at a row, and the derivative of the valid pixels' sum by `x`.
//! With `m` a windowed mean and `var` a windowed variance,
//! `SSIM = (1 - m_d^2 / B1) (1 - var_d / B2)`, `B1 = (m_d^2 + m_s^2) / 2 + C1`,
//! `B2 = (var_d + var_s) / 2 + C2`: the textbook formula in other variables. It needs four windowed
//! maps instead of five, and nothing cancels where the images agree.

use super::blur::{self, PADDING, RADIUS, TAPS};

/// (0.01 L)^2 with the range L = 1 (Wang et al. 2004).
pub const C1: f32 = 0.01 * 0.01;
/// (0.03 L)^2 with the range L = 1 (Wang et al. 2004).
pub const C2: f32 = 0.03 * 0.03;

/// Weights and row buffers of the two passes. A row has `len` floats.
pub struct Ssim {
    weights: [f32; RADIUS + 1],
    padded: [Vec<f32>; 2],
    maps: [Vec<f32>; 4],
}

/// Derivatives of the sum of `1 - SSIM` by the windowed mean of `d` and `s` together and by the
/// windowed means of `d^2` and `s^2`, one row each.
pub type MomentRows<'a> = [&'a mut [f32]; 3];

impl Ssim {
    pub fn new(len: usize) -> Self {
        Self {
            weights: blur::window(),
            padded: std::array::from_fn(|_| vec![0.0; len + 2 * PADDING]),
            maps: std::array::from_fn(|_| vec![0.0; len]),
        }
    }

    /// `valid * (1 - SSIM)` of the middle row of `d` and `s`, and its derivatives by the moments.
    #[inline(always)]
    pub fn forward<const FUSED: bool>(
        &mut self,
        d: [&[f32]; TAPS],
        s: [&[f32]; TAPS],
        valid: &[f32],
        dissimilarity: &mut [f32],
        d_moments: MomentRows,
    ) {
        let n = dissimilarity.len();
        let weights = &self.weights;
        let [padded, padded_squares] = &mut self.padded;
        let [m_d, m_s, e_dd, e_ss] = &mut self.maps;
        for (rows, mean, mean_square) in [(d, &mut *m_d, &mut *e_dd), (s, &mut *m_s, &mut *e_ss)] {
            let inside = PADDING..PADDING + n;
            blur::blur_down_with_squares::<FUSED>(
                weights,
                rows,
                &mut padded[inside.clone()],
                &mut padded_squares[inside],
            );
            blur::blur_along::<FUSED>(weights, padded, &mut mean[..n]);
            blur::blur_along::<FUSED>(weights, padded_squares, &mut mean_square[..n]);
        }

        let (m_d, m_s, e_dd, e_ss) = (&m_d[..n], &m_s[..n], &e_dd[..n], &e_ss[..n]);
        let valid = &valid[..n];
        let [d_mean, d_dd, d_ss] = d_moments.map(|row| &mut row[..n]);
        for i in 0..n {
            let (md, ms) = (m_d[i], m_s[i]);
            // Rounding may take a variance below zero, and with it the denominator.
            let var_d = (e_dd[i] - md * md).max(0.0);
            let var_s = (e_ss[i] - ms * ms).max(0.0);
            let b1 = 0.5 * (md * md + ms * ms) + C1;
            let b2 = 0.5 * (var_d + var_s) + C2;
            let inverse = 1.0 / (b1 * b2);
            let (inv_b1, inv_b2) = (b2 * inverse, b1 * inverse);
            let (luminance_loss, structure_loss) = (md * md * inv_b1, var_d * inv_b2);
            let (luminance, structure) = (1.0 - luminance_loss, 1.0 - structure_loss);
            dissimilarity[i] =
                valid[i] * (luminance_loss + structure_loss - luminance_loss * structure_loss);

            // d(1 - luminance structure) by var_d, var_s and the means.
            let by_var_s = -0.5 * luminance * structure_loss * inv_b2;
            let by_var_d = luminance * inv_b2 + by_var_s;
            let by_b1 = -structure * luminance_loss * inv_b1;
            let by_md = 2.0 * structure * md * inv_b1 + (by_b1 - 2.0 * by_var_d) * md;
            let by_ms = (by_b1 - 2.0 * by_var_s) * ms;
            d_mean[i] = valid[i] * (by_md + by_ms);
            d_dd[i] = valid[i] * by_var_d;
            d_ss[i] = valid[i] * by_var_s;
        }
    }

    /// `d_x`: the derivative of the sum of `1 - SSIM` over valid pixels by a row of `x`.
    /// `d` and `s` are that row, `d_moments` the rows around it.
    #[inline(always)]
    pub fn backward<const FUSED: bool>(
        &mut self,
        d_moments: [[&[f32]; TAPS]; 3],
        d: &[f32],
        s: &[f32],
        valid: &[f32],
        d_x: &mut [f32],
    ) {
        let n = d_x.len();
        let padded = &mut self.padded[0];
        for (rows, map) in d_moments.into_iter().zip(&mut self.maps) {
            blur::blur_down::<FUSED>(&self.weights, rows, &mut padded[PADDING..][..n]);
            blur::blur_along::<FUSED>(&self.weights, padded, &mut map[..n]);
        }
        let [by_mean, by_dd, by_ss, _] = &self.maps;
        let (by_mean, by_dd, by_ss) = (&by_mean[..n], &by_dd[..n], &by_ss[..n]);
        let (d, s, valid) = (&d[..n], &s[..n], &valid[..n]);
        for i in 0..n {
            d_x[i] = valid[i] * (by_mean[i] + 2.0 * (d[i] * by_dd[i] + s[i] * by_ss[i]));
        }
    }
}
