//! The rigid motion between two sets of points: least squares in closed form (Kabsch 1976).

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::Se3;

/// The motion `a_from_b` that takes the points of `b` nearest to those of `a`, pair by pair, without
/// scale: it minimises the sum of squared distances. The lists have equal length. `None` if a point is
/// not finite. It is one of several if the points lie on a line.
pub fn rigid_alignment(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> Option<Se3> {
    let center =
        |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let (center_a, center_b) = (center(a), center(b));
    let mut covariance = Matrix3::zeros();
    for (a, b) in a.iter().zip(b) {
        covariance += (a - center_a) * (b - center_b).transpose();
    }
    if !covariance.iter().all(|value| value.is_finite()) {
        return None;
    }
    let svd = covariance.svd(true, true);
    let (u, mut v_t) = (svd.u?, svd.v_t?);
    if u.determinant() * v_t.determinant() < 0.0 {
        // The nearest orthogonal matrix is a reflection: turn back what weighs least.
        let least = svd.singular_values.imin();
        v_t.row_mut(least).neg_mut();
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * v_t));
    Some(Se3::new(rotation, center_a - rotation * center_b))
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;

    use super::*;

    #[test]
    fn a_triangle_gives_the_motion() {
        let motion = Se3::exp(&Vector6::new(0.9, -1.5, 2.0, 0.3, -4.0, 1.0));
        let b = [[0.1, 0.2, 2.0], [1.0, -0.3, 1.5], [-0.4, 0.9, 3.0]].map(Vector3::from);
        let a = b.map(|point| motion.transform(&point));
        let found = rigid_alignment(&a, &b).unwrap();
        assert!((found.matrix() - motion.matrix()).amax() <= 1e-12);
    }

    #[test]
    fn the_answer_is_never_a_reflection() {
        let b = [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [0.0; 3]].map(Vector3::from);
        let a = b.map(|point| Vector3::new(-point.x, point.y, point.z));
        let found = rigid_alignment(&a, &b).unwrap();
        let matrix = found.rotation.to_rotation_matrix().into_inner();
        assert!((matrix * matrix.transpose() - Matrix3::identity()).amax() <= 1e-12);
        assert!((matrix.determinant() - 1.0).abs() <= 1e-12);
    }

    #[test]
    fn points_that_are_not_finite_give_nothing() {
        let b = [[0.1, 0.2, 2.0], [1.0, -0.3, 1.5], [-0.4, 0.9, 3.0]].map(Vector3::from);
        let mut a = b;
        a[1].y = f64::NAN;
        assert!(rigid_alignment(&a, &b).is_none());
        a[1].y = f64::INFINITY;
        assert!(rigid_alignment(&a, &b).is_none());
    }
}
