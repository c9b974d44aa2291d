//! Where geometry slides: before a wall a registration holds three directions of motion and not the
//! three along the wall. There its answer is chance, and the motion so far is a better guess
//! (solution remapping: Zhang, Kaess and Singh, ICRA 2016).

use fgs_geom::Se3;
use nalgebra::{Matrix6, SymmetricEigen, Vector6};

/// What a registration knows of a pose.
#[derive(Clone, Copy, Debug)]
pub struct HeldPose {
    /// The pose.
    pub pose: Se3,
    /// Inverse covariance under perturbations from the right, `[omega, v]`; none in the directions
    /// that are not held.
    pub information: Matrix6<f64>,
}

/// Takes the directions that a registration holds less than `min_share` of the strongest from the
/// predicted pose. Rotations are measured as arcs at the distance at which the points lie.
pub fn remap(
    registered: &Se3,
    information: &Matrix6<f64>,
    predicted: &Se3,
    min_share: f64,
) -> HeldPose {
    let trace = |first: usize| information.fixed_view::<3, 3>(first, first).trace();
    let arc = (trace(3) / trace(0)).sqrt();
    let scale = Matrix6::from_diagonal(&Vector6::new(arc, arc, arc, 1.0, 1.0, 1.0));
    let eigen = SymmetricEigen::new(scale * information * scale);
    let strongest = eigen.eigenvalues.max();
    if !(arc.is_finite() && arc > 0.0 && strongest.is_finite()) {
        return HeldPose {
            pose: *registered,
            information: *information,
        };
    }
    let to_predicted = (registered.inverse() * *predicted).log();
    let mut step = Vector6::zeros();
    let mut information = *information;
    for (value, direction) in eigen
        .eigenvalues
        .iter()
        .zip(eigen.eigenvectors.column_iter())
    {
        if *value < min_share * strongest {
            // In the tangent: along the scaled direction, measured across it.
            let (along, across) = (
                scale * direction,
                direction.component_div(&scale.diagonal()),
            );
            step += along * across.dot(&to_predicted);
            information -= *value * across * across.transpose();
        }
    }
    HeldPose {
        pose: (*registered * Se3::exp(&step)).renormalized(),
        information,
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    /// Of points seen through normals with a noise of 1 along them and 1000 times as much across.
    fn information(normals: &[Vector3<f64>]) -> Matrix6<f64> {
        let mut total = Matrix6::zeros();
        for i in -5..=5 {
            for j in -5..=5 {
                for normal in normals {
                    let point = Vector3::new(0.2 * f64::from(i), 0.2 * f64::from(j), 2.0);
                    for (axis, weight) in
                        [(*normal, 1.0), (Vector3::x(), 1e-3), (Vector3::y(), 1e-3)]
                    {
                        let by_turn = point.cross(&axis);
                        let row =
                            Vector6::new(by_turn.x, by_turn.y, by_turn.z, axis.x, axis.y, axis.z);
                        total += weight * row * row.transpose();
                    }
                }
            }
        }
        total
    }

    #[test]
    fn a_wall_holds_its_distance_and_the_prediction_the_rest() {
        let registered = Se3::exp(&Vector6::new(0.01, -0.02, 0.005, 0.03, 0.02, -0.01));
        let motion = Vector6::new(0.0, 0.0, 0.01, 0.05, -0.04, 0.0);
        let predicted = registered * Se3::exp(&motion);
        let held = remap(&registered, &information(&[Vector3::z()]), &predicted, 0.01);
        assert!((predicted.inverse() * held.pose).log().amax() <= 2e-3);
        assert!(held.information[(5, 5)] >= 100.0 && held.information[(3, 3)].abs() <= 1.0);
        // Towards the wall the registration is believed.
        let nearer = registered * Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.05));
        let held = remap(&registered, &information(&[Vector3::z()]), &nearer, 0.01);
        assert!((registered.inverse() * held.pose).log().amax() <= 2e-3);
    }

    #[test]
    fn a_corner_holds_everything() {
        let normals = [Vector3::z(), Vector3::x(), Vector3::y()];
        let (registered, information) = (Se3::identity(), information(&normals));
        let predicted = Se3::exp(&Vector6::repeat(0.05));
        let held = remap(&registered, &information, &predicted, 0.01);
        assert_eq!(held.pose, registered);
        assert_eq!(held.information, information);
    }

    #[test]
    fn no_information_changes_nothing() {
        let predicted = Se3::exp(&Vector6::repeat(0.05));
        let held = remap(&Se3::identity(), &Matrix6::zeros(), &predicted, 0.01);
        assert_eq!(held.pose, Se3::identity());
    }
}
