//! The normal equations over all correspondences: sums of J^T M J, J^T M e and the cost.
//!
//! The tangent vector is `[omega, v]`. Sums are accumulated in f64.

use std::ops::AddAssign;

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use crate::Factor;

/// Normal equations of a Gauss-Newton step.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearSystem {
    /// Blocks of the sum of `w J^T M J`: rotation-rotation, rotation-translation and
    /// translation-translation.
    pub(super) rotation_block: Matrix3<f64>,
    pub(super) mixed_block: Matrix3<f64>,
    pub(super) translation_block: Matrix3<f64>,
    /// Sum of `w J^T M e`, half the gradient of the cost.
    pub gradient: Vector6<f64>,
    /// Number of correspondences.
    pub pairs: usize,
    /// Sum of robust weights.
    pub weight: f64,
    /// Weighted sum of squared residuals along the normals, square metres.
    pub squared_residual: f64,
    /// Weighted sum of the costs `e^T M e`.
    pub cost: f64,
}

impl LinearSystem {
    /// The empty sum.
    pub fn zero() -> Self {
        Self {
            rotation_block: Matrix3::zeros(),
            mixed_block: Matrix3::zeros(),
            translation_block: Matrix3::zeros(),
            gradient: Vector6::zeros(),
            pairs: 0,
            weight: 0.0,
            squared_residual: 0.0,
            cost: 0.0,
        }
    }

    /// Sum of `w J^T M J`.
    pub fn hessian(&self) -> Matrix6<f64> {
        let mut hessian = Matrix6::zeros();
        let mut set = |row: usize, column: usize, block: &Matrix3<f64>| {
            let mut view = hessian.fixed_view_mut::<3, 3>(row, column);
            view.copy_from(block);
        };
        set(0, 0, &self.rotation_block);
        set(0, 3, &self.mixed_block);
        set(3, 0, &self.mixed_block.transpose());
        set(3, 3, &self.translation_block);
        hessian
    }

    /// Adds the correspondence of source point `p` with robust weight `weight`.
    #[inline]
    pub fn add(&mut self, p: &Vector3<f64>, factor: &Factor, weight: f64, squared_residual: f64) {
        let information = factor.information * weight;
        let me = information * factor.residual;
        // With J = [skew(p), -I] and M symmetric, the blocks are skew(p) M skew(p)^T and skew(p) M.
        let p_hat_m = cross_columns(p, &information);
        self.rotation_block += cross_columns(p, &p_hat_m.transpose());
        self.mixed_block += p_hat_m;
        self.translation_block += information;
        let turn = me.cross(p);
        self.gradient += Vector6::new(turn.x, turn.y, turn.z, -me.x, -me.y, -me.z);
        self.pairs += 1;
        self.weight += weight;
        self.squared_residual += weight * squared_residual;
        self.cost += information.trace() * squared_residual;
    }
}

/// `skew(a) m`.
#[inline]
fn cross_columns(a: &Vector3<f64>, m: &Matrix3<f64>) -> Matrix3<f64> {
    let cross = |column: usize| a.cross(&m.column(column));
    Matrix3::from_columns(&[cross(0), cross(1), cross(2)])
}

impl AddAssign<&Self> for LinearSystem {
    fn add_assign(&mut self, other: &Self) {
        self.rotation_block += other.rotation_block;
        self.mixed_block += other.mixed_block;
        self.translation_block += other.translation_block;
        self.gradient += other.gradient;
        self.pairs += other.pairs;
        self.weight += other.weight;
        self.squared_residual += other.squared_residual;
        self.cost += other.cost;
    }
}
