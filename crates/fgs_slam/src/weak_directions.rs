//! Where geometry slides: before a wall a registration holds three directions of motion and not the
//! three along the wall. There its answer is chance, and the motion so far is a better guess
//! (solution remapping: Zhang, Kaess and Singh, ICRA 2016; here each direction by what holds it instead
//! of by a threshold).

use fgs_geom::{Se3, skew};
use fgs_gicp::{Alignment, Point, PointMap};
use nalgebra::{Matrix3, Matrix6, Vector3};
use rayon::prelude::*;

/// What is left of the noise, relative to what the same points would hold if each were known along all axes as
/// well as along its normal: multiples of the disks' thickness.
const SLACK: f64 = 2.0;

/// Every so many points are looked at: thousands are left, which is enough for sums over them.
const STEP: usize = 4;

/// Points per parallel task. Fixed, so that the order of summation does not depend on the number of threads.
const CHUNK_POINTS: usize = 1024;

/// What the points hold of a registration with a target: its information (`sensor_noise_m` as in
/// [`Alignment::information`]) without what it only seems to hold.
///
/// A registration gains information along the normals of both disks of a pair, and those are noisy: the sum of
/// `n n^T` over a wall has something in every direction. The noise of the two normals is independent, so that it
/// vanishes from the sum of `n_source n_target^T`. `thickness` is that of all disks
/// ([`SurfacePoint::disk`](fgs_gicp::SurfacePoint::disk)); pairs are at most `max_distance_m` apart.
pub fn held_information(
    alignment: &Alignment,
    source: &[Point],
    target: &PointMap,
    thickness: f64,
    max_distance_m: f64,
    sensor_noise_m: f64,
) -> Matrix6<f64> {
    let pose = &alignment.target_from_source;
    let rotation = pose.rotation.to_rotation_matrix().into_inner();
    let held_by = |point: &Point| {
        let p = point.position.cast::<f64>();
        let found = target.nearest(&pose.transform(&p).cast(), max_distance_m as f32)?;
        let there = rotation.transpose() * found.point.covariance.matrix() * rotation;
        let (here, own_variance) = normal_projection(&point.covariance.matrix(), thickness);
        let (there, other_variance) = normal_projection(&there, thickness);
        let along = here * there / (own_variance + other_variance);
        Some(by_motion(&p, &(0.5 * (along + along.transpose()))))
    };
    let sampled: Vec<&Point> = source.iter().step_by(STEP).collect();
    let chunks = sampled.par_chunks(CHUNK_POINTS);
    let sums: Vec<Matrix6<f64>> = chunks
        .map(|points| points.iter().filter_map(|point| held_by(point)).sum())
        .collect();
    let sum: Matrix6<f64> = sums.iter().sum();
    // As much as the registration knows, along other directions.
    let claimed = alignment.information(sensor_noise_m);
    let of_position = |information: &Matrix6<f64>| information.fixed_view::<3, 3>(3, 3).trace();
    let sum = sum * (of_position(&claimed) / of_position(&sum));
    if !sum.iter().all(|value| value.is_finite()) {
        // No pairs, or disks as thick as wide, which have no normals.
        return claimed;
    }
    let per_point = of_position(&claimed) / source.len().max(1) as f64;
    // In coordinates in which points that are known alike in all directions give the identity.
    let Some(lower) = isotropic(source, per_point).cholesky().map(|c| c.l()) else {
        return claimed;
    };
    let Some(by_lower) = lower.try_inverse() else {
        return claimed;
    };
    let eigen = (by_lower * sum * by_lower.transpose()).symmetric_eigen();
    let known = (eigen.eigenvalues).map(|share| (share - SLACK * thickness).max(0.0));
    let held = eigen.eigenvectors * Matrix6::from_diagonal(&known) * eigen.eigenvectors.transpose();
    lower * held * lower.transpose()
}

