//! Rigid transforms and their exponential map.
//!
//! The tangent vector is `[omega, v]` (rotation first) and perturbations act from the right:
//! `T * Se3::exp(delta)`.

use std::ops::Mul;

use nalgebra::{
    Matrix3, Matrix4, Matrix6, Quaternion, Rotation3, UnitQuaternion, Vector3, Vector6,
};
use serde::{Deserialize, Serialize};

/// Below this angle (rad) the closed forms lose digits to cancellation and their Taylor series,
/// cut after the second term, is exact to rounding.
const SMALL_ANGLE: f64 = 1e-3;

/// A rigid transform `a_from_b`: `p_a = rotation * p_b + translation`, translation in metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Se3 {
    /// Rotation part.
    pub rotation: UnitQuaternion<f64>,
    /// Translation part, metres.
    pub translation: Vector3<f64>,
}

impl Se3 {
    /// Creates a transform from its rotation and translation.
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self {
            rotation,
            translation,
        }
    }

    /// The identity transform.
    pub fn identity() -> Self {
        Self::new(UnitQuaternion::identity(), Vector3::zeros())
    }

    /// Creates a transform from a quaternion `[w, x, y, z]`, which need not be normalised, and a
    /// translation. `None` if a value is not finite or the quaternion's norm is below 1e-9.
    pub fn from_wxyz(quat: [f64; 4], translation: [f64; 3]) -> Option<Self> {
        let quaternion = Quaternion::new(quat[0], quat[1], quat[2], quat[3]);
        let norm = quaternion.norm();
        let finite = norm.is_finite() && translation.iter().all(|t| t.is_finite());
        (finite && norm > 1e-9).then(|| {
            Self::new(
                UnitQuaternion::from_quaternion(quaternion),
                Vector3::from(translation),
            )
        })
    }

    /// Creates a transform from the upper 3x4 part of a homogeneous matrix. The 3x3 part is
    /// projected onto the nearest rotation; `None` if any of its entries changes by more than 0.01,
    /// if it is a reflection, or if a value is not finite.
    pub fn from_matrix(matrix: &Matrix4<f64>) -> Option<Self> {
        if matrix.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let linear: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into_owned();
        // Larger entries are no rotation's, and the decomposition may overflow on them.
        if linear.amax() > 1.01 {
            return None;
        }
        let svd = linear.svd(true, true);
        let nearest = svd.u? * svd.v_t?;
        let is_near = (nearest - linear).iter().all(|change| change.abs() <= 0.01);
        if !is_near || nearest.determinant() < 0.0 {
            return None;
        }
        Some(Self::new(
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(nearest)),
            matrix.fixed_view::<3, 1>(0, 3).into_owned(),
        ))
    }

    /// The exponential map of `[omega, v]` (rad, metres).
    pub fn exp(tangent: &Vector6<f64>) -> Self {
        let omega: Vector3<f64> = tangent.fixed_rows::<3>(0).into_owned();
        let v: Vector3<f64> = tangent.fixed_rows::<3>(3).into_owned();
        let angle = omega.norm();
        let (b, c) = if angle < SMALL_ANGLE {
            let angle2 = angle * angle;
            (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
        } else {
            (
                (1.0 - angle.cos()) / (angle * angle),
                (angle - angle.sin()) / angle.powi(3),
            )
        };
        let omega_hat = skew(&omega);
        let left_jacobian = Matrix3::identity() + b * omega_hat + c * omega_hat * omega_hat;
        Self::new(UnitQuaternion::from_scaled_axis(omega), left_jacobian * v)
    }

    /// The inverse of [`Se3::exp`], with the rotation vector's length in `[0, pi]`.
    pub fn log(&self) -> Vector6<f64> {
        let omega = self.rotation.scaled_axis();
        let v = inverse_left_jacobian(&omega) * self.translation;
        Vector6::new(omega.x, omega.y, omega.z, v.x, v.y, v.z)
    }

    /// The inverse transform: `b_from_a` for this `a_from_b`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self::new(rotation, -(rotation * self.translation))
    }

    /// `T exp(x) = exp(Ad x) T`.
    pub fn adjoint(&self) -> Matrix6<f64> {
        let rotation = self.rotation.to_rotation_matrix().into_inner();
        let mut adjoint = Matrix6::zeros();
        adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        adjoint
            .fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&(skew(&self.translation) * rotation));
        adjoint
    }

    /// Transforms a point from `b` coordinates to `a` coordinates.
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// Interpolates along the geodesic from `self` (`t` = 0) to `other` (`t` = 1); `t` outside
    /// `[0, 1]` extrapolates.
    pub fn interpolate(&self, other: &Self, t: f64) -> Self {
        let delta = (self.inverse() * *other).log();
        *self * Self::exp(&(delta * t))
    }

    /// The homogeneous 4x4 matrix.
    pub fn matrix(&self) -> Matrix4<f64> {
        let mut matrix = self.rotation.to_homogeneous();
        matrix
            .fixed_view_mut::<3, 1>(0, 3)
            .copy_from(&self.translation);
        matrix
    }

    /// The same transform with its quaternion renormalised: rounding errors accumulate in long
    /// products of transforms.
    pub fn renormalized(&self) -> Self {
        Self::new(
            UnitQuaternion::from_quaternion(self.rotation.into_inner()),
            self.translation,
        )
    }
}

