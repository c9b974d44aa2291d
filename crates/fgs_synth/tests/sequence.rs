//! Properties of a sequence: exact poses and depth, Lambertian surfaces, reproducibility, and views
//! that constrain all six degrees of freedom of the camera's motion.

#![allow(clippy::unwrap_used)] // Clippy's leave for tests stops at statics and helpers.

use std::sync::LazyLock;

use fgs_geom::{Image, RgbdFrame, Se3};
use fgs_synth::{SensorModel, Sequence, kinect_camera};
use nalgebra::{Matrix6, SymmetricEigen, Vector2, Vector3, Vector6};
use rayon::ThreadPoolBuilder;

/// Rooms of three seeds, seen by an ideal sensor with few pixels and a non-square image.
static SEQUENCES: LazyLock<[Sequence; 3]> = LazyLock::new(|| {
    let camera = kinect_camera(160, 112).unwrap();
    [0, 1, 2].map(|seed| Sequence::new(seed, 300, camera, SensorModel::exact()))
});

/// Bilinear interpolation between four pixels; `None` outside the image.
fn bilinear(at: impl Fn(usize, usize) -> Option<f64>, pixel: &Vector2<f64>) -> Option<f64> {
    if pixel.min() < 0.0 {
        return None;
    }
    let (u, v) = (pixel.x as usize, pixel.y as usize);
    let (a, b) = (pixel.x.fract(), pixel.y.fract());
    let near = at(u, v)? * (1.0 - a) + at(u + 1, v)? * a;
    let far = at(u, v + 1)? * (1.0 - a) + at(u + 1, v + 1)? * a;
    Some(near * (1.0 - b) + far * b)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Reprojects `a` into `b`: calls `compare` for every pixel of `a` that is visible to `b`'s camera,
/// with its depth in `b`'s camera frame and its pixel coordinates in `b`.
fn for_each_seen(
    a: &RgbdFrame,
    b: &RgbdFrame,
    b_from_a: &Se3,
    mut compare: impl FnMut(usize, usize, f64, Vector2<f64>),
) {
    for v in 0..a.camera.height {
        for u in 0..a.camera.width {
            let depth = f64::from(a.depth_m.at(u, v));
            let point = b_from_a.transform(&a.camera.unproject(u as f64, v as f64, depth));
            if let Some(pixel) = b.camera.project(&point) {
                compare(u, v, point.z, pixel);
            }
        }
    }
}

fn b_from_a(sequence: &Sequence, a: usize, b: usize) -> Se3 {
    sequence.world_from_camera(b).inverse() * sequence.world_from_camera(a)
}

#[test]
fn depth_of_one_frame_predicts_another() {
    for sequence in &*SEQUENCES {
        let (a, b) = (sequence.frame(20), sequence.frame(26));
        let errors = |motion: &Se3| {
            let mut errors = Vec::new();
            for_each_seen(&a, &b, motion, |_, _, z, pixel| {
                // On a plane 1/z is affine in the pixel coordinates.
                let inverse = |u, v| Some(1.0 / f64::from(b.depth_m.get(u, v)?));
                if let Some(inverse) = bilinear(inverse, &pixel) {
                    errors.push((1.0 / inverse - z).abs());
                }
            });
            errors
        };
        let exact = errors(&b_from_a(sequence, 20, 26));
        assert!(exact.len() > 160 * 112 / 2);
        assert!(median(exact) <= 1e-6);
        assert!(median(errors(&Se3::identity())) >= 1e-2);
    }
}

#[test]
fn surfaces_look_the_same_from_elsewhere() {
    for sequence in &*SEQUENCES {
        let (a, b) = (sequence.frame(20), sequence.frame(26));
        let error = |motion: &Se3| {
            let mut errors = Vec::new();
            for_each_seen(&a, &b, motion, |u, v, _, pixel| {
                let green = |u, v| Some(f64::from(b.color.get(u, v)?[1]));
                if let Some(green) = bilinear(green, &pixel) {
                    errors.push((green - f64::from(a.color.at(u, v)[1])).abs());
                }
            });
            errors.iter().sum::<f64>() / errors.len() as f64
        };
        let (exact, unmoved) = (error(&b_from_a(sequence, 20, 26)), error(&Se3::identity()));
        println!("mean difference {exact:.2}, without the motion {unmoved:.2}");
        assert!(exact <= 5.0, "{exact}");
        assert!(unmoved >= 3.0 * exact, "{unmoved}");
    }
}

/// Smallest eigenvalue of the normalised point-to-plane ICP Hessian: how well the view constrains
/// the least constrained direction of motion.
fn weakest_direction(frame: &RgbdFrame) -> f64 {
    let camera = &frame.camera;
    let point = |u: usize, v: usize| {
        let depth = f64::from(frame.depth_m.at(u, v));
        camera.unproject(u as f64, v as f64, depth)
    };
    let mut rows: Vec<(Vector3<f64>, Vector3<f64>)> = Vec::new();
    for v in (0..camera.height - 1).step_by(2) {
        for u in (0..camera.width - 1).step_by(2) {
            let p = point(u, v);
            let (right, down) = (point(u + 1, v) - p, point(u, v + 1) - p);
            // Skip normals that would span a depth edge.
            if right.norm().max(down.norm()) < 0.1 * p.z {
                rows.push((p, right.cross(&down).normalize()));
            }
        }
    }
    let count = rows.len() as f64;
    let center = rows.iter().map(|(p, _)| p).sum::<Vector3<f64>>() / count;
    let radius = rows.iter().map(|(p, _)| (p - center).norm()).sum::<f64>() / count;
    let mut hessian = Matrix6::zeros();
    for (p, normal) in &rows {
        let lever = ((p - center) / radius).cross(normal);
        let j = Vector6::new(lever.x, lever.y, lever.z, normal.x, normal.y, normal.z);
        hessian += j * j.transpose() / count;
    }
    SymmetricEigen::new(hessian).eigenvalues.min()
}

#[test]
fn views_fix_all_directions_and_keep_their_distance() {
    for (seed, sequence) in SEQUENCES.iter().enumerate() {
        let (mut weakest, mut nearest, mut farthest) = (f64::MAX, f32::MAX, 0.0_f32);
        for i in (0..300).step_by(12) {
            let frame = sequence.frame(i);
            weakest = weakest.min(weakest_direction(&frame));
            nearest = frame.depth_m.data().iter().copied().fold(nearest, f32::min);
            farthest = frame
                .depth_m
                .data()
                .iter()
                .copied()
                .fold(farthest, f32::max);
        }
        println!("seed {seed}: weakest {weakest:.4}, depth {nearest:.2} to {farthest:.2} m");
        // A single plane gives 0, a corner of three planes about 0.1.
        assert!(weakest >= 0.005, "{weakest}");
        assert!(nearest >= 0.5, "{nearest}");
        assert!(farthest <= 8.0, "{farthest}");
    }
}

#[test]
fn a_walk_through_rooms_shows_enough_everywhere() {
    let camera = kinect_camera(160, 112).unwrap();
    let walk = Sequence::through_rooms(0, 2, 600, camera, SensorModel::exact());
    assert!((walk.world_from_camera(599).translation.x) >= walk.room().size().x / 2.0);
    let mut weakest = f64::MAX;
    for i in (0..600).step_by(12) {
        let frame = walk.frame(i);
        weakest = weakest.min(weakest_direction(&frame));
        let depths = frame.depth_m.data();
        // Within a Kinect's depth range.
        let usable = depths.iter().filter(|z| (0.4..=5.0).contains(*z)).count();
        assert!(2 * usable >= depths.len(), "frame {i}: {usable} pixels");
        let light = mean_difference(&frame.color, &Image::filled(160, 112, [0; 3]));
        assert!((30.0..=225.0).contains(&light), "frame {i}: {light}");
    }
    println!("weakest {weakest:.4}");
    assert!(weakest >= 0.002, "{weakest}");
    let one = Sequence::through_rooms(0, 1, 300, camera, SensorModel::exact());
    assert_eq!(one.frame(7).color, SEQUENCES[0].frame(7).color);
}

fn mean_difference(a: &Image<[u8; 3]>, b: &Image<[u8; 3]>) -> f64 {
    let (a, b) = (a.data().as_flattened(), b.data().as_flattened());
    let sum: u64 = a
        .iter()
        .zip(b)
        .map(|(a, b)| u64::from(a.abs_diff(*b)))
        .sum();
    sum as f64 / a.len() as f64
}

/// A pixel holds the mean over its area, not a point sample.
#[test]
fn colour_is_anti_aliased() {
    let sequence = |width, height| {
        let camera = kinect_camera(width, height).unwrap();
        SEQUENCES[1].with_camera(camera).frame(90).color
    };
    let (small, large) = (sequence(80, 60), sequence(640, 480));
    // Average linear intensities, not the gamma-encoded values.
    let light = |code: u8| (f64::from(code) / 255.0).powf(2.2);
    let mean = Image::from_fn(80, 60, |u, v| {
        [0, 1, 2].map(|channel| {
            let part = |i: usize| light(large.at(8 * u + i % 8, 8 * v + i / 8)[channel]);
            let mean = (0..64).map(part).sum::<f64>() / 64.0;
            (255.0 * mean.powf(1.0 / 2.2)).round() as u8
        })
    });
    let point = Image::from_fn(80, 60, |u, v| large.at(8 * u + 4, 8 * v + 4));
    let (smooth, jagged) = (
        mean_difference(&small, &mean),
        mean_difference(&point, &mean),
    );
    println!("from the mean of 8x8: {smooth:.2}, a point alone {jagged:.2}");
    assert!(smooth <= 0.6 * jagged, "{smooth} {jagged}");
}

#[test]
fn rooms_differ() {
    for (i, a) in SEQUENCES.iter().enumerate() {
        for b in &SEQUENCES[..i] {
            assert!((a.room().size() - b.room().size()).norm() >= 0.01);
            let difference = mean_difference(&a.frame(0).color, &b.frame(0).color);
            assert!(difference >= 20.0, "{difference}");
        }
    }
}

#[test]
fn the_same_bytes_every_time_and_for_any_number_of_threads() {
    let film = |threads: usize| {
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let camera = kinect_camera(64, 48).unwrap();
            let sequence = Sequence::new(0, 300, camera, SensorModel::kinect());
            sequence.frame(17)
        })
    };
    let (one, three) = (film(1), film(3));
    assert_eq!(one.color, three.color);
    assert_eq!(one.depth_m, three.depth_m);
    let camera = kinect_camera(64, 48).unwrap();
    let other = Sequence::new(1, 300, camera, SensorModel::kinect()).frame(17);
    assert!(mean_difference(&one.color, &other.color) >= 10.0);
}

