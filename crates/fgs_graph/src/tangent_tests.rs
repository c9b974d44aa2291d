use std::f64::consts::PI;

use fgs_geom::KeyframeId;
use nalgebra::{DMatrix, Matrix4, SMatrix};
use num_dual::Dual64;

use fgs_geom::Se3;

use super::*;
use crate::{Edge, RobustKernel};

type DualPose = [[Dual64; 4]; 4];

fn identity() -> DualPose {
    constant(&Matrix4::identity())
}

fn constant(matrix: &Matrix4<f64>) -> DualPose {
    std::array::from_fn(|i| std::array::from_fn(|j| Dual64::from(matrix[(i, j)])))
}

fn product(p: &DualPose, q: &DualPose) -> DualPose {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            (0..4)
                .map(|k| p[i][k] * q[k][j])
                .fold(Dual64::from(0.0), |a, b| a + b)
        })
    })
}

/// exp of the twist's matrix by scaling and squaring of its Taylor series, with the derivative along
/// one axis: independent of every closed form.
fn exp(tangent: &Vector6<f64>, axis: usize) -> DualPose {
    let scaled: [Dual64; 6] = std::array::from_fn(|i| {
        let value = Dual64::from(tangent[i]);
        let value = if i == axis { value.derivative() } else { value };
        value * 2f64.powi(-8)
    });
    let [x, y, z, a, b, c] = scaled;
    let zero = Dual64::from(0.0);
    let twist = [
        [zero, -z, y, a],
        [z, zero, -x, b],
        [-y, x, zero, c],
        [zero; 4],
    ];
    let (mut sum, mut term) = (identity(), identity());
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

fn derivative(pose: &DualPose) -> SMatrix<f64, 16, 1> {
    SMatrix::from_fn(|i, _| pose[i / 4][i % 4].eps)
}

/// The derivative of the tangent r along which `exp(r)` moves as `moving` does, [6].
fn derivative_of_log(moving: &DualPose, r: &Vector6<f64>) -> Vector6<f64> {
    let columns: Vec<_> = (0..6).map(|axis| derivative(&exp(r, axis))).collect();
    let slopes = DMatrix::from_fn(16, 6, |i, j| columns[j][i]);
    let right = DMatrix::from_fn(16, 1, |i, _| derivative(moving)[i]);
    let solution = slopes.svd(true, true).solve(&right, 1e-14).unwrap();
    Vector6::from_fn(|i, _| solution[i])
}

/// Residuals from none to rotations just short of half a turn.
fn tangents() -> Vec<Vector6<f64>> {
    let axes = [Vector3::x(), Vector3::new(0.6, -0.48, 0.64), -Vector3::z()];
    let angles = [0.0, 1e-9, 0.999e-2, 1.001e-2, 0.3, 2.0, PI - 1e-3];
    let shift = Vector3::new(0.7, -1.3, 2.1);
    let mut tangents = Vec::new();
    for axis in axes {
        for angle in angles {
            let omega = axis * angle;
            tangents.push(Vector6::new(
                omega.x, omega.y, omega.z, shift.x, shift.y, shift.z,
            ));
        }
    }
    tangents
}

#[test]
fn edges_differentiate_like_dual_numbers_through_the_series() {
    let from = Se3::exp(&Vector6::new(0.4, -1.1, 0.7, 2.0, -0.3, 1.5));
    let measured = Se3::exp(&Vector6::new(-0.9, 0.2, 1.3, 0.5, 0.8, -1.0));
    for residual in tangents() {
        let to = from * measured * Se3::exp(&residual);
        let edge = Edge {
            from: KeyframeId(0),
            to: KeyframeId(1),
            from_from_to: measured,
            information: Matrix6::identity(),
            kernel: RobustKernel::Quadratic,
        };
        let linearized = edge.linearize(&from, &to);
        assert!(
            (linearized.residual - residual).amax() <= 1e-9,
            "{residual}"
        );
        let measured_from_world =
            constant(&(measured.inverse().matrix() * from.inverse().matrix()));
        for axis in 0..6 {
            let step = exp(&Vector6::zeros(), axis);
            let by_to = product(
                &product(&measured_from_world, &constant(&to.matrix())),
                &step,
            );
            // (from exp(x))^-1 = exp(-x) from^-1
            let back = exp(&Vector6::zeros(), axis)
                .map(|row| row.map(|value| Dual64::new(value.re, -value.eps)));
            let by_from = product(
                &product(&constant(&measured.inverse().matrix()), &back),
                &constant(&(from.inverse() * to).matrix()),
            );
            for (actual, moving) in [(linearized.by_to, by_to), (linearized.by_from, by_from)] {
                let expected = derivative_of_log(&moving, &residual);
                let error = (actual.column(axis) - expected).amax();
                // Each derivative is of the order of 1.
                assert!(error <= 1e-8, "{residual} axis {axis}: {error}");
            }
        }
    }
}
