//! SSIM's separable 11-tap gaussian window, on rows of interleaved channels.
//!
//! Input: rows of floats, `CHANNELS` per pixel. Output: their weighted sums down the columns or
//! along a row. Pixels outside the image are zero and the weights are not renormalised, as in the
//! SSIM that gaussian splatting trains with. Loops have no branches and slices of equal length, so
//! that they vectorise.

use crate::kernel::mul_add;

/// Pixels on either side of the window's centre: 11 taps (Wang et al. 2004).
pub const RADIUS: usize = 5;
/// Taps.
pub const TAPS: usize = 2 * RADIUS + 1;
/// Standard deviation of the window in pixels (Wang et al. 2004).
const SIGMA_PX: f64 = 1.5;
/// Interleaved floats per pixel.
pub const CHANNELS: usize = 3;
/// Zeros before and after a row for [`blur_along`].
pub const PADDING: usize = RADIUS * CHANNELS;

/// Weights of taps 0 ..= [`RADIUS`]; the others mirror them. All eleven sum to 1.
pub fn window() -> [f32; RADIUS + 1] {
    let weight = |tap: usize| {
        let x = tap as f64 - RADIUS as f64;
        (-x * x / (2.0 * SIGMA_PX * SIGMA_PX)).exp()
    };
    let sum: f64 = (0..TAPS).map(weight).sum();
    std::array::from_fn(|tap| (weight(tap) / sum) as f32)
}

/// `out = sum_k w_k rows_k`, element by element.
#[inline(always)]
pub fn blur_down<const FUSED: bool>(
    weights: &[f32; RADIUS + 1],
    rows: [&[f32]; TAPS],
    out: &mut [f32],
) {
    let n = out.len();
    let rows = rows.map(|row| &row[..n]);
    for i in 0..n {
        let mut sum = weights[RADIUS] * rows[RADIUS][i];
        for tap in 0..RADIUS {
            let pair = rows[tap][i] + rows[TAPS - 1 - tap][i];
            sum = mul_add::<FUSED, f32>(weights[tap], pair, sum);
        }
        out[i] = sum;
    }
}

/// [`blur_down`] of the rows and of their squares.
#[inline(always)]
pub fn blur_down_with_squares<const FUSED: bool>(
    weights: &[f32; RADIUS + 1],
    rows: [&[f32]; TAPS],
    out: &mut [f32],
    out_squares: &mut [f32],
) {
    let n = out.len();
    let out_squares = &mut out_squares[..n];
    let rows = rows.map(|row| &row[..n]);
    for i in 0..n {
        let center = rows[RADIUS][i];
        let mut sum = weights[RADIUS] * center;
        let mut squares = sum * center;
        for tap in 0..RADIUS {
            let (above, below) = (rows[tap][i], rows[TAPS - 1 - tap][i]);
            let pair = mul_add::<FUSED, f32>(above, above, below * below);
            sum = mul_add::<FUSED, f32>(weights[tap], above + below, sum);
            squares = mul_add::<FUSED, f32>(weights[tap], pair, squares);
        }
        out[i] = sum;
        out_squares[i] = squares;
    }
}

/// Blurs along a row. `padded` is the row between [`PADDING`] zeros on either side.
#[inline(always)]
pub fn blur_along<const FUSED: bool>(weights: &[f32; RADIUS + 1], padded: &[f32], out: &mut [f32]) {
    let n = out.len();
    blur_down::<FUSED>(
        weights,
        std::array::from_fn(|tap| &padded[tap * CHANNELS..][..n]),
        out,
    );
}
