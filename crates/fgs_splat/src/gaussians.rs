//! The gaussians' stored parameters, as structure of arrays.

/// Spherical-harmonics basis of degree 0: `rgb = 0.5 + SH0_FACTOR * sh`, = 1 / (2 sqrt(pi)).
pub const SH0_FACTOR: f64 = 0.282_094_791_773_878_14;

/// N gaussians. Every array has N entries; they are the quantities that are optimised.
/// World axes, metres. `T` is `f32`, or `f64` in tests.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians<T = f32> {
    /// Centres, [N, 3].
    pub means: Vec<[T; 3]>,
    /// Rotations `world_from_gaussian`, wxyz, normalised when used, [N, 4].
    pub quats: Vec<[T; 4]>,
    /// Logarithms of the standard deviations along the gaussian's axes, [N, 3]. Seeds are disks
    /// whose third axis is the flat one.
    pub log_scales: Vec<[T; 3]>,
    /// `opacity = 1 / (1 + exp(-logit))`, [N].
    pub opacity_logits: Vec<T>,
    /// Colour as spherical harmonics of degree 0, [N, 3].
    pub sh: Vec<[T; 3]>,
}

impl<T> Gaussians<T> {
    /// N.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }
}
