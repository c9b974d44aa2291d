//! Normal equations of residuals with robust weights: Cauchy's, scaled by the estimated noise.

use nalgebra::{SMatrix, SVector};

use crate::residual::noise_of;

/// Fewer points do not determine a motion reliably.
pub(crate) const MIN_POINTS: usize = 50;

/// Residual at which the weight is 1/2, in standard deviations: 95 % efficiency for Gaussian noise.
const CAUCHY: f64 = 2.385;

pub(crate) struct NormalEquations<const N: usize> {
    pub hessian: SMatrix<f64, N, N>,
    pub gradient: SVector<f64, N>,
    /// Standard deviation of the residuals.
    pub noise: f64,
}

impl<const N: usize> NormalEquations<N> {
    /// From the points' residuals and their derivatives; `None` if there are too few.
    pub(crate) fn robust(rows: &[(f64, SVector<f64, N>)], min_noise: f64) -> Option<Self> {
        if rows.len() < MIN_POINTS {
            return None;
        }
        let mut sizes: Vec<f64> = rows.iter().map(|(residual, _)| residual.abs()).collect();
        let noise = noise_of(&mut sizes).max(min_noise);
        let mut hessian = SMatrix::<f64, N, N>::zeros();
        let mut gradient = SVector::zeros();
        for (residual, jacobian) in rows {
            let weight = 1.0 / (1.0 + (residual / (CAUCHY * noise)).powi(2)) / (noise * noise);
            hessian.syger(weight, jacobian, jacobian, 1.0);
            gradient += weight * *residual * jacobian;
        }
        hessian.fill_upper_triangle_with_lower_triangle();
        Some(Self {
            hessian,
            gradient,
            noise,
        })
    }
}
