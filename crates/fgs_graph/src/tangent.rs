//! Derivatives on SE(3), tangent `[omega, v]`, perturbations from the right.
//!
//! Equations: Barfoot, State Estimation for Robotics (2017), section 7.1, in our order of the
//! tangent.

use fgs_geom::{inverse_left_jacobian, skew};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// Below this angle (rad) the coefficients lose digits to cancellation and their Taylor series, cut
/// after the second term, are exact to 1e-12.
const SMALL_ANGLE: f64 = 1e-2;

/// The derivative of `log(T exp(x))` by x at 0, where `tangent = log(T)`: the inverse of the right
/// Jacobian of SE(3), [6, 6].
pub fn inverse_right_jacobian(tangent: &Vector6<f64>) -> Matrix6<f64> {
    // J_r(x) = J_l(-x)
    let omega: Vector3<f64> = -tangent.fixed_rows::<3>(0);
    let v: Vector3<f64> = -tangent.fixed_rows::<3>(3);
    let inverse = inverse_left_jacobian(&omega);
    blocks(&inverse, &(-inverse * coupling(&omega, &v) * inverse))
}

/// `[[diagonal, 0], [below, diagonal]]`.
fn blocks(diagonal: &Matrix3<f64>, below: &Matrix3<f64>) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    for (row, column, block) in [(0, 0, diagonal), (3, 3, diagonal), (3, 0, below)] {
        matrix.fixed_view_mut::<3, 3>(row, column).copy_from(block);
    }
    matrix
}

/// The block Q of the left Jacobian that couples rotation and translation, Barfoot's Eq. (7.86b).
fn coupling(omega: &Vector3<f64>, v: &Vector3<f64>) -> Matrix3<f64> {
    let angle = omega.norm();
    let (a, b, c) = if angle < SMALL_ANGLE {
        let angle2 = angle * angle;
        (
            1.0 / 6.0 - angle2 / 120.0,
            1.0 / 24.0 - angle2 / 720.0,
            1.0 / 120.0 - angle2 / 2520.0,
        )
    } else {
        let (sin, cos) = angle.sin_cos();
        (
            (angle - sin) / angle.powi(3),
            (angle * angle + 2.0 * cos - 2.0) / (2.0 * angle.powi(4)),
            (2.0 * angle - 3.0 * sin + angle * cos) / (2.0 * angle.powi(5)),
        )
    };
    let (w, v) = (skew(omega), skew(v));
    0.5 * v
        + a * (w * v + v * w + w * v * w)
        + b * (w * w * v + v * w * w - 3.0 * w * v * w)
        + c * (w * v * w * w + w * w * v * w)
}

#[cfg(test)]
#[path = "tangent_tests.rs"]
mod tests;
