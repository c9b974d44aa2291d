//! A measured relative pose between two keyframes.

use fgs_geom::{KeyframeId, Se3};
use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

use crate::kernel::RobustKernel;
use crate::tangent::inverse_right_jacobian;

/// How one keyframe was found to lie to another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Edge {
    /// The keyframe that it was measured from.
    pub from: KeyframeId,
    /// The keyframe that was measured.
    pub to: KeyframeId,
    /// The measured pose of `to` in the axes of `from`.
    pub from_from_to: Se3,
    /// Inverse covariance of the measurement, tangent `[omega, v]` in the axes of `to` (rad,
    /// metres), symmetric and positive definite, [6, 6].
    pub information: Matrix6<f64>,
    /// How much it counts if it does not fit.
    pub kernel: RobustKernel,
}

/// An edge at given poses.
pub struct Linearized {
    /// `log(measured^-1 * from^-1 * to)`, `[omega, v]`.
    pub residual: Vector6<f64>,
    /// Derivative of the residual by a right perturbation of `from`.
    pub by_from: Matrix6<f64>,
    /// Derivative of the residual by a right perturbation of `to`.
    pub by_to: Matrix6<f64>,
}

impl Edge {
    /// `log(measured^-1 * from^-1 * to)`, `[omega, v]` (rad, metres), at poses
    /// `world_from_keyframe`.
    pub fn residual(&self, from: &Se3, to: &Se3) -> Vector6<f64> {
        (self.from_from_to.inverse() * (from.inverse() * *to)).log()
    }

    /// The squared error `r^T I r`.
    pub fn chi2(&self, from: &Se3, to: &Se3) -> f64 {
        let residual = self.residual(from, to);
        residual.dot(&(self.information * residual))
    }

    pub(crate) fn linearize(&self, from: &Se3, to: &Se3) -> Linearized {
        let residual = self.residual(from, to);
        let by_to = inverse_right_jacobian(&residual);
        // (from exp(x))^-1 to = from^-1 to exp(-Ad(to^-1 from) x)
        let by_from = -by_to * (to.inverse() * *from).adjoint();
        Linearized {
            residual,
            by_from,
            by_to,
        }
    }

    /// Whether every number is finite and the information symmetric and positive definite.
    pub(crate) fn is_valid(&self) -> bool {
        let pose = self.from_from_to.matrix();
        let symmetric = (self.information - self.information.transpose()).amax()
            <= 1e-9 * self.information.amax();
        pose.iter().all(|value| value.is_finite())
            && symmetric
            && self.information.cholesky().is_some()
            && match self.kernel {
                RobustKernel::Quadratic => true,
                RobustKernel::DynamicCovarianceScaling { threshold } => {
                    threshold > 0.0 && threshold.is_finite()
                }
            }
    }
}
