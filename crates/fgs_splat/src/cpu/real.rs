//! The number types of the CPU rasteriser: `f32` in use, `f64` to test it against the reference.
//!
//! Functions that lane loops call are branch-free, so that the loops vectorise.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub};

use crate::kernel::mul_add;

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
    /// A value and an index, ordered by the value, then by the index.
    type SortKey: Copy + Debug + Default + Ord + Send + Sync;

    /// The nearest value.
    fn from_f64(value: f64) -> Self;
    /// The same value.
    fn to_f64(self) -> f64;
    /// The nearest value.
    fn from_i32(value: i32) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// e^x. `f32`: clamped to 2^-100..2^100; relative error under 2^-22 + 2^-23 |x|.
    fn exp<const FUSED: bool>(self) -> Self;
    /// An upper bound of the base 2 logarithm, at most 0.02 too large.
    fn log2_at_least(self) -> Self;
    /// a b + c, rounded once.
    fn fused_mul_add(self, b: Self, c: Self) -> Self;
    /// 2^-x for x >= 0, exactly 1 at 0; x above 100 counts as 100. `f32`: relative error under
    /// 2^-22.
    fn exp2_neg<const FUSED: bool>(self) -> Self;
    /// The sort key of a positive value and an index.
    fn sort_key(self, index: u32) -> Self::SortKey;
    /// The key's index.
    fn sorted_index(key: Self::SortKey) -> u32;
    /// Rounded down, for values within +-2^22.
    fn floor_i32(self) -> i32;

    /// The smaller value; `other` if either is NaN.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }

    /// The larger value; `other` if either is NaN.
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

/// 1.5 * 2^23: adding it to a value within +-2^22 rounds to an integer and leaves that in the low
/// bits.
const ROUND: f32 = 12_582_912.0;

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
    type SortKey = u64;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn from_i32(value: i32) -> Self {
        value as f32
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn log2_at_least(self) -> Self {
        // Of 2^n (1 + t) the bits stand for n + 127 + t, and log2(1 + t) = t + 0.343 t (1 - t) to
        // within 0.009.
        let bits = self.to_bits();
        let t = f32::from_bits(bits & 0x007f_ffff | 1.0_f32.to_bits()) - 1.0;
        let n = (bits >> 23) as f32 - 127.0;
        n + t + 0.343 * t * (1.0 - t) + 0.009
    }

    #[inline(always)]
    fn fused_mul_add(self, b: Self, c: Self) -> Self {
        self.mul_add(b, c)
    }

    #[inline(always)]
    fn exp2_neg<const FUSED: bool>(self) -> Self {
        exp2::<FUSED>(-Real::min(self, 100.0))
    }

    #[inline(always)]
    fn exp<const FUSED: bool>(self) -> Self {
        let x = self * std::f32::consts::LOG2_E;
        exp2::<FUSED>(Real::min(Real::max(x, -100.0), 100.0))
    }

    #[inline(always)]
    fn sort_key(self, index: u32) -> u64 {
        u64::from(self.to_bits()) << 32 | u64::from(index)
    }
    #[inline(always)]
    fn sorted_index(key: u64) -> u32 {
        key as u32
    }
    #[inline(always)]
    fn floor_i32(self) -> i32 {
        // `as` saturates, which has no SIMD instruction.
        let bits = (self.floor() + ROUND).to_bits();
        bits.wrapping_sub(ROUND.to_bits()) as i32
    }
}

/// 2^x for |x| <= 100.
#[inline(always)]
fn exp2<const FUSED: bool>(x: f32) -> f32 {
    let rounded = x + ROUND;
    let f = x - (rounded - ROUND);
    let [c1, c2, c3, c4, c5] = EXP2;
    let power = [c4, c3, c2, c1, 1.0]
        .into_iter()
        .fold(c5, |power, c| mul_add::<FUSED, f32>(power, f, c));
    f32::from_bits(power.to_bits().wrapping_add(rounded.to_bits() << 23))
}

impl Real for f64 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    type SortKey = (u64, u32);

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
    #[inline(always)]
    fn from_i32(value: i32) -> Self {
        f64::from(value)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn exp<const FUSED: bool>(self) -> Self {
        self.exp()
    }
    #[inline(always)]
    fn log2_at_least(self) -> Self {
        self.log2()
    }
    #[inline(always)]
    fn fused_mul_add(self, b: Self, c: Self) -> Self {
        self.mul_add(b, c)
    }
    #[inline(always)]
    fn exp2_neg<const FUSED: bool>(self) -> Self {
        (-Real::min(self, 100.0)).exp2()
    }
    #[inline(always)]
    fn sort_key(self, index: u32) -> (u64, u32) {
        (self.to_bits(), index)
    }
    #[inline(always)]
    fn sorted_index((_, index): (u64, u32)) -> u32 {
        index
    }
    #[inline(always)]
    fn floor_i32(self) -> i32 {
        self.floor() as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check_exp2<const FUSED: bool>() {
        assert_eq!(Real::exp2_neg::<FUSED>(0.0_f32), 1.0);
        let mut worst: f64 = 0.0;
        for step in 0..200_000 {
            let x = 20.0 * step as f32 / 200_000.0;
            let exact = (-f64::from(x)).exp2();
            worst = worst.max((f64::from(x.exp2_neg::<FUSED>()) - exact).abs() / exact);
        }
        assert!(worst <= 2_f64.powi(-22), "{worst:e}");
        for x in [100.0_f32, 1e30, f32::INFINITY] {
            let tiny = x.exp2_neg::<FUSED>();
            assert!((0.0..1e-30).contains(&tiny), "{tiny:e}");
        }
    }

    fn check_exp<const FUSED: bool>() {
        for step in -60_000..=60_000 {
            let x = step as f32 / 1000.0;
            let exact = f64::from(x).exp();
            let error = (f64::from(Real::exp::<FUSED>(x)) - exact).abs() / exact;
            let bound = 2_f64.powi(-22) + 2_f64.powi(-23) * f64::from(x.abs());
            assert!(error <= bound, "{x}: {error:e}");
        }
        for x in [1e30, f32::NEG_INFINITY] {
            assert!(Real::exp::<FUSED>(x).is_finite());
        }
    }

    #[test]
    fn the_logarithm_keeps_its_bounds() {
        for step in 1..100_000 {
            let x = 0.01 * step as f32;
            let above = f64::from(x.log2_at_least()) - f64::from(x).log2();
            assert!((0.0..=0.02).contains(&above), "{x}: {above}");
        }
    }

    #[test]
    fn exponentials_keep_their_error_bounds() {
        check_exp2::<false>();
        check_exp2::<true>();
        check_exp::<false>();
        check_exp::<true>();
    }
}
