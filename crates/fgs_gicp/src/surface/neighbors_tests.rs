use super::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

#[test]
fn a_plane_gives_disks_and_a_line_nothing() {
    let normal = Vector3::new(0.48, -0.6, 0.64);
    let (a, b) = (Vector3::new(0.8, 0.0, -0.6), Vector3::new(0.36, 0.8, 0.48));
    let mut positions: Vec<Vector3<f32>> = Vec::new();
    for i in 0..400 {
        let (s, t) = (f64::from(i % 20) * 0.01, f64::from(i / 20) * 0.01);
        positions.push((a * s + b * t + Vector3::repeat(1.0)).cast());
    }
    // A line far away.
    positions.extend((0..30).map(|i| Vector3::new(5.0, 0.01 * i as f32, 0.0)));
    let mut map = PointMap::new(0.03);
    for (id, position) in positions.iter().enumerate() {
        let covariance = Covariance::isotropic();
        map.insert(
            id as u64,
            Point {
                position: *position,
                covariance,
            },
        );
    }
    let covariances = covariances_from_neighbors(&map, &positions, 9, 0.1);
    // A point in the interior of the plane, whose nine neighbours form a square.
    let center = covariances[210].unwrap();
    let error = (center.matrix() - Covariance::disk(&normal, 1e-3).matrix()).amax();
    assert!(error <= 1e-3, "{error}");
    assert!(covariances[..400].iter().all(Option::is_some));
    assert!(covariances[400..].iter().all(Option::is_none));
}

/// A cloud that is dense here and sparse there, with what cannot be used among it.
#[test]
fn disks_are_those_of_a_plain_search() {
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let mut positions: Vec<Vector3<f32>> = (0..3000)
        .map(|i| {
            let side = if i % 3 == 0 { 2.0 } else { 0.1 };
            let mut at = || side * random.random_range(-1.0..1.0_f32);
            Vector3::new(at(), at(), 0.02 * at())
        })
        .collect();
    positions[7] = Vector3::new(f32::NAN, 0.0, 0.0);
    positions[8] = Vector3::new(50.0, 0.0, 0.0);
    for max_distance_m in [0.05, 0.3, 3.0] {
        let map = map_of(&positions, max_distance_m);
        let covariances = covariances_from_neighbors(&map, &positions, 10, max_distance_m);
        let expected: Vec<Point> = (positions.iter().zip(covariances))
            .filter_map(|(&position, covariance)| {
                Some(Point {
                    position,
                    covariance: covariance?,
                })
            })
            .collect();
        assert!(expected.len() > 1500 && expected.len() <= 2998);
        assert!(points_from_neighbors(&positions, 10, max_distance_m) == expected);
    }
    assert!(points_from_neighbors(&[], 10, 0.1).is_empty());
    assert!(points_from_neighbors(&positions[7..8], 10, 0.1).is_empty());
}
