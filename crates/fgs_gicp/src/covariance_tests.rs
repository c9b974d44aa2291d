use nalgebra::UnitQuaternion;

use super::*;

fn axes() -> Matrix3<f64> {
    UnitQuaternion::from_euler_angles(0.4, -0.7, 1.1)
        .to_rotation_matrix()
        .into_inner()
}

fn with_eigenvalues(values: [f64; 3]) -> Matrix3<f64> {
    axes() * Matrix3::from_diagonal(&values.into()) * axes().transpose()
}

#[test]
fn regularised_shapes() {
    for (given, expected) in [
        ([4e-4, 1e-4, 1e-5], [4.0, 1.0, 0.1]),
        ([2e6, 1e6, 0.0], [2.0, 1.0, 1e-3]),
        ([1e-12, 1e-12, 1e-12], [1.0, 1.0, 1.0]),
    ] {
        let covariance = Covariance::regularized(&with_eigenvalues(given)).unwrap();
        let error = (covariance.matrix() - with_eigenvalues(expected)).amax();
        assert!(error <= 1e-6, "{given:?} {error}");
    }
}

#[test]
fn what_is_no_surface() {
    for given in [
        [1.0, 0.0, 0.0],
        [0.0; 3],
        [f64::NAN, 1.0, 1.0],
        [f64::INFINITY, 1.0, 1.0],
    ] {
        assert_eq!(Covariance::regularized(&with_eigenvalues(given)), None);
    }
}

#[test]
fn a_disk_is_thin_along_its_normal_in_any_axes() {
    let normal = axes().column(1).into_owned();
    let disk = Covariance::disk(&normal, 1e-3);
    let error = (disk.matrix() - with_eigenvalues([1.0, 1e-3, 1.0])).amax();
    assert!(error <= 1e-6, "{error}");
    let turned = disk.rotated(&axes().transpose());
    let error = (turned.matrix() - Matrix3::from_diagonal(&[1.0, 1e-3, 1.0].into())).amax();
    assert!(error <= 1e-6, "{error}");
    assert!((disk.scaled(3.0).matrix() - disk.matrix() * 3.0).amax() <= 1e-6);
}