impl Mul for Se3 {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        Self::new(
            self.rotation * other.rotation,
            self.rotation * other.translation + self.translation,
        )
    }
}

/// Inverse of the left Jacobian of SO(3) at the rotation vector `omega` (rad), [3, 3].
pub fn inverse_left_jacobian(omega: &Vector3<f64>) -> Matrix3<f64> {
    let angle = omega.norm();
    let c = if angle < SMALL_ANGLE {
        1.0 / 12.0 + angle * angle / 720.0
    } else {
        let half = 0.5 * angle;
        (1.0 - half * half.cos() / half.sin()) / (angle * angle)
    };
    let omega_hat = skew(omega);
    Matrix3::identity() - 0.5 * omega_hat + c * omega_hat * omega_hat
}

/// The skew-symmetric cross-product matrix: `skew(a) * b = a x b`.
pub fn skew(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use nalgebra::{DMatrix, Vector6};
    use num_dual::Dual64;

    use super::*;

    /// exp of the 4x4 twist matrix by scaling and squaring of its Taylor series, independent of the
    /// closed form.
    fn matrix_exp(tangent: [Dual64; 6]) -> [[Dual64; 4]; 4] {
        let zero = Dual64::from(0.0);
        let [x, y, z, a, b, c] = tangent.map(|value| value * 2f64.powi(-8));
        let twist = [
            [zero, -z, y, a],
            [z, zero, -x, b],
            [-y, x, zero, c],
            [zero; 4],
        ];
        let product = |p: &[[Dual64; 4]; 4], q: &[[Dual64; 4]; 4]| {
            let mut out = [[zero; 4]; 4];
            for i in 0..4 {
                for j in 0..4 {
                    for k in 0..4 {
                        out[i][j] += p[i][k] * q[k][j];
                    }
                }
            }
            out
        };
        let mut identity = [[zero; 4]; 4];
        for (i, row) in identity.iter_mut().enumerate() {
            row[i] = Dual64::from(1.0);
        }
        let (mut sum, mut term) = (identity, identity);
        for k in 1..16 {
            term = product(&term, &twist).map(|row| row.map(|value| value / f64::from(k)));
            for i in 0..4 {
                for j in 0..4 {
                    sum[i][j] += term[i][j];
                }
            }
        }
        for _ in 0..8 {
            sum = product(&sum, &sum);
        }
        sum
    }

    fn tangents() -> Vec<Vector6<f64>> {
        let axes = [
            Vector3::new(1.0, 0.0, 0.0),
            Vector3::new(0.0, 1.0, 0.0),
            Vector3::new(0.0, 0.0, 1.0),
            Vector3::new(0.6, -0.48, 0.64),
        ];
        let angles = [0.0, 1e-9, 1e-5, 0.999e-3, 1.001e-3, 0.3, 2.0, PI - 1e-6];
        axes.iter()
            .flat_map(|axis| {
                angles.iter().map(move |angle| {
                    Vector6::new(
                        axis.x * angle,
                        axis.y * angle,
                        axis.z * angle,
                        0.7,
                        -1.3,
                        2.1,
                    )
                })
            })
            .collect()
    }

    #[test]
    fn exp_is_the_matrix_exponential() {
        for tangent in tangents() {
            let expected = matrix_exp(std::array::from_fn(|i| Dual64::from(tangent[i])));
            let actual = Se3::exp(&tangent).matrix();
            for i in 0..4 {
                for j in 0..4 {
                    assert!(
                        (actual[(i, j)] - expected[i][j].re).abs() <= 1e-11,
                        "{tangent}"
                    );
                }
            }
        }
    }

    #[test]
    fn log_inverts_exp_near_zero_and_pi() {
        for tangent in tangents() {
            let error = (Se3::exp(&tangent).log() - tangent).amax();
            assert!(error <= 1e-9, "{tangent} {error}");
        }
    }

    /// The derivative of exp along each axis, by central differences of the closed form, against
    /// dual numbers through the series.
    #[test]
    fn exp_differentiates_like_the_series() {
        for tangent in tangents() {
            for axis in 0..6 {
                let dual = matrix_exp(std::array::from_fn(|i| {
                    let value = Dual64::from(tangent[i]);
                    if i == axis { value.derivative() } else { value }
                }));
                let step = 1e-4;
                let along = |t: f64| {
                    let mut moved = tangent;
                    moved[axis] += t;
                    Se3::exp(&moved).matrix()
                };
                // Richardson's extrapolation: error O(step^4).
                let slope = (8.0 * (along(step) - along(-step))
                    - (along(2.0 * step) - along(-2.0 * step)))
                    / (12.0 * step);
                let expected = DMatrix::from_fn(4, 4, |i, j| dual[i][j].eps);
                assert!((slope - expected).amax() <= 1e-9, "{tangent} axis {axis}");
            }
        }
    }

    #[test]
    fn inverse_and_interpolation() {
        let a = Se3::exp(&Vector6::new(0.3, -0.2, 0.9, 1.0, 2.0, 3.0));
        let b = Se3::exp(&Vector6::new(-0.5, 0.1, 0.4, -1.0, 0.5, 0.2));
        assert!(((a * a.inverse()).matrix() - Matrix4::identity()).amax() <= 1e-14);
        assert!((a.interpolate(&b, 1.0).matrix() - b.matrix()).amax() <= 1e-12);
        let half = a.interpolate(&b, 0.5);
        assert!((half.interpolate(&b, 1.0).matrix() - b.matrix()).amax() <= 1e-12);
        let (first, second) = (a.inverse() * half, half.inverse() * b);
        assert!((first.matrix() - second.matrix()).amax() <= 1e-12);
    }

    #[test]
    fn matrices_that_are_no_rotation_are_refused() {
        let pose = Se3::exp(&Vector6::new(0.3, -0.2, 0.9, 1.0, 2.0, 3.0));
        let back = Se3::from_matrix(&pose.matrix());
        assert!(back.is_some_and(|back| (back.matrix() - pose.matrix()).amax() <= 1e-12));
        assert_eq!(Se3::from_matrix(&(pose.matrix() * 1.1)), None);
        assert_eq!(Se3::from_matrix(&Matrix4::from_element(f64::NAN)), None);
        // The decomposition overflowed, and what came of it was iterated on for ever.
        let mut huge = Matrix4::identity();
        huge[(1, 1)] = 1e300;
        assert_eq!(Se3::from_matrix(&huge), None);
        let mut mirrored = pose.matrix();
        mirrored.column_mut(0).neg_mut();
        assert_eq!(Se3::from_matrix(&mirrored), None);
        assert_eq!(Se3::from_wxyz([0.0; 4], [0.0; 3]), None);
        assert_eq!(Se3::from_wxyz([1.0, f64::NAN, 0.0, 0.0], [0.0; 3]), None);
    }
}
