//! The covariance of a point: a symmetric 3x3 matrix, stored as six `f32`.
//!
//! GICP (Segal et al. 2009) gives each point the covariance of the surface patch that it
//! represents: large in the tangent plane, small along the normal. Only its shape matters, so it is
//! scaled to a middle eigenvalue of 1 (paper Sec. III-B). A floor on the smallest eigenvalue keeps
//! sums of covariances invertible.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use serde::{Deserialize, Serialize};

/// Floor of the smallest eigenvalue after the middle one has been scaled to 1: the variance along
/// the normal relative to that in the tangent plane. Same value as in GICP and the paper.
pub const MIN_EIGENVALUE: f64 = 1e-3;

/// A symmetric positive definite 3x3 matrix.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Covariance {
    /// `[xx, xy, xz, yy, yz, zz]`.
    upper: [f32; 6],
}

impl Covariance {
    /// The identity, which reduces the factor to point-to-point ICP.
    pub fn isotropic() -> Self {
        Self {
            upper: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
        }
    }

    /// A disk: variance 1 in the tangent plane and `thickness` along the unit vector `normal`.
    pub fn disk(normal: &Vector3<f64>, thickness: f64) -> Self {
        let n = normal;
        let k = thickness - 1.0;
        let upper = [
            1.0 + k * n.x * n.x,
            k * n.x * n.y,
            k * n.x * n.z,
            1.0 + k * n.y * n.y,
            k * n.y * n.z,
            1.0 + k * n.z * n.z,
        ];
        Self {
            upper: upper.map(|value| value as f32),
        }
    }

    /// Regularises a symmetric matrix: divides the eigenvalues by the middle one and floors them at
    /// [`MIN_EIGENVALUE`]. `None` if an entry is not finite or the rank is below two, since such a
    /// matrix does not describe a surface.
    pub fn regularized(matrix: &Matrix3<f64>) -> Option<Self> {
        let scale = matrix.amax();
        if !scale.is_finite() || scale <= 0.0 || matrix.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let eigen = SymmetricEigen::new(matrix / scale);
        let mut sorted = eigen.eigenvalues;
        sorted.as_mut_slice().sort_by(f64::total_cmp);
        let middle = sorted[1];
        // Relative to the largest entry, a middle eigenvalue this small is rounding error.
        if middle <= 1e-9 {
            return None;
        }
        let values = eigen
            .eigenvalues
            .map(|value| (value / middle).max(MIN_EIGENVALUE));
        let axes = eigen.eigenvectors;
        Some(Self::from_matrix(
            &(axes * Matrix3::from_diagonal(&values) * axes.transpose()),
        ))
    }

    /// Takes the upper triangle of `matrix` unchanged. The caller must ensure that the matrix is
    /// positive definite.
    pub fn from_matrix(matrix: &Matrix3<f64>) -> Self {
        let m = matrix;
        let upper = [
            m[(0, 0)],
            m[(0, 1)],
            m[(0, 2)],
            m[(1, 1)],
            m[(1, 2)],
            m[(2, 2)],
        ];
        Self {
            upper: upper.map(|value| value as f32),
        }
    }

    /// The covariance multiplied by `factor`.
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            upper: self.upper.map(|value| (f64::from(value) * factor) as f32),
        }
    }

    /// Whether every entry is finite.
    pub fn is_finite(&self) -> bool {
        self.upper.iter().all(|value| value.is_finite())
    }

    /// `[xx, xy, xz, yy, yz, zz]`.
    #[inline]
    pub(crate) fn upper(&self) -> &[f32; 6] {
        &self.upper
    }

    /// The full matrix.
    #[inline]
    pub fn matrix(&self) -> Matrix3<f64> {
        let [xx, xy, xz, yy, yz, zz] = self.upper.map(f64::from);
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }

    /// The covariance of the patch after rotating it: R C R^T.
    #[inline]
    pub fn rotated(&self, rotation: &Matrix3<f64>) -> Self {
        Self::from_matrix(&(rotation * self.matrix() * rotation.transpose()))
    }
}

#[cfg(test)]
#[path = "covariance_tests.rs"]
mod tests;
