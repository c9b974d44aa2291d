use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::Covariance;

fn point(position: Vector3<f32>) -> Point {
    Point {
        position,
        covariance: Covariance::isotropic(),
    }
}

fn map_of(positions: &[Vector3<f32>], cell_size_m: f32) -> PointMap {
    let mut map = PointMap::new(cell_size_m);
    for (id, position) in positions.iter().enumerate() {
        assert!(map.insert(id as u64, point(*position)));
    }
    map
}

fn uniform(rng: &mut Pcg64Mcg, half_side: f32) -> Vector3<f32> {
    Vector3::from_fn(|_, _| rng.random_range(-half_side..half_side))
}

/// Clusters with duplicates, a plane, and a few isolated points.
fn clouds(rng: &mut Pcg64Mcg) -> Vec<Vec<Vector3<f32>>> {
    let mut clustered = Vec::new();
    for _ in 0..20 {
        let center = uniform(rng, 0.3);
        clustered.extend((0..20).map(|_| center + uniform(rng, 0.01)));
    }
    clustered.extend_from_within(0..50);
    let coplanar =
        (0..400).map(|i| Vector3::new((i % 20) as f32 * 0.01, (i / 20) as f32 * 0.01, 0.05));
    let coplanar = coplanar.collect();
    let sparse = (0..100).map(|_| uniform(rng, 0.5)).collect();
    vec![
        clustered,
        coplanar,
        sparse,
        vec![Vector3::new(0.1, -0.2, 0.3)],
        vec![],
    ]
}

/// Squared distances and ids by brute force, nearest first.
fn brute_force(positions: &[Vector3<f32>], query: &Vector3<f32>, max: f32) -> Vec<(f32, u64)> {
    let mut all: Vec<(f32, u64)> = positions
        .iter()
        .enumerate()
        .map(|(id, position)| ((position - query).norm_squared(), id as u64))
        .filter(|(squared, _)| *squared <= max * max)
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    all
}

#[test]
fn neighbors_are_those_of_brute_force() {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    for positions in clouds(&mut rng) {
        for cell_size_m in [0.003, 0.02, 0.03, 10.0] {
            let map = map_of(&positions, cell_size_m);
            let mut queries: Vec<_> = (0..300).map(|_| uniform(&mut rng, 0.35)).collect();
            queries.extend(positions.iter().step_by(7));
            // Halfway between grid points, to produce ties.
            queries.extend((0..20).map(|i| Vector3::new(i as f32 * 0.005, 0.005, 0.05)));
            for query in &queries {
                for max in [0.0, 0.01, 0.03, 0.3, f32::INFINITY] {
                    let expected = brute_force(&positions, query, max);
                    let found = map.nearest(query, max).map(|n| (n.squared_distance, n.id));
                    assert_eq!(found, expected.first().copied(), "{query} within {max}");
                    let found: Vec<_> = map.k_nearest(query, 5, max);
                    let found: Vec<_> = found.iter().map(|n| (n.squared_distance, n.id)).collect();
                    assert_eq!(found, expected[..expected.len().min(5)]);
                }
            }
        }
    }
}

/// Points are inserted in order of decreasing id: once all at the same place, and once at equal
/// distances on all sides, in several cells.
#[test]
fn of_equally_near_points_the_smallest_id_is_found() {
    for radius in [0.0, 0.015625] {
        let mut map = PointMap::new(0.02);
        for id in (0..24).rev() {
            let mut position = Vector3::zeros();
            position[id % 3] = if id % 2 == 0 { radius } else { -radius };
            map.insert(id as u64, point(position));
        }
        map.remove(0);
        let query = Vector3::zeros();
        assert_eq!(map.nearest(&query, 0.03).unwrap().id, 1);
        let lasting = map.lasting_nearest(&query, 0.03, 0.01);
        assert_eq!(map.slots[lasting.slot.unwrap() as usize].0, 1);
        assert!(!lasting.holds_at(&query));
    }
}