#[test]
fn a_kinect_is_noisy_blurs_and_misses_depth() {
    let exact = &SEQUENCES[2];
    let kinect = exact.with_sensor(SensorModel::kinect());
    let (truth, seen) = (exact.frame(40), kinect.frame(40));
    let pairs = truth.depth_m.data().iter().zip(seen.depth_m.data());
    let errors: Vec<f64> = (pairs.filter(|(_, seen)| **seen > 0.0))
        .map(|(truth, seen)| f64::from((seen - truth).abs()))
        .collect();
    let valid = errors.len() as f64 / truth.depth_m.data().len() as f64;
    println!("depth at {:.0} % of the pixels", 100.0 * valid);
    assert!((0.6..0.97).contains(&valid), "{valid}");
    let error = median(errors);
    assert!((0.002..0.02).contains(&error), "{error}");
    // Noise differs between frames, but rendering the same frame again repeats it.
    assert_eq!(kinect.frame(40).depth_m, seen.depth_m);

    let blurred = exact.with_sensor(SensorModel {
        shutter: 1.0,
        ..SensorModel::exact()
    });
    let steps = |image: &Image<[u8; 3]>| {
        let row = |v: usize| image.row(v).windows(2);
        let step = |pair: &[[u8; 3]]| u64::from(pair[0][1].abs_diff(pair[1][1]));
        (0..image.height()).flat_map(row).map(step).sum::<u64>() as f64
    };
    let (sharp, soft) = (steps(&truth.color), steps(&blurred.frame(40).color));
    assert!(soft <= 0.9 * sharp, "{soft} {sharp}");
    assert_eq!(blurred.frame(40).depth_m, truth.depth_m);
}

#[test]
fn frames_carry_their_index_time_and_camera() {
    let sequence = &SEQUENCES[0];
    assert_eq!(sequence.len(), 300);
    assert!(!sequence.is_empty());
    let frames: Vec<RgbdFrame> = sequence.frames().take(2).collect();
    assert_eq!(frames[1].index.0, 1);
    assert!((frames[1].timestamp_secs - 1.0 / 30.0).abs() <= 1e-12);
    assert_eq!(
        (frames[1].color.width(), frames[1].depth_m.height()),
        (160, 112)
    );
    assert_eq!(frames[1].camera, *sequence.camera());
}
