//! The normal equations of all pairs: sums of J^T M J, J^T M e and the cost.
//!
//! The tangent vector is `[omega, v]`. Sums are f64.

use std::ops::AddAssign;

use fgs_geom::skew;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use crate::Factor;

/// Normal equations of a Gauss-Newton step.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearSystem {
    /// Sum of `w J^T M J`.
    pub hessian: Matrix6<f64>,
    /// Sum of `w J^T M e`, half the cost's gradient.
    pub gradient: Vector6<f64>,
    /// Number of pairs.
    pub pairs: usize,
    /// Sum of weights.
    pub weight: f64,
    /// Weighted sum of squared residuals along the pairs' normals, square metres.
    pub squared_residual: f64,
}

impl LinearSystem {
    /// No pairs.
    pub fn zero() -> Self {
        Self {
            hessian: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            pairs: 0,
            weight: 0.0,
            squared_residual: 0.0,
        }
    }

    /// Adds the pair of source point `p`, with weight `weight`.
    #[inline]
    pub fn add(&mut self, p: &Vector3<f64>, factor: &Factor, weight: f64, squared_residual: f64) {
        let information = factor.information * weight;
        let p_hat = skew(p);
        let me = information * factor.residual;
        // J = [skew(p), -I].
        let p_hat_m: Matrix3<f64> = p_hat * information;
        let mut add_block = |row: usize, column: usize, block: &Matrix3<f64>| {
            let mut view = self.hessian.fixed_view_mut::<3, 3>(row, column);
            view += block;
        };
        add_block(0, 0, &(p_hat_m * p_hat.transpose()));
        add_block(0, 3, &p_hat_m);
        add_block(3, 0, &p_hat_m.transpose());
        add_block(3, 3, &information);
        let turn = me.cross(p);
        self.gradient += Vector6::new(turn.x, turn.y, turn.z, -me.x, -me.y, -me.z);
        self.pairs += 1;
        self.weight += weight;
        self.squared_residual += weight * squared_residual;
    }
}

impl AddAssign<&Self> for LinearSystem {
    fn add_assign(&mut self, other: &Self) {
        self.hessian += other.hessian;
        self.gradient += other.gradient;
        self.pairs += other.pairs;
        self.weight += other.weight;
        self.squared_residual += other.squared_residual;
    }
}