/// `n n^T` of a disk's normal, and the variance along it: a disk's covariance is `s (I - (1 - t) n n^T)`.
fn normal_projection(covariance: &Matrix3<f64>, thickness: f64) -> (Matrix3<f64>, f64) {
    let scale = covariance.trace() / (2.0 + thickness);
    let projection = (Matrix3::identity() - covariance / scale) / (1.0 - thickness);
    (projection, scale * thickness)
}

/// The information on a motion `[omega, v]` from that on the position of a point at `p`: `J^T M J`, `J =
/// [skew(p), -I]`.
fn by_motion(p: &Vector3<f64>, of_point: &Matrix3<f64>) -> Matrix6<f64> {
    let turn: Matrix3<f64> = skew(p);
    let mixed = -turn.transpose() * of_point;
    let mut information = Matrix6::zeros();
    (information.fixed_view_mut::<3, 3>(0, 0)).copy_from(&(turn.transpose() * of_point * turn));
    (information.fixed_view_mut::<3, 3>(0, 3)).copy_from(&mixed);
    (information.fixed_view_mut::<3, 3>(3, 0)).copy_from(&mixed.transpose());
    (information.fixed_view_mut::<3, 3>(3, 3)).copy_from(of_point);
    information
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
    use fgs_gicp::{Covariance, Settings, align};
    use nalgebra::Vector6;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const THICKNESS: f64 = 1e-3;
    const NOISE_M: f64 = 1e-4;
    const MAX_DISTANCE_M: f64 = 0.05;

    /// Disks on planes through (0, 0, 2), 2 cm apart, their normals off by 2 degrees.
    fn disks(normals: &[Vector3<f64>], seed: u64) -> Vec<Point> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
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

    /// Disks on some planes, registered from where a prediction is wrong with others there, whose noise is
    /// another; and what they hold.
    fn registered(normals: &[Vector3<f64>], predicted: &Se3) -> (Alignment, Matrix6<f64>) {
        let mut target = PointMap::new(0.2);
        for (id, disk) in disks(normals, 7).iter().enumerate() {
            target.insert(id as u64, *disk);
        }
        let settings = Settings {
            max_correspondence_distance_m: MAX_DISTANCE_M as f32,
            ..Settings::default()
        };
        let source = disks(normals, 8);
        let alignment = align(&source, &target, predicted, &settings).unwrap();
        let held = held_information(
            &alignment,
            &source,
            &target,
            THICKNESS,
            MAX_DISTANCE_M,
            NOISE_M,
        );
        (alignment, held)
    }

    #[test]
    fn a_wall_holds_its_distance_and_the_prediction_the_rest() {
        // Turned about the axis through the wall and moved along it; and 1 cm too near.
        let predicted = Se3::exp(&Vector6::new(0.0, 0.0, 0.002, 0.006, -0.004, 0.01));
        let (alignment, held) = registered(&[Vector3::z()], &predicted);
        let claimed = alignment.information(NOISE_M);
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
        let normals = [Vector3::z(), Vector3::x(), Vector3::y()];
        let (alignment, held) = registered(&normals, &Se3::exp(&Vector6::repeat(0.004)));
        let claimed = alignment.information(NOISE_M);
        assert!((held - claimed).norm() <= 0.05 * claimed.norm());
    }

    #[test]
    fn disks_without_normals_or_pairs_leave_the_claim() {
        let (alignment, _) = registered(&[Vector3::z()], &Se3::identity());
        let claimed = alignment.information(NOISE_M);
        let disks = disks(&[Vector3::z()], 7);
        let held = |thickness| {
            let nothing = PointMap::new(0.2);
            held_information(
                &alignment,
                &disks,
                &nothing,
                thickness,
                MAX_DISTANCE_M,
                NOISE_M,
            )
        };
        assert!(held(THICKNESS) == claimed && held(1.0) == claimed);
    }

    #[test]
    fn without_knowledge_the_pose_stays() {
        let predicted = Se3::exp(&Vector6::repeat(0.004));
        let nothing = Matrix6::zeros();
        let fused = fused_pose(&Se3::identity(), &predicted, [&nothing, &nothing]);
        assert_eq!(fused, Se3::identity());
    }
}
