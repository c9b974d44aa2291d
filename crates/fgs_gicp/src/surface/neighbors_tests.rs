use super::*;
use crate::Point;

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
