//! The result of a registration and its uncertainty.

use fgs_geom::Se3;
use nalgebra::{Matrix3, Matrix6, SymmetricEigen, Vector3, Vector6};
use thiserror::Error;

/// The result of a registration.
#[derive(Clone, Debug)]
pub struct Alignment {
    /// Maps source points to the target frame.
    pub target_from_source: Se3,
    /// Whether the last step was below the epsilons of the settings.
    pub converged: bool,
    /// Number of Gauss-Newton iterations over all points.
    pub iterations: usize,
    /// Number of source points that have a target point within the correspondence distance.
    pub inliers: usize,
    /// Inlier ratio: `inliers` divided by the number of source points.
    pub inlier_share: f64,
    /// Weighted RMS residual, mostly along the surface normals, metres.
    pub rms_residual_m: f64,
    /// Sum of J^T M J at the result, with the tangent `[omega, v]` in the source frame.
    pub hessian: Matrix6<f64>,
    /// Variance of the residuals relative to the points' covariances: the cost `e^T M e` of a
    /// correspondence per remaining degree of freedom, after subtracting the six of the pose.
    pub residual_variance: f64,
    /// How well the correspondences constrain the pose.
    pub conditioning: Conditioning,
}

/// Smaller residuals are rounding errors of the `f32` positions, metres.
const MIN_NOISE_M: f64 = 1e-6;

impl Alignment {
    /// Information matrix of `target_from_source` for right perturbations, tangent `[omega, v]`
    /// (rad, metres) in the source frame: what an edge of a pose graph needs.
    ///
    /// The Hessian depends on the shape of the covariances only; their scale is estimated from the
    /// variance of the residuals. Each correspondence counts as one degree of freedom, along the
    /// normal, so isotropic points get up to three times less information than they carry.
    /// `sensor_noise_m` is the standard deviation of the distance along the normal within a
    /// correspondence. It acts as a floor, since residuals may be small by chance and do not show
    /// systematic errors.
    ///
    /// The information is overestimated where correspondences are not independent: when many source
    /// points share a target point, when normals are fitted to overlapping windows, and when the
    /// noise approaches the spacing of the target points, because the noise then decides which
    /// point is nearest. With noise of a quarter of the spacing, variances reach up to four times
    /// the predicted ones.
    pub fn information(&self, sensor_noise_m: f64) -> Matrix6<f64> {
        let translation_block = self.hessian.fixed_view::<3, 3>(3, 3);
        let information_per_pair = translation_block.trace() / self.inliers.max(1) as f64;
        let floor = sensor_noise_m.max(MIN_NOISE_M).powi(2) * information_per_pair;
        self.hessian / self.residual_variance.max(floor)
    }
}

/// How well the correspondences constrain the weakest direction of motion.
#[derive(Clone, Copy, Debug)]
pub struct Conditioning {
    /// Smallest over largest eigenvalue of the Hessian about the centroid of the source. Rotations
    /// are measured as the arc length at the RMS distance of the points from it. 1 means that all
    /// directions are equally well constrained; a single plane gives about the smallest eigenvalue
    /// of the covariances.
    pub weakest: f64,
    /// The least constrained unit motion, `[omega, v]` about the centroid in the source frame, with
    /// rotation measured as that arc length.
    pub weakest_motion: Vector6<f64>,
}

impl Conditioning {
    /// Conditioning of a Hessian whose source points have this centroid and RMS distance from it.
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

/// Why a registration failed.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum AlignError {
    /// No source points.
    #[error("the source has no points")]
    EmptySource,
    /// No target points.
    #[error("the target has no points")]
    EmptyTarget,
    /// A source point is not finite.
    #[error("source point {index} is not finite")]
    NonFiniteSource {
        /// Its index.
        index: usize,
    },
    /// The initial pose is not finite.
    #[error("the initial pose is not finite")]
    NonFiniteStart,
    /// Too few correspondences to constrain all six degrees of freedom.
    #[error("only {pairs} of {points} source points have a target point within {max_distance_m} m")]
    TooFewPairs {
        /// Correspondences found.
        pairs: usize,
        /// Number of source points.
        points: usize,
        /// The maximum correspondence distance.
        max_distance_m: f32,
    },
    /// The normal equations are singular or badly conditioned.
    #[error("{pairs} pairs do not determine the motion")]
    Undetermined {
        /// Correspondences found.
        pairs: usize,
    },
}
