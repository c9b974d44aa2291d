//! Absolute error of a row and its derivative, and sums of errors.
//!
//! Input: the row's difference `d = x - y` and where it is valid. Output: `valid * |d|`, and its
//! derivative by `x`, the sign of `d` (0 at 0), added to `d_x`.

/// Sums are kept in this many lanes, so that they vectorise and yet have a fixed order.
const LANES: usize = 16;

/// Writes `valid * |d|` to `error` and adds `weight * valid * sign(d)` to `d_x`.
#[inline(always)]
pub fn l1(d: &[f32], valid: &[f32], weight: f32, error: &mut [f32], d_x: &mut [f32]) {
    let n = error.len();
    let (d, valid, d_x) = (&d[..n], &valid[..n], &mut d_x[..n]);
    for i in 0..n {
        error[i] = valid[i] * d[i].abs();
        d_x[i] += weight * valid[i] * sign(d[i]);
    }
}

/// -1, 0 or 1: the derivative of `|x|`.
#[inline(always)]
pub fn sign(x: f32) -> f32 {
    f32::from(i8::from(x > 0.0) - i8::from(x < 0.0))
}

/// The sum of some thousand values.
#[inline(always)]
pub fn sum_lanes(values: &[f32]) -> f64 {
    let (blocks, rest) = values.as_chunks::<LANES>();
    let mut lanes = [0.0f32; LANES];
    for block in blocks {
        for (lane, value) in lanes.iter_mut().zip(block) {
            *lane += value;
        }
    }
    lanes.iter().chain(rest).map(|x| f64::from(*x)).sum()
}
