//! Monte Carlo test: the predicted covariance of a registration against the scatter of many.

use nalgebra::{Matrix6, SymmetricEigen, Vector6};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::{Covariance, MIN_EIGENVALUE};

const TRIALS: usize = 200;
const SOURCE_POINTS: usize = 600;
const TARGET_POINTS: usize = 3000;

/// Three squares of 1 m around a corner two metres ahead: the normal and the two axes of each.
fn squares() -> [[Vector3<f64>; 3]; 3] {
    let axes = Se3::exp(&Vector6::new(0.4, -0.3, 0.5, 0.0, 0.0, 0.0)).rotation;
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| axes * axis);
    [[x, y, z], [y, z, x], [z, x, y]]
}

/// Random points on the squares, with noise along the normal. Its standard deviation grows with the
/// square of the depth, like that of the covariances.
fn noisy_surface(points: usize, noise_m: f64, rng: &mut Pcg64Mcg) -> Vec<Point> {
    let squares = squares();
    (0..points)
        .map(|index| {
            let [normal, a, b] = squares[index % 3];
            let (s, t) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
            let exact = Vector3::new(0.0, 0.0, 2.0) + a * s + b * t;
            let growth = (0.5 * exact.z).powi(2);
            let normal_deviate: f64 = (0..12).map(|_| rng.random_range(-0.5..0.5)).sum();
            let position = exact + normal * (noise_m * growth * normal_deviate);
            let disk = Covariance::disk(&normal, MIN_EIGENVALUE).matrix();
            Point {
                position: position.cast(),
                covariance: Covariance::from_matrix(&(disk * growth.powi(2))),
            }
        })
        .collect()
}

/// Alignments of newly drawn noisy surfaces whose true poses coincide.
fn alignments(trials: usize, noise_m: f64) -> Vec<Alignment> {
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let settings = Settings {
        max_correspondence_distance_m: 0.1,
        ..Settings::default()
    };
    (0..trials)
        .map(|_| {
            let mut target = PointMap::new(0.1);
            for (id, point) in noisy_surface(TARGET_POINTS, noise_m, &mut rng)
                .iter()
                .enumerate()
            {
                target.insert(id as u64, *point);
            }
            let source = noisy_surface(SOURCE_POINTS, noise_m, &mut rng);
            align(&source, &target, &Se3::identity(), &settings).unwrap()
        })
        .collect()
}

/// Smallest and largest ratio of observed to predicted variance over all directions.
fn observed_over_predicted(alignments: &[Alignment], sensor_noise_m: f64) -> (f64, f64) {
    let mut scatter = Matrix6::zeros();
    let mut information = Matrix6::zeros();
    for alignment in alignments {
        let error = alignment.target_from_source.log();
        scatter += error * error.transpose() / alignments.len() as f64;
        information += alignment.information(sensor_noise_m) / alignments.len() as f64;
    }
    let root = information.cholesky().unwrap().l();
    let ratios = SymmetricEigen::new(root.transpose() * scatter * root).eigenvalues;
    (ratios.min(), ratios.max())
}

/// With 200 trials, sampling error alone spreads the six ratios from 0.68 to 1.38; target points
/// shared by several source points add a sixth. The target points are 32 mm apart.
#[test]
fn predicted_covariance_is_the_observed_within_a_factor_of_two() {
    for noise_m in [0.001, 0.002] {
        let (least, largest) = observed_over_predicted(&alignments(TRIALS, noise_m), 0.0);
        assert!(
            least >= 0.5 && largest <= 2.0,
            "{noise_m}: {least} {largest}"
        );
    }
}

#[test]
fn the_sensors_noise_is_a_floor() {
    let exact = alignments(1, 0.0);
    let [one, two] = [0.01, 0.02].map(|noise_m| exact[0].information(noise_m));
    assert!((one - 4.0 * two).amax() <= 1e-9 * one.amax());
    // The noise is the standard deviation of the distance along the normal, which fixes the
    // information per correspondence.
    let pairs = exact[0].inliers as f64;
    let translation = one.fixed_view::<3, 3>(3, 3).trace() / pairs;
    assert!((translation * 1e-4 - 1.0).abs() <= 1e-9);
    for none in [0.0, -1.0, f64::NAN] {
        assert!(
            exact[0]
                .information(none)
                .iter()
                .all(|value| value.is_finite())
        );
    }
}
