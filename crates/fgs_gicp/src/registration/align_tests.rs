use fgs_geom::{Camera, Image, Intrinsics};
use nalgebra::Vector6;

use super::*;
use crate::{Covariance, DepthGrid, Kernel, MIN_EIGENVALUE};

fn camera() -> Camera {
    let intrinsics = Intrinsics {
        fx: 150.0,
        fy: 160.0,
        cx: 88.0,
        cy: 61.5,
    };
    Camera::new(192, 128, intrinsics).unwrap()
}

/// Planes `normal . p = distance`, seen from inside.
type Scene = Vec<(Vector3<f64>, f64)>;

/// A floor, a slanted wall and two more walls, which together constrain all six degrees of freedom.
fn corner() -> Scene {
    vec![
        (Vector3::new(0.0, 1.0, 0.0), 0.8),
        (Vector3::new(0.2, 0.1, 1.0).normalize(), 2.5),
        (Vector3::new(1.0, 0.0, 0.3).normalize(), 1.0),
        (Vector3::new(-1.0, -0.2, 0.2).normalize(), 0.9),
    ]
}

/// The points of a scene visible from a camera pose, in the camera frame.
fn view(scene: &Scene, world_from_camera: &Se3) -> Vec<Point> {
    let camera = camera();
    let depth_m = Image::from_fn(camera.width, camera.height, |u, v| {
        let ray = world_from_camera.rotation * camera.ray(u as f64, v as f64);
        let hits = scene.iter().filter_map(|(normal, distance)| {
            let along = normal.dot(&ray);
            let depth = (distance - normal.dot(&world_from_camera.translation)) / along;
            (along > 0.0).then_some(depth)
        });
        hits.fold(f64::INFINITY, f64::min) as f32
    });
    let grid = DepthGrid {
        stride_px: 3,
        max_fit_error: 1e-3,
        ..DepthGrid::default()
    };
    let surface = grid.surface_points(&depth_m, &camera);
    surface
        .iter()
        .map(|point| point.disk(MIN_EIGENVALUE, 0.0))
        .collect()
}

fn map_of(points: &[Point]) -> PointMap {
    let mut map = PointMap::new(0.03);
    for (id, point) in points.iter().enumerate() {
        map.insert(id as u64, *point);
    }
    map
}

fn precise() -> Settings {
    Settings {
        max_correspondence_distance_m: 0.1,
        rotation_epsilon_rad: 1e-6,
        translation_epsilon_m: 1e-6,
        ..Settings::default()
    }
}

/// RMS distance between the points transformed by two poses.
fn distance(points: &[Point], a: &Se3, b: &Se3) -> f64 {
    let squared = points.iter().map(|point| {
        let p = point.position.cast();
        (a.transform(&p) - b.transform(&p)).norm_squared()
    });
    (squared.sum::<f64>() / points.len() as f64).sqrt()
}

/// Rotations and translations along each axis, and all combined.
fn motions() -> Vec<Se3> {
    let mut tangents: Vec<Vector6<f64>> = Vec::new();
    for axis in 0..3 {
        let mut tangent = Vector6::zeros();
        tangent[axis] = 0.02;
        tangent[3 + (axis + 1) % 3] = 0.02;
        tangents.push(tangent);
    }
    tangents.push(Vector6::new(-0.012, 0.01, 0.015, 0.015, -0.01, 0.02));
    tangents.iter().map(Se3::exp).collect()
}

#[test]
fn known_motion_about_three_axes() {
    let target = map_of(&view(&corner(), &Se3::identity()));
    for motion in motions() {
        let source = view(&corner(), &motion);
        let moved = distance(&source, &motion, &Se3::identity());
        let alignment = align(&source, &target, &Se3::identity(), &precise()).unwrap();
        let error = distance(&source, &motion, &alignment.target_from_source);
        assert!(alignment.converged);
        assert!(error <= moved / 50.0, "{error} of {moved}");
        assert!(alignment.inlier_share > 0.8);
        assert!(alignment.conditioning.weakest > 0.01);
        assert!(alignment.rms_residual_m <= 1e-3);
    }
}

