//! An edge's residual and its Jacobians.
//!
//! `r = log(Z^-1 A^-1 B)` with the measurement Z and the poses A and B. For right perturbations
//! `A exp(a)`, `B exp(b)`: `dr/db = Jr^-1(r)` and `dr/da = -Jr^-1(r) Ad(B^-1 A)`, Jr being the
//! right Jacobian of SE(3) (Sola et al. 2018, "A micro Lie theory", Sec. II-G).

use fgs_geom::{Se3, skew};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// Below this angle (rad) the closed forms lose digits to cancellation, and their series, cut
/// after four terms, is exact to rounding.
const SMALL_ANGLE: f64 = 0.1;

/// A residual and its derivatives by the two poses.
pub struct Linearized {
    /// `[omega, v]`, rad and metres.
    pub residual: Vector6<f64>,
    pub d_from: Matrix6<f64>,
    pub d_to: Matrix6<f64>,
}

/// `log(from_from_to^-1 * world_from_from^-1 * world_from_to)`.
pub fn residual(from_from_to: &Se3, world_from_from: &Se3, world_from_to: &Se3) -> Vector6<f64> {
    (from_from_to.inverse() * (world_from_from.inverse() * *world_from_to)).log()
}

/// The residual with its Jacobians.
pub fn linearize(from_from_to: &Se3, world_from_from: &Se3, world_from_to: &Se3) -> Linearized {
    let residual = residual(from_from_to, world_from_from, world_from_to);
    let d_to = inverse_right_jacobian(&residual);
    let to_from_from = world_from_to.inverse() * *world_from_from;
    Linearized {
        residual,
        d_from: -d_to * adjoint(&to_from_from),
        d_to,
    }
}

/// `Ad(T)`: `T exp(x) T^-1 = exp(Ad(T) x)`.
fn adjoint(transform: &Se3) -> Matrix6<f64> {
    let rotation = transform.rotation.to_rotation_matrix().into_inner();
    blocks(&rotation, &(skew(&transform.translation) * rotation))
}

/// `[[diagonal, 0], [corner, diagonal]]`.
fn blocks(diagonal: &Matrix3<f64>, corner: &Matrix3<f64>) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(diagonal);
    matrix.fixed_view_mut::<3, 3>(3, 0).copy_from(corner);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(diagonal);
    matrix
}

/// `Jr^-1(x) = I + ad/2 + a ad^2 + b ad^4`: the series `sum B_k (-ad)^k / k!` of Bernoulli numbers,
/// folded by `ad^5 = -2 t^2 ad^3 - t^4 ad`, where t is the angle.
fn inverse_right_jacobian(tangent: &Vector6<f64>) -> Matrix6<f64> {
    let omega: Vector3<f64> = tangent.fixed_rows::<3>(0).into_owned();
    let v: Vector3<f64> = tangent.fixed_rows::<3>(3).into_owned();
    let ad = blocks(&skew(&omega), &skew(&v));
    let ad2 = ad * ad;
    let t2 = omega.norm_squared();
    let t = t2.sqrt();
    let (a, b) = if t < SMALL_ANGLE {
        let t4 = t2 * t2;
        (
            1.0 / 12.0 - t4 / 30240.0 - t4 * t2 / 604_800.0,
            -1.0 / 720.0 - t2 / 15120.0 - t4 / 403_200.0 - t4 * t2 / 11_975_040.0,
        )
    } else {
        let (sin, cos) = t.sin_cos();
        let versine4 = 4.0 * (1.0 - cos);
        (
            2.0 / t2 - (t + 3.0 * sin) / (t * versine4),
            1.0 / (t2 * t2) - (t + sin) / (t * t2 * versine4),
        )
    };
    Matrix6::identity() + 0.5 * ad + a * ad2 + b * ad2 * ad2
}

#[cfg(test)]
#[path = "residual_tests.rs"]
mod tests;
