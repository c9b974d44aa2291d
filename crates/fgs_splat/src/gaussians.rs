//! The gaussians' stored parameters, as a structure of arrays, and their activations.
//!
//! Converts between plain quantities (metres, opacity, RGB) and the unconstrained parameters that
//! are optimised. All arrays have the same length.

use nalgebra::RealField;
use serde::{Deserialize, Serialize};

/// Spherical-harmonics basis of degree 0: `rgb = 0.5 + SH0_FACTOR * sh`, = 1 / (2 sqrt(pi)).
pub const SH0_FACTOR: f64 = 0.282_094_791_773_878_14;

/// Opacities are clamped to this distance from 0 and 1, where the logit is infinite: far below the
/// visible 1/255.
const MIN_OPACITY: f64 = 1e-6;
/// Scales are clamped to at least this many metres: zero has no logarithm.
const MIN_SCALE_M: f64 = 1e-12;

/// N gaussians in world axes, as the parameters that are optimised. Every array has N entries. `T`
/// is `f32`, or `f64` in tests.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Gaussians<T = f32> {
    /// Centres, metres, [N, 3].
    pub means: Vec<[T; 3]>,
    /// Rotations `world_from_gaussian`, wxyz, normalised on use, [N, 4].
    pub quats: Vec<[T; 4]>,
    /// Logarithms of the standard deviations (metres) along the gaussian's axes, [N, 3]. Seeds are
    /// disks whose third axis is the flat one.
    pub log_scales: Vec<[T; 3]>,
    /// `opacity = 1 / (1 + exp(-logit))`, `[N]`.
    pub opacity_logits: Vec<T>,
    /// Colour as spherical harmonics of degree 0, [N, 3].
    pub sh: Vec<[T; 3]>,
    /// Whether the depth at which a gaussian was seeded is a guess rather than a measurement, `[N]`.
    /// Not optimised.
    pub inferred: Vec<bool>,
}

/// One gaussian in plain quantities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian<T = f32> {
    /// Centre, world axes, metres.
    pub mean: [T; 3],
    /// Rotation `world_from_gaussian`, wxyz.
    pub quat: [T; 4],
    /// Standard deviations along the gaussian's axes, metres.
    pub scales: [T; 3],
    /// 0 to 1.
    pub opacity: T,
    /// Colour, about 0..1.
    pub rgb: [T; 3],
}

impl<T> Gaussians<T> {
    /// Number of gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Whether every array has `len` entries.
    pub fn has_len(&self, len: usize) -> bool {
        [
            self.means.len(),
            self.quats.len(),
            self.log_scales.len(),
            self.opacity_logits.len(),
            self.sh.len(),
            self.inferred.len(),
        ] == [len; 6]
    }

    /// Keeps the gaussians i with `keep[i]`, in order.
    ///
    /// # Panics
    /// Unless `keep` has N entries.
    pub fn retain(&mut self, keep: &[bool]) {
        retain(&mut self.means, keep);
        retain(&mut self.quats, keep);
        retain(&mut self.log_scales, keep);
        retain(&mut self.opacity_logits, keep);
        retain(&mut self.sh, keep);
        retain(&mut self.inferred, keep);
    }
}

/// Keeps the entries i with `keep[i]`, in order. Panics unless the lengths are equal.
pub(crate) fn retain<T>(entries: &mut Vec<T>, keep: &[bool]) {
    assert_eq!(entries.len(), keep.len(), "one flag for each entry");
    let mut keep = keep.iter();
    entries.retain(|_| keep.next().is_some_and(|keep| *keep));
}

/// An opacity from its logit.
pub(crate) fn opacity<T: RealField + Copy>(logit: T) -> T {
    // The exponential of a negative number cannot overflow.
    let small = (-logit.abs()).exp();
    let (one, sum) = (T::one(), T::one() + small);
    if logit < T::zero() {
        small / sum
    } else {
        one / sum
    }
}

impl<T: Copy> Gaussians<T> {
    /// Appends all of `other`.
    pub fn extend(&mut self, other: &Self) {
        self.means.extend_from_slice(&other.means);
        self.quats.extend_from_slice(&other.quats);
        self.log_scales.extend_from_slice(&other.log_scales);
        self.opacity_logits.extend_from_slice(&other.opacity_logits);
        self.sh.extend_from_slice(&other.sh);
        self.inferred.extend_from_slice(&other.inferred);
    }
}

impl<T: Clone + Default> Gaussians<T> {
    /// `len` entries with all parameters zero.
    pub fn zeros(len: usize) -> Self {
        let mut zeros = Self::default();
        zeros.resize(len);
        zeros
    }

    /// Truncates to `len` entries, or pads with zeros.
    pub fn resize(&mut self, len: usize) {
        self.means.resize(len, Default::default());
        self.quats.resize(len, Default::default());
        self.log_scales.resize(len, Default::default());
        self.opacity_logits.resize(len, Default::default());
        self.sh.resize(len, Default::default());
        self.inferred.resize(len, false);
    }
}

