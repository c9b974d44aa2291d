use fgs_geom::Se3;
use nalgebra::{Matrix3x6, Vector6};
use num_dual::Dual64;

use super::*;
use crate::Covariance;
use crate::registration::LinearSystem;

type Dual3 = [Dual64; 3];

fn cross(a: &Dual3, b: &Dual3) -> Dual3 {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// `q - T exp(delta) p` and its derivative along one axis of delta at zero, from the series of the
/// exponential.
fn residual(pose: &Se3, p: &Vector3<f64>, q: &Vector3<f64>, axis: usize) -> Dual3 {
    let delta: [Dual64; 6] = std::array::from_fn(|i| {
        let zero = Dual64::from(0.0);
        if i == axis { zero.derivative() } else { zero }
    });
    let (omega, v) = (
        [delta[0], delta[1], delta[2]],
        [delta[3], delta[4], delta[5]],
    );
    let p: Dual3 = std::array::from_fn(|i| Dual64::from(p[i]));
    let turned = cross(&omega, &p);
    let (turned_twice, v_turned) = (cross(&omega, &turned), cross(&omega, &v));
    let moved: Dual3 =
        std::array::from_fn(|i| p[i] + turned[i] + v[i] + (turned_twice[i] + v_turned[i]) * 0.5);
    let rotation = pose.rotation.to_rotation_matrix().into_inner();
    std::array::from_fn(|i| {
        let rotated = (0..3)
            .map(|j| moved[j] * rotation[(i, j)])
            .fold(Dual64::from(0.0), |a, b| a + b);
        -(rotated + pose.translation[i]) + q[i]
    })
}

#[test]
fn cost_gradient_and_hessian_against_dual_numbers() {
    let pose = Se3::exp(&Vector6::new(0.7, -0.4, 1.1, 0.3, -0.2, 0.9));
    let rotation = pose.rotation.to_rotation_matrix().into_inner();
    let c_p = Covariance::disk(&Vector3::new(0.48, -0.6, 0.64), 1e-3).matrix();
    let c_q = Covariance::disk(&Vector3::new(-0.8, 0.0, 0.6), 0.02)
        .scaled(2.5)
        .matrix();
    let information = (c_q + rotation * c_p * rotation.transpose())
        .try_inverse()
        .unwrap();
    let mut system = LinearSystem::zero();
    let (mut hessian, mut gradient) = (nalgebra::Matrix6::zeros(), Vector6::zeros());
    for i in 0..5 {
        let x = f64::from(i);
        let p = Vector3::new(0.3 + x, 1.2 - 0.5 * x, 2.0 + x.sin());
        let q = pose.transform(&p) + Vector3::new(0.03, -0.01 * x, 0.02);
        let weight = 0.5 + 0.1 * x;
        let factor = Factor::new(&p, &c_p, &q, &c_q, &rotation, &pose.translation).unwrap();
        system.add(&p, &factor, weight, 0.0);

        let columns: Vec<Dual3> = (0..6).map(|axis| residual(&pose, &p, &q, axis)).collect();
        let d = Vector3::from_fn(|row, _| columns[0][row].re);
        assert!((factor.cost() - d.dot(&(information * d))).abs() <= 1e-9 * factor.cost());
        let jacobian = Matrix3x6::from_fn(|row, axis| columns[axis][row].eps);
        hessian += weight * jacobian.transpose() * information * jacobian;
        gradient += weight * jacobian.transpose() * information * d;
    }
    assert!((system.hessian() - hessian).amax() <= 1e-9 * hessian.amax());
    assert!((system.gradient - gradient).amax() <= 1e-9 * gradient.amax());
    // Every entry must be large enough for the bounds to be meaningful.
    assert!(
        gradient
            .iter()
            .all(|value| value.abs() >= 1e-3 * gradient.amax())
    );
}

#[test]
fn covariances_without_an_inverse() {
    let (p, q, zero) = (Vector3::zeros(), Vector3::x(), Matrix3::zeros());
    let new = |c: &Matrix3<f64>| Factor::new(&p, c, &q, c, &Matrix3::identity(), &p);
    assert!(new(&zero).is_none());
    assert!(new(&Matrix3::from_element(f64::NAN)).is_none());
    assert!(new(&Matrix3::identity()).is_some());
}

#[test]
fn the_residual_of_disks_is_the_distance_along_their_normal() {
    let normal = Vector3::new(0.48, -0.6, 0.64);
    for (thickness, scale) in [(1e-4, 1.0), (1e-4, 7.0), (1e-6, 0.2)] {
        let c = Covariance::disk(&normal, thickness).scaled(scale).matrix();
        let q = normal * 0.02 + normal.cross(&Vector3::x()) * 0.03;
        let (p, rotation) = (Vector3::zeros(), Matrix3::identity());
        let factor = Factor::new(&p, &c, &q, &c, &rotation, &p).unwrap();
        let residual = factor.squared_residual().sqrt();
        assert!((residual - 0.02).abs() <= 1e-4, "{residual}");
    }
}