/// `align_all` from the same start is the reference.
#[test]
fn a_sample_first_changes_nothing_but_the_time() {
    let target = map_of(&view(&corner(), &Se3::identity()));
    for motion in motions() {
        let source = view(&corner(), &motion);
        let start = Se3::identity();
        let moved = distance(&source, &motion, &start);
        let near = align_sample(&source, &target, &start, &precise()).unwrap();
        let off = distance(&source, &motion, &near);
        assert!(off <= moved / 10.0, "{off} of {moved}");
        let all = align_all(&source, &target, &start, &precise()).unwrap();
        let alignment = align(&source, &target, &start, &precise()).unwrap();
        let difference = distance(
            &source,
            &all.target_from_source,
            &alignment.target_from_source,
        );
        assert!(difference <= 1e-5, "{difference} of {moved}");
        assert!(alignment.iterations < all.iterations);
    }
}

/// A source too small for a subsample, a subsample that does not converge, and one of outliers
/// only.
#[test]
fn a_sample_that_misleads_is_not_followed() {
    let points = view(&corner(), &Se3::identity());
    let few = &points[..2 * SAMPLE_POINTS - 1];
    let (target, start) = (map_of(&points), Se3::identity());
    assert!(align_sample(few, &target, &start, &precise()).is_none());
    // One iteration is too few to converge.
    let once = Settings {
        max_iterations: 1,
        ..precise()
    };
    let moved = view(&corner(), &motions()[3]);
    assert!(align_sample(&moved, &target, &start, &once).is_none());
    let step = points.len() / SAMPLE_POINTS;
    let mut source = points.clone();
    for point in source.iter_mut().step_by(step) {
        point.position += Vector3::repeat(100.0);
    }
    assert!(align_sample(&source, &target, &start, &precise()).is_none());
    let alignment = align(&source, &target, &start, &precise()).unwrap();
    assert!(distance(&points, &alignment.target_from_source, &start) <= 1e-4);
}

#[test]
fn there_and_back_is_nowhere() {
    for motion in motions() {
        let (a, b) = (view(&corner(), &Se3::identity()), view(&corner(), &motion));
        let align = |source: &[Point], target: &[Point]| {
            align(source, &map_of(target), &Se3::identity(), &precise()).unwrap()
        };
        let (a_from_b, b_from_a) = (align(&b, &a), align(&a, &b));
        let round = a_from_b.target_from_source * b_from_a.target_from_source;
        let error = distance(&a, &round, &Se3::identity());
        let moved = distance(&a, &motion, &Se3::identity());
        assert!(error <= moved / 50.0, "{error} of {moved}");
    }
}

#[test]
fn outliers_lose_to_a_kernel() {
    let motion = motions()[3];
    let mut source = view(&corner(), &motion);
    // A third of the points are displaced by up to 2 cm per axis, all in the same direction.
    for point in source.iter_mut().step_by(3) {
        point.position += Vector3::new(0.02, -0.015, 0.02);
    }
    let target = map_of(&view(&corner(), &Se3::identity()));
    let error = |kernel: Kernel| {
        let settings = Settings {
            kernel,
            ..precise()
        };
        // Start close to the solution: redescending kernels have a small basin of convergence.
        let start = motion * Se3::exp(&Vector6::repeat(5e-4));
        let alignment = align(&source, &target, &start, &settings).unwrap();
        distance(&source, &motion, &alignment.target_from_source)
    };
    let without = error(Kernel::None);
    let scale_m = 0.002;
    let remaining = [
        error(Kernel::GemanMcClure { scale_m }),
        error(Kernel::Cauchy { scale_m }),
        error(Kernel::Huber { scale_m }),
    ];
    let bounds = [0.1, 0.2, 0.7].map(|share| share * without);
    for (error, bound) in remaining.iter().zip(bounds) {
        assert!(*error <= bound, "{remaining:?} of {without}");
    }
}

