use std::f64::consts::PI;

use num_dual::Dual64;

use super::*;

type Matrix = [[Dual64; 4]; 4];

fn product(p: &Matrix, q: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| p[i][k] * q[k][j]).sum()))
}

fn constant(pose: &Se3) -> Matrix {
    let matrix = pose.matrix();
    std::array::from_fn(|i| std::array::from_fn(|j| Dual64::from(matrix[(i, j)])))
}

/// exp of the 4x4 twist matrix by scaling and squaring of its Taylor series.
fn exp(tangent: [Dual64; 6]) -> Matrix {
    let zero = Dual64::from(0.0);
    let [x, y, z, a, b, c] = tangent.map(|value| value * 2f64.powi(-8));
    let twist = [
        [zero, -z, y, a],
        [z, zero, -x, b],
        [-y, x, zero, c],
        [zero; 4],
    ];
    let mut sum = constant(&Se3::identity());
    let mut term = sum;
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

/// `(value, derivative)` as one dual vector.
fn dual(value: &Vector6<f64>, derivative: &Vector6<f64>) -> [Dual64; 6] {
    std::array::from_fn(|i| Dual64::new(value[i], derivative[i]))
}

/// The residual is defined by `exp(r) = Z^-1 A^-1 B`; both sides are differentiated by dual numbers.
#[test]
fn jacobians_are_those_of_dual_numbers() {
    let axes = [
        Vector3::new(1.0, 0.0, 0.0),
        Vector3::new(0.0, 0.0, 1.0),
        Vector3::new(0.6, -0.48, 0.64),
    ];
    let angles = [
        0.0,
        1e-9,
        1e-4,
        0.01,
        0.0999,
        0.1001,
        0.5,
        2.0,
        3.1,
        PI - 1e-3,
        PI - 1e-6,
    ];
    let from = Se3::exp(&Vector6::new(0.9, -0.4, 2.3, 0.5, -1.0, 2.0));
    let measured = Se3::exp(&Vector6::new(-0.2, 1.1, 0.3, 1.5, 0.7, -0.4));
    let zero = Vector6::zeros();
    for axis in axes {
        for angle in angles {
            let omega = axis * angle;
            let r = Vector6::new(omega.x, omega.y, omega.z, 0.7, -1.3, 2.1);
            let to = from * measured * Se3::exp(&r);
            let linearized = linearize(&measured, &from, &to);
            assert!((linearized.residual - r).amax() <= 1e-9, "{r}");
            for k in 0..6 {
                let unit = Vector6::ith(k, 1.0);
                let from_inverse = constant(&from.inverse());
                let relative = |a: &Vector6<f64>, b: &Vector6<f64>| {
                    let left = product(&exp(dual(&zero, &-a)), &from_inverse);
                    let right = product(&constant(&to), &exp(dual(&zero, b)));
                    product(&constant(&measured.inverse()), &product(&left, &right))
                };
                for (expected, column) in [
                    (relative(&unit, &zero), linearized.d_from.column(k)),
                    (relative(&zero, &unit), linearized.d_to.column(k)),
                ] {
                    let actual = exp(dual(&linearized.residual, &column.into_owned()));
                    for i in 0..4 {
                        for j in 0..4 {
                            let error = (actual[i][j].eps - expected[i][j].eps).abs();
                            assert!(error <= 1e-9, "{r} {k} {error}");
                        }
                    }
                }
            }
        }
    }
}
