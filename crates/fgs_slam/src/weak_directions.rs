//! Where geometry slides: before a wall a registration holds three directions of motion and not the
//! three along the wall. There its answer is chance, and the motion so far is a better guess
//! (solution remapping: Zhang, Kaess and Singh, ICRA 2016; here each direction by its share instead
//! of by a threshold).

use fgs_geom::{Se3, skew};
use fgs_gicp::{Alignment, Point};
use nalgebra::{Matrix3, Matrix6, SymmetricEigen, Vector3};

/// What a registration seems to hold in a direction that it does not, relative to what the same points
/// would hold if each were known along all axes as well as along its normal: multiples of the disks'
/// thickness. One for their finite width, the rest for normals that are a few degrees off.
const SLACK: f64 = 4.0;

/// What the points hold of a registration: its information (`sensor_noise_m` as in
/// [`Alignment::information`]) without what it only seems to hold. `thickness` is that of the points'
/// disks ([`SurfacePoint::disk`](fgs_gicp::SurfacePoint::disk)).
pub fn held_information(
    alignment: &Alignment,
    source: &[Point],
    thickness: f64,
    sensor_noise_m: f64,
) -> Matrix6<f64> {
    let claimed = alignment.information(sensor_noise_m);
    let per_point = claimed.fixed_view::<3, 3>(3, 3).trace() / source.len().max(1) as f64;
    // In coordinates in which the isotropic information is the identity.
    let Some(lower) = isotropic(source, per_point).cholesky().map(|c| c.l()) else {
        return claimed;
    };
    let Some(by_lower) = lower.try_inverse() else {
        return claimed;
    };
    let eigen = SymmetricEigen::new(by_lower * claimed * by_lower.transpose());
    let shares = eigen.eigenvalues.iter();
    let held: Matrix6<f64> = shares
        .zip(eigen.eigenvectors.column_iter())
        .map(|(share, direction)| {
            let known = (share - SLACK * thickness).max(0.0);
            known * direction * direction.transpose()
        })
        .sum();
    lower * held * lower.transpose()
}

/// The mean of two estimates of a pose, each weighted by its information under perturbations from the
/// right, `[omega, v]`; the first if neither knows anything.
pub fn fused_pose(first: &Se3, second: &Se3, information: [&Matrix6<f64>; 2]) -> Se3 {
    let to_second = (first.inverse() * *second).log();
    let total = information[0] + information[1];
    match total.cholesky() {
        Some(total) => {
            let step = total.solve(&(information[1] * to_second));
            (*first * Se3::exp(&step)).renormalized()
        }
        None => *first,
    }
}

/// The information of points that are each known alike in all directions: the sum of `J^T J`, `J =
/// [skew(p), -I]`.
fn isotropic(points: &[Point], per_point: f64) -> Matrix6<f64> {
    let n = points.len() as f64;
    let (mut sum, mut squares) = (Vector3::zeros(), Matrix3::zeros());
    for point in points {
        let p = point.position.cast::<f64>();
        sum += p;
        squares += Matrix3::identity() * p.norm_squared() - p * p.transpose();
    }
    let mut information = Matrix6::zeros();
    let mixed: Matrix3<f64> = skew(&sum);
    information.fixed_view_mut::<3, 3>(0, 0).copy_from(&squares);
    information.fixed_view_mut::<3, 3>(0, 3).copy_from(&mixed);
    information
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&mixed.transpose());
    information
        .fixed_view_mut::<3, 3>(3, 3)
        .copy_from(&(Matrix3::identity() * n));
    information * per_point
}

#[cfg(test)]
mod tests {
    use fgs_gicp::{Covariance, PointMap, Settings, align};
    use nalgebra::Vector6;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const THICKNESS: f64 = 1e-3;
    const NOISE_M: f64 = 1e-4;

    /// Disks on planes through (0, 0, 2), 2 cm apart, their normals off by 2 degrees.
    fn disks(normals: &[Vector3<f64>]) -> Vec<Point> {
        let mut rng = Pcg64Mcg::seed_from_u64(7);
        let mut disks = Vec::new();
        for normal in normals {
            let along = normal.cross(&Vector3::new(0.3, 0.5, 0.8)).normalize();
            let across = normal.cross(&along);
            for i in -20..20 {
                for j in -20..20 {
                    let position = 0.02 * (f64::from(i) * along + f64::from(j) * across);
                    let tilt = Vector3::from_fn(|_, _| rng.random_range(-0.05..0.05));
                    disks.push(Point {
                        position: (position + Vector3::new(0.0, 0.0, 2.0)).cast(),
                        covariance: Covariance::disk(&(normal + tilt).normalize(), THICKNESS),
                    });
                }
            }
        }
        disks
    }

    /// Disks registered with themselves from where a prediction is wrong.
    fn registered(disks: &[Point], predicted: &Se3) -> Alignment {
        let mut target = PointMap::new(0.2);
        for (id, disk) in disks.iter().enumerate() {
            target.insert(id as u64, *disk);
        }
        let settings = Settings {
            max_correspondence_distance_m: 0.05,
            ..Settings::default()
        };
        align(disks, &target, predicted, &settings).unwrap()
    }

    #[test]
    fn a_wall_holds_its_distance_and_the_prediction_the_rest() {
        // Turned about the axis through the wall and moved along it; and 1 cm too near.
        let predicted = Se3::exp(&Vector6::new(0.0, 0.0, 0.002, 0.006, -0.004, 0.01));
        let disks = disks(&[Vector3::z()]);
        let alignment = registered(&disks, &predicted);
        let claimed = alignment.information(NOISE_M);
        let held = held_information(&alignment, &disks, THICKNESS, NOISE_M);
        assert!(held[(3, 3)] <= 0.2 * claimed[(3, 3)]);
        assert!(held[(5, 5)] >= 0.9 * claimed[(5, 5)]);
        let guess = Matrix6::identity() * (0.01 * held[(5, 5)]);
        let registered = alignment.target_from_source;
        let fused = fused_pose(&registered, &predicted, [&held, &guess]);
        let from_predicted = (predicted.inverse() * fused).log();
        for along in [2, 3, 4] {
            assert!(from_predicted[along].abs() <= 1e-3, "{from_predicted}");
        }
        assert!(fused.translation.z.abs() <= 2e-4, "{}", fused.translation);
        // Geometry's own answer is elsewhere.
        let registered = (predicted.inverse() * registered).log();
        assert!(registered.fixed_rows::<2>(3).norm() >= 3e-3, "{registered}");
    }

    #[test]
    fn a_corner_holds_everything() {
        let disks = disks(&[Vector3::z(), Vector3::x(), Vector3::y()]);
        let alignment = registered(&disks, &Se3::exp(&Vector6::repeat(0.004)));
        let claimed = alignment.information(NOISE_M);
        let held = held_information(&alignment, &disks, THICKNESS, NOISE_M);
        assert!((held - claimed).norm() <= 0.05 * claimed.norm());
    }

    #[test]
    fn without_points_the_claim_stands_and_without_knowledge_the_pose() {
        let predicted = Se3::exp(&Vector6::repeat(0.004));
        let alignment = registered(&disks(&[Vector3::z()]), &predicted);
        let held = held_information(&alignment, &[], THICKNESS, NOISE_M);
        assert_eq!(held, alignment.information(NOISE_M));
        let nothing = Matrix6::zeros();
        let fused = fused_pose(&Se3::identity(), &predicted, [&nothing, &nothing]);
        assert_eq!(fused, Se3::identity());
    }
}
