//! One pair of points: `d^T (C_q + R C_p R^T)^-1 d` with `d = q - T p` (Eq. 12 to 14).
//!
//! It is evaluated in the source's axes, `e = R^T d` and `M = (R^T C_q R + C_p)^-1`, where the
//! cost is the same and the Jacobian of a right perturbation is constant: `[skew(p), -I]`.

use nalgebra::{Matrix3, Vector3};

/// Residual and information of a pair, in the source's axes.
#[derive(Clone, Copy, Debug)]
pub struct Factor {
    /// `R^T (q - t) - p`, metres.
    pub residual: Vector3<f64>,
    /// `(R^T C_q R + C_p)^-1`, symmetric.
    pub information: Matrix3<f64>,
}

impl Factor {
    /// The pair of source point `p` with covariance `source_covariance` and target point `q` with
    /// `target_covariance`, under `target_from_source` given by its rotation and translation.
    /// `None` if the covariances' sum has no inverse.
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

    /// The squared residual in square metres whatever the covariances' scale: the mean over
    /// directions weighted by their information, so for thin disks that along the normal.
    #[inline]
    pub fn squared_residual(&self) -> f64 {
        self.cost() / self.information.trace()
    }
}

/// The inverse of a symmetric positive definite matrix by cofactors; `None` if it is none.
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
