//! Alignment of an estimated trajectory's positions with the reference's, without scale.

use fgs_geom::{Se3, rigid_alignment};
use nalgebra::Vector3;

/// The transform `reference_from_estimated` that minimises the sum of squared distances between
/// `reference[i]` and the transformed `estimated[i]`. The lists must have equal length and hold
/// finite values.
///
/// Collinear or coincident points do not determine the rotation: one of the minimisers is returned,
/// and the distances are the same for all of them.
pub fn align_positions(estimated: &[Vector3<f64>], reference: &[Vector3<f64>]) -> Se3 {
    rigid_alignment(reference, estimated).unwrap_or_else(Se3::identity)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    fn points(count: usize, axes: [f64; 3]) -> Vec<Vector3<f64>> {
        let mut random = Pcg64Mcg::seed_from_u64(2);
        (0..count)
            .map(|_| Vector3::from(axes.map(|axis| axis * random.random_range(-1.0..1.0))))
            .collect()
    }

    #[test]
    fn a_known_transform_is_found() {
        for axes in [[1.0, 2.0, 0.5], [1.0, 2.0, 0.0]] {
            for omega in [[2.9, 0.3, 0.1], [-0.2, 1.4, 0.6], [0.1, -0.4, -3.1]] {
                let [x, y, z] = omega;
                let transform = Se3::exp(&Vector6::new(x, y, z, 3.0, -20.0, 0.7));
                let estimated = points(20, axes);
                let moved: Vec<_> = estimated.iter().map(|p| transform.transform(p)).collect();
                let error = align_positions(&estimated, &moved).matrix() - transform.matrix();
                assert!(error.amax() <= 1e-12, "{error}");
            }
        }
    }

    /// Noise makes the best transform differ from the known one; no small turn or shift away from
    /// it may lower the sum of squares.
    #[test]
    fn no_neighbor_is_better() {
        let estimated = points(30, [1.0, 0.3, 2.0]);
        let noise = points(90, [0.2; 3]);
        let transform = Se3::exp(&Vector6::new(0.4, -2.0, 1.0, 1.0, 2.0, 3.0));
        let reference: Vec<_> = (estimated.iter().zip(&noise[60..]))
            .map(|(p, n)| transform.transform(p) + n)
            .collect();
        let cost = |t: Se3| -> f64 {
            let pairs = estimated.iter().zip(&reference);
            pairs
                .map(|(e, r)| (t.transform(e) - r).norm_squared())
                .sum()
        };
        let best = align_positions(&estimated, &reference);
        assert!(cost(best) < cost(transform));
        for axis in 0..6 {
            for step in [-1e-4, 1e-4] {
                let mut tangent = Vector6::zeros();
                tangent[axis] = step;
                assert!(cost(best) < cost(best * Se3::exp(&tangent)));
            }
        }
    }

    #[test]
    fn a_mirrored_copy_is_turned_not_mirrored() {
        let estimated = points(20, [1.0, 2.0, 0.5]);
        let mirrored: Vec<_> = estimated
            .iter()
            .map(|p| Vector3::new(p.x, p.y, -p.z))
            .collect();
        let aligned = align_positions(&estimated, &mirrored);
        assert!(
            (aligned.rotation.to_rotation_matrix().matrix().determinant() - 1.0).abs() <= 1e-12
        );
    }
}
