//! The GICP factor of one correspondence: `d^T (C_q + R C_p R^T)^-1 d` with `d = q - T p` (Eq. 12
//! to 14).
//!
//! It is evaluated in the source frame, with `e = R^T d` and `M = (R^T C_q R + C_p)^-1`. The cost
//! is the same there, and the Jacobian with respect to a right perturbation depends only on the
//! source point: `[skew(p), -I]`.

use nalgebra::{Matrix3, Vector3};

/// Residual and information matrix of a correspondence, in the source frame.
#[derive(Clone, Copy, Debug)]
pub struct Factor {
    /// `R^T (q - t) - p`, metres.
    pub residual: Vector3<f64>,
    /// `(R^T C_q R + C_p)^-1`, symmetric.
    pub information: Matrix3<f64>,
}

impl Factor {
    /// The correspondence of source point `p` (covariance `source_covariance`) and target point `q`
    /// (covariance `target_covariance`), at the pose `target_from_source` given as rotation and
    /// translation. `None` if the sum of the covariances is singular.
    #[inline]
    pub fn new(
        p: &Vector3<f64>,
        source_covariance: &Matrix3<f64>,
        q: &Vector3<f64>,
        target_covariance: &Matrix3<f64>,
        rotation: &Matrix3<f64>,
        translation: &Vector3<f64>,
    ) -> Option<Self> {
        let source_from_target = rotation.transpose();
        let covariance = source_from_target * target_covariance * rotation + source_covariance;
        Some(Self {
            residual: source_from_target * (q - translation) - p,
            information: inverse_symmetric(&covariance)?,
        })
    }

    /// `d^T (C_q + R C_p R^T)^-1 d`.
    #[inline]
    pub fn cost(&self) -> f64 {
        self.residual.dot(&(self.information * self.residual))
    }

    /// Squared residual in square metres, independent of the scale of the covariances: a mean over
    /// directions weighted by their information. For thin disks this is the squared distance along
    /// the normal.
    #[inline]
    pub fn squared_residual(&self) -> f64 {
        self.cost() / self.information.trace()
    }
}

/// Inverts a symmetric positive definite matrix by cofactors; `None` if the determinant is not
/// positive and finite.
#[inline]
fn inverse_symmetric(m: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let [xx, xy, xz] = [m.m11, m.m12, m.m13];
    let [yy, yz, zz] = [m.m22, m.m23, m.m33];
    let c_xx = yy * zz - yz * yz;
    let c_xy = xz * yz - xy * zz;
    let c_xz = xy * yz - xz * yy;
    let determinant = xx * c_xx + xy * c_xy + xz * c_xz;
    if !(determinant > 0.0 && determinant.is_finite()) {
        return None;
    }
    let c_yy = xx * zz - xz * xz;
    let c_yz = xy * xz - xx * yz;
    let c_zz = xx * yy - xy * xy;
    let inverse = Matrix3::new(c_xx, c_xy, c_xz, c_xy, c_yy, c_yz, c_xz, c_yz, c_zz);
    Some(inverse / determinant)
}

#[cfg(test)]
#[path = "factor_tests.rs"]
mod tests;