#[test]
fn the_weakest_motion_of_a_corridor_is_along_it() {
    let along = Vector3::new(0.3, 0.2, 1.0).normalize();
    let across = along.cross(&Vector3::y()).normalize();
    let up = along.cross(&across);
    let walls = vec![(across, 0.8), (-across, 0.7), (up, 0.9), (-up, 0.8)];
    let source: Vec<Point> = view(&walls, &Se3::identity());
    let near: Vec<Point> = source.into_iter().filter(|p| p.position.z < 4.0).collect();
    let alignment = align(&near, &map_of(&near), &Se3::identity(), &precise()).unwrap();
    let conditioning = alignment.conditioning;
    assert!(conditioning.weakest <= 0.01, "{conditioning:?}");
    let motion: Vector3<f64> = conditioning.weakest_motion.fixed_rows::<3>(3).into_owned();
    assert!(motion.dot(&along).abs() >= 0.99, "{conditioning:?}");
}

#[test]
fn a_plane_is_aligned_and_said_to_slide() {
    let wall = vec![(Vector3::new(0.1, -0.2, 1.0).normalize(), 1.5)];
    let target = map_of(&view(&wall, &Se3::identity()));
    let motion = Se3::exp(&Vector6::new(0.004, -0.003, 0.0, 0.0, 0.0, 0.01));
    let source = view(&wall, &motion);
    let alignment = align(&source, &target, &Se3::identity(), &precise()).unwrap();
    assert!(alignment.conditioning.weakest <= 2e-3);
    assert!(alignment.hessian.iter().all(|value| value.is_finite()));
    // Anywhere on the plane.
    for point in &source {
        let p = alignment
            .target_from_source
            .transform(&point.position.cast());
        assert!((wall[0].0.dot(&p) - wall[0].1).abs() <= 2e-4, "{p}");
    }
}

#[test]
fn input_that_cannot_be_aligned() {
    let points = view(&corner(), &Se3::identity());
    let (target, start, settings) = (map_of(&points), Se3::identity(), Settings::default());
    let error = |source: &[Point], target: &PointMap, start: &Se3| {
        align(source, target, start, &settings).unwrap_err()
    };
    assert_eq!(error(&[], &target, &start), AlignError::EmptySource);
    assert_eq!(
        error(&points, &PointMap::new(0.1), &start),
        AlignError::EmptyTarget
    );
    let mut broken = points.clone();
    broken[17].position.y = f32::NAN;
    assert_eq!(
        error(&broken, &target, &start),
        AlignError::NonFiniteSource { index: 17 }
    );
    broken[17] = points[17];
    broken[5].covariance = Covariance::disk(&Vector3::repeat(f64::NAN), 1e-3);
    assert_eq!(
        error(&broken, &target, &start),
        AlignError::NonFiniteSource { index: 5 }
    );
    let nan = Se3::new(start.rotation, Vector3::repeat(f64::NAN));
    assert_eq!(error(&points, &target, &nan), AlignError::NonFiniteStart);
    let away = Se3::new(start.rotation, Vector3::repeat(100.0));
    let too_few = error(&points, &target, &away);
    assert!(
        matches!(too_few, AlignError::TooFewPairs { pairs: 0, .. }),
        "{too_few}"
    );
    let same_point = vec![points[0]; 10];
    assert_eq!(
        error(&same_point, &target, &start),
        AlignError::Undetermined { pairs: 10 }
    );
    let line: Vec<Point> = (0..20)
        .map(|i| Point {
            position: Vector3::new(0.1, 0.2, 1.0 + 0.01 * i as f32),
            covariance: Covariance::isotropic(),
        })
        .collect();
    assert_eq!(
        error(&line, &map_of(&line), &start),
        AlignError::Undetermined { pairs: 20 }
    );
}

#[test]
fn the_same_bits_for_any_number_of_threads() {
    let target = map_of(&view(&corner(), &Se3::identity()));
    let source = view(&corner(), &motions()[3]);
    assert!(source.len() > 2 * CHUNK_POINTS);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| align(&source, &target, &Se3::identity(), &precise()).unwrap())
    };
    let one = run(1);
    for threads in [2, 3, 8] {
        let other = run(threads);
        assert_eq!(one.target_from_source, other.target_from_source);
        assert_eq!(one.hessian, other.hessian);
        assert_eq!(one.rms_residual_m.to_bits(), other.rms_residual_m.to_bits());
    }
}
