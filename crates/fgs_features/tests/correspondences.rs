//! Relative poses from made correspondences, most of them wrong.

#![allow(clippy::unwrap_used)]

use fgs_features::{Descriptor, Feature, Features, Match, relative_pose};
use fgs_geom::{Camera, Intrinsics, Se3};
use nalgebra::{Vector2, Vector6};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

fn camera() -> Camera {
    let intrinsics = Intrinsics {
        fx: 525.0,
        fy: 520.0,
        cx: 320.0,
        cy: 240.0,
    };
    Camera::new(640, 480, intrinsics).unwrap()
}

/// A feature of camera `a` anywhere, 1 to 4 m away.
fn anywhere(rng: &mut impl Rng) -> Feature {
    let pixel = Vector2::new(rng.random_range(0.0..639.0), rng.random_range(0.0..479.0));
    let depth_m = rng.random_range(1.0..4.0);
    Feature {
        pixel,
        scale: 1.0,
        descriptor: Descriptor([0; 4]),
        point: Some(camera().unproject(pixel.x, pixel.y, depth_m)),
    }
}

/// Two cameras' features, those of one index being one point but for `noise` in standard
/// deviations of a Kinect, and their matches, of which the first `wrong` in ten are wrong.
fn scene(
    count: usize,
    wrong: usize,
    noise: f64,
    a_from_b: &Se3,
) -> (Features, Features, Vec<Match>) {
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let mut normal = {
        let mut rng = Pcg64Mcg::seed_from_u64(6);
        move || noise * ((0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0)
    };
    let (mut a, mut b) = (Vec::new(), Vec::new());
    while a.len() < count {
        let feature = anywhere(&mut rng);
        let mut point = a_from_b.inverse().transform(&feature.point.unwrap());
        let Some(pixel) = camera()
            .project(&point)
            .filter(|pixel| camera().contains(pixel))
        else {
            continue;
        };
        let pixel = pixel + Vector2::new(normal(), normal());
        point.z += 0.002 * point.z * point.z * normal();
        let point = Some(camera().unproject(pixel.x, pixel.y, point.z));
        b.push(if a.len() % 10 < wrong {
            anywhere(&mut rng)
        } else {
            Feature {
                pixel,
                point,
                ..feature.clone()
            }
        });
        a.push(feature);
    }
    let matches = (0..count)
        .map(|i| Match {
            a: i,
            b: i,
            distance: 0,
        })
        .collect();
    let [a, b] = [a, b].map(|all| Features {
        camera: camera(),
        all,
    });
    (a, b, matches)
}

fn motion() -> Se3 {
    Se3::exp(&Vector6::new(0.1, -0.25, 0.2, 0.3, -0.1, 0.2))
}

/// Metres and radians.
fn error(found: &Se3, truth: &Se3) -> (f64, f64) {
    let error = truth.inverse() * *found;
    (error.translation.norm(), error.rotation.angle())
}

#[test]
fn seven_in_ten_matches_are_wrong() {
    let (a, b, matches) = scene(200, 7, 1.0, &motion());
    let found = relative_pose(&a, &b, &matches, 1).unwrap();
    let (distance_m, angle) = error(&found.a_from_b, &motion());
    assert!(distance_m <= 0.01 && angle <= 0.004, "{distance_m} {angle}");
    // Noise of one standard deviation makes few of the 60 true matches outliers.
    assert!((50..=63).contains(&found.inliers), "{}", found.inliers);
    assert!((found.share - found.inliers as f64 / 200.0).abs() <= 1e-12);
    assert!(found.coverage >= 0.5, "{}", found.coverage);
    // What the information matrix claims is what happened, to a factor.
    let tangent = (motion().inverse() * found.a_from_b).log();
    let chi2 = tangent.dot(&(found.information * tangent));
    assert!((0.1..30.0).contains(&chi2), "{chi2}");
}

#[test]
fn without_noise_the_motion_is_exact() {
    let (a, b, matches) = scene(60, 5, 0.0, &motion());
    let found = relative_pose(&a, &b, &matches, 1).unwrap();
    let (distance_m, angle) = error(&found.a_from_b, &motion());
    assert!(distance_m <= 1e-9 && angle <= 1e-9, "{distance_m} {angle}");
}

#[test]
fn matches_with_depth_in_one_frame_count_too() {
    let (mut a, mut b, matches) = scene(100, 0, 1.0, &motion());
    let with_both = relative_pose(&a, &b, &matches, 1).unwrap();
    for i in 0..90 {
        let frame = if i % 2 == 0 { &mut a } else { &mut b };
        frame.all[i].point = None;
    }
    let found = relative_pose(&a, &b, &matches, 1).unwrap();
    assert!(found.inliers >= 80, "{}", found.inliers);
    let (distance_m, angle) = error(&found.a_from_b, &motion());
    assert!(
        distance_m <= 0.015 && angle <= 0.005,
        "{distance_m} {angle}"
    );
    let size = |pose: &fgs_features::RelativePose| pose.information.trace();
    assert!(size(&found) < size(&with_both));
}

#[test]
fn what_does_not_determine_a_motion_is_refused() {
    let (a, b, matches) = scene(100, 0, 0.5, &motion());
    assert!(relative_pose(&a, &b, &matches, 1).is_some());
    assert!(
        relative_pose(&a, &b, &matches[..9], 1).is_none(),
        "nine matches"
    );
    assert!(relative_pose(&a, &b, &matches[..2], 1).is_none());
    assert!(relative_pose(&a, &b, &[], 1).is_none());
    // Nothing but wrong matches.
    let shifted: Vec<Match> = (0..100)
        .map(|i| Match {
            a: i,
            b: (i + 1) % 100,
            distance: 0,
        })
        .collect();
    assert!(
        relative_pose(&a, &b, &shifted, 1).is_none(),
        "wrong matches"
    );
    let without_depth = |features: &Features| {
        let mut features = features.clone();
        features
            .all
            .iter_mut()
            .for_each(|feature| feature.point = None);
        features
    };
    let (flat_a, flat_b) = (without_depth(&a), without_depth(&b));
    assert!(relative_pose(&flat_a, &flat_b, &matches, 1).is_none());
    assert!(
        relative_pose(&flat_a, &b, &matches, 1).is_none(),
        "no triple has both points"
    );
    // Many points on a patch of a few pixels: the position is uncertain.
    let (mut near_a, mut near_b) = (a.clone(), b.clone());
    let b_from_a = motion().inverse();
    for (i, (in_a, in_b)) in near_a.all.iter_mut().zip(&mut near_b.all).enumerate() {
        let (u, v) = (300.0 + (i % 10) as f64, 200.0 + (i / 10) as f64);
        let point = camera().unproject(u, v, 3.0);
        (in_a.pixel, in_a.point) = (Vector2::new(u, v), Some(point));
        let point = b_from_a.transform(&point);
        (in_b.pixel, in_b.point) = (camera().project(&point).unwrap(), Some(point));
    }
    assert!(
        relative_pose(&near_a, &near_b, &matches, 1).is_none(),
        "a small patch"
    );
}

#[test]
fn impossible_input_is_refused_without_a_panic() {
    let (mut a, b, mut matches) = scene(50, 0, 0.5, &motion());
    matches.push(Match {
        a: 50,
        b: 0,
        distance: 0,
    });
    matches.push(Match {
        a: 0,
        b: usize::MAX,
        distance: 0,
    });
    assert!(relative_pose(&a, &b, &matches, 1).is_some());
    for feature in &mut a.all {
        feature.point = Some(nalgebra::Vector3::repeat(f64::NAN));
    }
    assert!(relative_pose(&a, &b, &matches, 1).is_none());
    for feature in &mut a.all {
        feature.pixel = Vector2::repeat(f64::INFINITY);
        feature.point = Some(nalgebra::Vector3::repeat(1e300));
    }
    assert!(relative_pose(&a, &b, &matches, 1).is_none());
}