#[test]
fn a_lasting_neighbor_lasts() {
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let max = 0.03;
    let (mut lasted, mut changed) = (0, 0);
    for positions in clouds(&mut rng) {
        let map = map_of(&positions, 0.03);
        for _ in 0..2000 {
            let query = uniform(&mut rng, 0.2);
            let lasting = map.lasting_nearest(&query, max, 0.01);
            let kept = lasting.slot.map(|slot| map.slots[slot as usize].0);
            // Move just less than the radius: in a random direction, away from the nearest point,
            // and towards each of the neighbours.
            let neighbors = map.k_nearest(&query, 8, 0.1);
            let mut directions = vec![uniform(&mut rng, 1.0)];
            if let Some(nearest) = neighbors.first() {
                directions.push(query - nearest.point.position);
                directions.extend(neighbors.iter().map(|n| n.point.position - query));
            }
            for direction in directions {
                let unit = direction.normalize();
                let inside = query + unit * (0.99 * lasting.radius_m.max(0.0));
                if lasting.holds_at(&inside) {
                    assert_eq!(kept, map.nearest(&inside, max).map(|n| n.id));
                    lasted += 1;
                }
                let outside = query + unit * 0.008;
                if !lasting.holds_at(&outside) {
                    changed += usize::from(kept != map.nearest(&outside, max).map(|n| n.id));
                }
            }
        }
    }
    // Both cases must occur often enough for the test to be meaningful.
    assert!(lasted > 1000 && changed > 100, "{lasted} {changed}");
}

#[test]
fn removing_and_replacing() {
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let mut positions: Vec<_> = (0..500).map(|_| uniform(&mut rng, 0.1)).collect();
    let mut map = map_of(&positions, 0.03);
    for id in (0..500).step_by(3) {
        let removed = map.remove(id).unwrap();
        assert_eq!(removed.position, positions[id as usize]);
        assert!(map.remove(id).is_none());
        // Out of reach of every query.
        positions[id as usize] = Vector3::repeat(1e6);
    }
    for id in (1..500).step_by(3) {
        positions[id] = uniform(&mut rng, 0.1);
        assert!(map.insert(id as u64, point(positions[id])));
    }
    for id in (0..500).step_by(6) {
        positions[id] = uniform(&mut rng, 0.1);
        assert!(map.insert(id as u64, point(positions[id])));
    }
    assert_eq!(map.len(), 500 - 83);
    for _ in 0..1000 {
        let query = uniform(&mut rng, 0.1);
        let expected = brute_force(&positions, &query, 0.05)
            .first()
            .map(|&(_, id)| id);
        assert_eq!(map.nearest(&query, 0.05).map(|n| n.id), expected);
        if let Some(id) = expected {
            assert_eq!(map.get(id).unwrap().position, positions[id as usize]);
        }
    }
    for id in 0..500 {
        map.remove(id);
    }
    assert!(map.is_empty() && map.cells.is_empty());
}

#[test]
fn absurd_numbers_are_harmless() {
    let mut map = PointMap::new(f32::NAN);
    assert!(!map.insert(7, point(Vector3::new(0.0, f32::NAN, 0.0))));
    assert!(!map.insert(7, point(Vector3::new(0.0, f32::INFINITY, 0.0))));
    assert!(map.is_empty());
    assert!(map.insert(1, point(Vector3::repeat(1e38))));
    assert!(map.insert(2, point(Vector3::repeat(-3e9))));
    assert!(map.insert(3, point(Vector3::zeros())));
    assert_eq!(map.nearest(&Vector3::repeat(-3e9), 1.0).unwrap().id, 2);
    assert_eq!(
        map.nearest(&Vector3::repeat(0.1), f32::INFINITY)
            .unwrap()
            .id,
        3
    );
    assert!(map.nearest(&Vector3::repeat(f32::NAN), 1.0).is_none());
    assert!(map.nearest(&Vector3::repeat(f32::INFINITY), 1.0).is_none());
    assert!(map.nearest(&Vector3::zeros(), f32::NAN).is_none());
}
