//! A relative motion measured between two keyframes.

use fgs_geom::{KeyframeId, Se3};
use nalgebra::Matrix6;

use crate::GraphError;

/// Largest difference of mirrored entries of an information matrix, as a share of its largest.
const MAX_ASYMMETRY: f64 = 1e-9;

/// A measured relative pose. Its residual is the tangent
/// `log(from_from_to^-1 * world_from_from^-1 * world_from_to)`.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    /// Where it begins.
    pub from: KeyframeId,
    /// Where it ends.
    pub to: KeyframeId,
    /// The measurement: maps coordinates of `to` to those of `from`, metres.
    pub from_from_to: Se3,
    /// Inverse covariance of the residual `[omega, v]` (rad, metres) in the axes of `to`.
    pub information: Matrix6<f64>,
    /// What becomes of the edge if it contradicts the others.
    pub kernel: Kernel,
}

/// How an edge's squared error `r^T information r` counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// Fully, whatever it is: for consecutive keyframes, which hold the graph together.
    Quadratic,
    /// At most [`max_squared_error`](crate::OptimizeSettings::max_squared_error): an edge beyond it
    /// is rejected and has no influence. For loops, which may be false.
    TruncatedQuadratic,
}

impl Edge {
    /// Refuses what no optimisation could use, apart from unknown keyframes.
    pub(crate) fn check(&self) -> Result<(), GraphError> {
        let (from, to) = (self.from, self.to);
        if from == to {
            return Err(GraphError::SelfEdge { id: from });
        }
        if !is_finite(&self.from_from_to) {
            return Err(GraphError::NonFiniteEdge { from, to });
        }
        let information = &self.information;
        let finite = information.iter().all(|value| value.is_finite());
        let asymmetry = (information - information.transpose()).amax();
        if !finite
            || asymmetry > MAX_ASYMMETRY * information.amax()
            || information.cholesky().is_none()
        {
            return Err(GraphError::InvalidInformation { from, to });
        }
        Ok(())
    }
}

/// Whether a pose has a rotation and no value that is no number.
pub(crate) fn is_finite(pose: &Se3) -> bool {
    let quaternion = pose.rotation.as_ref();
    let near_unit = (quaternion.norm() - 1.0).abs() <= 1e-3;
    near_unit && pose.translation.iter().all(|value| value.is_finite())
}
