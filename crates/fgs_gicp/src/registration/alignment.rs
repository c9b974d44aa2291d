//! What a registration found, and how far it is to be trusted.

use fgs_geom::Se3;
use nalgebra::{Matrix3, Matrix6, SymmetricEigen, Vector3, Vector6};
use thiserror::Error;

/// The result of a registration.
#[derive(Clone, Debug)]
pub struct Alignment {
    /// Maps source points to the target.
    pub target_from_source: Se3,
    /// Whether the last step was below the settings' epsilons.
    pub converged: bool,
    /// Number of linearisations of all points.
    pub iterations: usize,
    /// Number of source points with a target point within the correspondence distance.
    pub inliers: usize,
    /// `inliers` over the number of source points.
    pub inlier_share: f64,
    /// Root of the weighted mean squared residual, mostly along the surfaces' normals, metres.
    pub rms_residual_m: f64,
    /// Sum of J^T M J at the result, tangent `[omega, v]` in the source's axes.
    pub hessian: Matrix6<f64>,
    /// Variance of the residuals in units of the points' covariances: the cost `e^T M e` of a pair
    /// for each degree of freedom that the motion leaves.
    pub residual_variance: f64,
    /// How well the pairs hold the motion.
    pub conditioning: Conditioning,
}

/// Residuals below this are rounding of `f32` positions, metres.
const MIN_NOISE_M: f64 = 1e-6;

impl Alignment {
    /// Inverse covariance of `target_from_source` under right perturbations, tangent `[omega, v]`
    /// (rad, metres) in the source's axes: what an edge of a pose graph needs.
    ///
    /// The Hessian knows the covariances' shapes only; their scale is the residuals' variance. A
    /// pair counts as one degree of freedom, that along the normal: points without normals get up
    /// to three times less information than they have. `sensor_noise_m`, the standard deviation of
    /// a pair's distance along its normal, is a floor: pairs may agree by chance, and errors that
    /// they share do not show in residuals.
    ///
    /// It promises too much where pairs are not independent: many source points on one target
    /// point, points fitted to overlapping windows, and noise near the spacing of the target's
    /// points, since a nearest point is then chosen by its noise (variances up to four times the
    /// predicted with a noise of a quarter of the spacing).
    pub fn information(&self, sensor_noise_m: f64) -> Matrix6<f64> {
        let translation_block = self.hessian.fixed_view::<3, 3>(3, 3);
        let information_per_pair = translation_block.trace() / self.inliers.max(1) as f64;
        let floor = sensor_noise_m.max(MIN_NOISE_M).powi(2) * information_per_pair;
        self.hessian / self.residual_variance.max(floor)
    }
}

/// How well the pairs hold the weakest of all motions.
#[derive(Clone, Copy, Debug)]
pub struct Conditioning {
    /// Smallest over largest eigenvalue of the Hessian about the source's centroid, with rotation
    /// measured as the arc at the points' root mean square distance from it: 1 means that all
    /// motions are held alike; a plane gives about the covariances' smallest eigenvalue.
    pub weakest: f64,
    /// The unit motion held least, `[omega, v]` about the centroid in the source's axes, rotation
    /// measured as that arc.
    pub weakest_motion: Vector6<f64>,
}

impl Conditioning {
    /// Of a Hessian whose source points have this mean and root mean square distance from it.
    pub(crate) fn new(hessian: &Matrix6<f64>, centroid: &Vector3<f64>, radius_m: f64) -> Self {
        // A motion [w, v] about the centroid is [w, v - w x c] about the origin.
        let mut origin_from_centroid = Matrix6::identity();
        let turn_to_shift: Matrix3<f64> = fgs_geom::skew(centroid);
        origin_from_centroid
            .fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&turn_to_shift);
        let arc = 1.0 / radius_m.max(f64::MIN_POSITIVE);
        let scale = Matrix6::from_diagonal(&Vector6::new(arc, arc, arc, 1.0, 1.0, 1.0));
        let motion = origin_from_centroid * scale;
        let eigen = SymmetricEigen::new(motion.transpose() * hessian * motion);
        let weakest = eigen.eigenvalues.imin();
        Self {
            weakest: (eigen.eigenvalues[weakest] / eigen.eigenvalues.max()).max(0.0),
            weakest_motion: eigen.eigenvectors.column(weakest).into_owned(),
        }
    }
}

/// Why there is no alignment.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum AlignError {
    /// No source points.
    #[error("the source has no points")]
    EmptySource,
    /// No target points.
    #[error("the target has no points")]
    EmptyTarget,
    /// A source point that is no number.
    #[error("source point {index} is not finite")]
    NonFiniteSource {
        /// Its index.
        index: usize,
    },
    /// A start that is no number.
    #[error("the initial pose is not finite")]
    NonFiniteStart,
    /// The pairs do not hold all six degrees of freedom.
    #[error("only {pairs} of {points} source points have a target point within {max_distance_m} m")]
    TooFewPairs {
        /// Pairs found.
        pairs: usize,
        /// Source points.
        points: usize,
        /// The correspondence distance.
        max_distance_m: f32,
    },
    /// The normal equations have no solution.
    #[error("{pairs} pairs do not determine the motion")]
    Undetermined {
        /// Pairs found.
        pairs: usize,
    },
}