impl<T: RealField + Copy> Gaussians<T> {
    /// Appends a gaussian, not an inferred one. Its opacity is clamped to 1e-6 from 0 and 1, its scales to at least
    /// 1e-12 m.
    pub fn push(&mut self, gaussian: &Gaussian<T>) {
        let [min_opacity, min_scale, factor] =
            [MIN_OPACITY, MIN_SCALE_M, SH0_FACTOR].map(nalgebra::convert::<f64, T>);
        let half = nalgebra::convert(0.5);
        let opacity = gaussian.opacity.clamp(min_opacity, T::one() - min_opacity);
        self.means.push(gaussian.mean);
        self.quats.push(gaussian.quat);
        self.log_scales
            .push(gaussian.scales.map(|scale| scale.max(min_scale).ln()));
        self.opacity_logits
            .push((opacity / (T::one() - opacity)).ln());
        self.sh.push(gaussian.rgb.map(|c| (c - half) / factor));
        self.inferred.push(false);
    }

    /// Opacity of gaussian i, 0 to 1.
    pub fn opacity(&self, i: usize) -> T {
        opacity(self.opacity_logits[i])
    }

    /// Standard deviations of gaussian i along its axes, metres.
    pub fn scales(&self, i: usize) -> [T; 3] {
        self.log_scales[i].map(T::exp)
    }

    /// RGB of gaussian i, about 0..1 but not clamped.
    pub fn rgb(&self, i: usize) -> [T; 3] {
        let [half, factor] = [0.5, SH0_FACTOR].map(nalgebra::convert::<f64, T>);
        self.sh[i].map(|sh| half + factor * sh)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaussian(seed: f64) -> Gaussian<f64> {
        Gaussian {
            mean: [seed, 2.0, 3.0],
            quat: [0.5, -0.5, 0.5, seed],
            scales: [0.01, 0.02, 5e-6 + seed],
            opacity: 0.99,
            rgb: [0.1, 0.9, 0.5],
        }
    }

    #[test]
    fn what_is_pushed_comes_back() {
        let mut gaussians = Gaussians::default();
        gaussians.push(&gaussian(0.1));
        gaussians.push(&gaussian(0.2));
        assert_eq!(gaussians.means[1], [0.2, 2.0, 3.0]);
        assert_eq!(gaussians.quats[1], [0.5, -0.5, 0.5, 0.2]);
        assert!((gaussians.opacity(1) - 0.99).abs() <= 1e-12);
        assert!((gaussians.opacity_logits[1] - 99f64.ln()).abs() <= 1e-12);
        for (actual, expected) in [
            (gaussians.scales(1), [0.01, 0.02, 5e-6 + 0.2]),
            (gaussians.rgb(1), [0.1, 0.9, 0.5]),
        ] {
            for i in 0..3 {
                assert!((actual[i] - expected[i]).abs() <= 1e-12);
            }
        }
        assert!((gaussians.sh[1][0] - (0.1 - 0.5) / 0.28209479177387814).abs() <= 1e-12);
    }

    #[test]
    fn extremes_stay_finite() {
        let mut gaussians = Gaussians::<f32>::default();
        for value in [0.0, 1.0, f32::MAX, -f32::MAX] {
            gaussians.push(&Gaussian {
                mean: [0.0; 3],
                quat: [0.0; 4],
                scales: [value; 3],
                opacity: value,
                rgb: [0.0; 3],
            });
        }
        assert!(gaussians.opacity_logits.iter().all(|x| x.is_finite()));
        assert!(
            gaussians
                .log_scales
                .as_flattened()
                .iter()
                .all(|x| x.is_finite())
        );
        gaussians.opacity_logits = vec![f32::MAX, -f32::MAX, 0.0, 1.0];
        assert_eq!(gaussians.opacity(0), 1.0);
        assert_eq!(gaussians.opacity(1), 0.0);
        assert_eq!(gaussians.opacity(2), 0.5);
    }

    #[test]
    fn retain_and_extend_keep_every_array_in_step() {
        let mut gaussians = Gaussians::default();
        for i in 0..5 {
            gaussians.push(&gaussian(f64::from(i)));
        }
        gaussians.inferred[1] = true;
        let mut kept = Gaussians::default();
        for i in [1, 2, 4] {
            kept.push(&gaussian(f64::from(i)));
        }
        kept.inferred[0] = true;
        let all = gaussians.clone();
        gaussians.retain(&[false, true, true, false, true]);
        assert_eq!(gaussians, kept);
        kept.extend(&all);
        assert_eq!(kept.len(), 8);
        kept.retain(&[false, false, false, true, true, true, true, true]);
        assert_eq!(kept, all);
    }
}
