//! The two number types of the CPU rasteriser: `f32` for work, `f64` to hold it against the
//! reference.
//!
//! Everything here is branch-free where a lane loop uses it, so that the loops vectorise, and
//! free of fused operations, so that every instruction set gives the same bits.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub};

/// `f32` or `f64`.
pub trait Real:
    Copy
    + Debug
    + Default
    + PartialOrd
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + MulAssign
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// Bits of [`Real::sort_key`] that can differ.
    const SORT_KEY_BITS: u32;

    /// The nearest value.
    fn from_f64(value: f64) -> Self;
    /// The same value.
    fn to_f64(self) -> f64;
    /// Square root.
    fn sqrt(self) -> Self;
    /// e^x.
    fn exp(self) -> Self;
    /// Natural logarithm.
    fn ln(self) -> Self;
    /// 2^x for x <= 0, exactly 1 at 0; x below -100 counts as -100. `f32`: relative error under
    /// 2^-22.
    fn exp2_nonpositive(self) -> Self;
    /// An integer with the order of the (positive) values.
    fn sort_key(self) -> u64;
    /// Integer part towards minus infinity, saturating.
    fn floor_i64(self) -> i64;

    /// The lesser; `other` if either is NaN.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }

    /// The greater; `other` if either is NaN.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }

    /// Absolute value.
    #[inline(always)]
    fn abs(self) -> Self {
        if self < Self::ZERO { -self } else { self }
    }
}

/// Minimax polynomial of 2^f on [-1/2, 1/2] with value 1 at 0, from the linear term up: relative
/// error 9.2e-8.
#[expect(
    clippy::approx_constant,
    reason = "the best coefficient is not quite ln 2"
)]
const EXP2: [f32; 5] = [
    0.693_147,
    0.240_222_42,
    0.055_507_34,
    0.009_671_513,
    0.001_326_472_7,
];

impl Real for f32 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const SORT_KEY_BITS: u32 = 31;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn exp(self) -> Self {
        self.exp()
    }
    #[inline(always)]
    fn ln(self) -> Self {
        self.ln()
    }

    #[inline(always)]
    fn exp2_nonpositive(self) -> Self {
        // Adding 1.5 * 2^23 rounds to an integer, which then stands in the lowest bits.
        const ROUND: f32 = 12_582_912.0;
        let x = Real::max(self, -100.0);
        let rounded = x + ROUND;
        let f = x - (rounded - ROUND);
        let [c1, c2, c3, c4, c5] = EXP2;
        let power = ((((c5 * f + c4) * f + c3) * f + c2) * f + c1) * f + 1.0;
        f32::from_bits(power.to_bits().wrapping_add(rounded.to_bits() << 23))
    }

    #[inline(always)]
    fn sort_key(self) -> u64 {
        u64::from(self.to_bits())
    }
    #[inline(always)]
    fn floor_i64(self) -> i64 {
        self.floor() as i64
    }
}

impl Real for f64 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const SORT_KEY_BITS: u32 = 63;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn exp(self) -> Self {
        self.exp()
    }
    #[inline(always)]
    fn ln(self) -> Self {
        self.ln()
    }
    #[inline(always)]
    fn exp2_nonpositive(self) -> Self {
        Real::max(self, -100.0).exp2()
    }
    #[inline(always)]
    fn sort_key(self) -> u64 {
        self.to_bits()
    }
    #[inline(always)]
    fn floor_i64(self) -> i64 {
        self.floor() as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp2_keeps_its_error_bound() {
        assert_eq!(Real::exp2_nonpositive(0.0_f32), 1.0);
        let mut worst: f64 = 0.0;
        for step in 0..200_000 {
            let x = -20.0 * step as f32 / 200_000.0;
            let exact = f64::from(x).exp2();
            worst = worst.max((f64::from(x.exp2_nonpositive()) - exact).abs() / exact);
        }
        assert!(worst <= 2_f64.powi(-22), "{worst:e}");
        for x in [-100.0_f32, -1e30, f32::NEG_INFINITY] {
            let tiny = x.exp2_nonpositive();
            assert!((0.0..1e-30).contains(&tiny), "{tiny:e}");
        }
    }
}
