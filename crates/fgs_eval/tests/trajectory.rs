//! ATE, RPE and association against evo (`golden/make_trajectory.py`), and degenerate trajectories.

#![allow(clippy::unwrap_used)]

use fgs_eval::{EvalError, Statistics, associate, ate, rpe};
use fgs_geom::Se3;
use nalgebra::{Vector3, Vector6};

fn golden(name: &str) -> String {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden");
    std::fs::read_to_string(format!("{folder}/{name}")).unwrap()
}

/// Times and poses of a TUM trajectory file.
fn read_trajectory(name: &str) -> (Vec<f64>, Vec<Se3>) {
    let parse_line = |line: &str| {
        let values: Vec<f64> = line.split(' ').map(|x| x.parse().unwrap()).collect();
        let [time, x, y, z, qx, qy, qz, qw] = values.try_into().unwrap();
        (time, Se3::from_wxyz([qw, qx, qy, qz], [x, y, z]).unwrap())
    };
    golden(name).lines().map(parse_line).unzip()
}

fn assert_near(statistics: &Statistics, name: &str) {
    let golden = golden("expected.txt");
    let expected = |key: &str| -> f64 {
        let key = format!("{name}_{key} ");
        let value = golden.lines().find_map(|line| line.strip_prefix(&key));
        value.unwrap().parse().unwrap()
    };
    for (key, actual) in [
        ("rmse", statistics.rmse),
        ("mean", statistics.mean),
        ("median", statistics.median),
        ("max", statistics.max),
        ("std", statistics.std),
    ] {
        let error = (actual - expected(key)).abs();
        assert!(error <= 1e-9, "{name} {key}: off by {error}");
    }
}

#[test]
fn equals_evo() {
    let (estimated_secs, estimated) = read_trajectory("estimated.txt");
    let (reference_secs, reference) = read_trajectory("reference.txt");
    let pairs = associate(&estimated_secs, &reference_secs, 0.02);
    let listed: Vec<String> = pairs.iter().map(|(i, j)| format!("pair {i} {j}")).collect();
    let golden = golden("expected.txt");
    let expected: Vec<&str> = golden.lines().filter(|l| l.starts_with("pair")).collect();
    assert_eq!(listed, expected);

    let (estimated, reference): (Vec<Se3>, Vec<Se3>) = (pairs.iter())
        .map(|&(i, j)| (estimated[i], reference[j]))
        .unzip();
    let absolute = ate(&estimated, &reference).unwrap().translation_m;
    assert!(absolute.rmse > 2.0 * absolute.mean);
    assert_near(&absolute, "ate");
    for delta in [1, 10] {
        let relative = rpe(&estimated, &reference, delta).unwrap();
        assert_near(
            &relative.translation_m,
            &format!("rpe_{delta}_translation_m"),
        );
        assert_near(&relative.rotation_deg, &format!("rpe_{delta}_rotation_deg"));
    }
}

fn helix(count: usize) -> Vec<Se3> {
    let pose = |i| Se3::exp(&(0.1 * i as f64 * Vector6::new(0.3, -1.0, 0.5, 1.0, 2.0, -0.5)));
    (0..count).map(pose).collect()
}

fn at(positions: &[[f64; 3]]) -> Vec<Se3> {
    let pose = |&p| Se3 {
        translation: Vector3::from(p),
        ..Se3::identity()
    };
    positions.iter().map(pose).collect()
}

#[test]
fn the_same_trajectory_elsewhere_has_no_absolute_error() {
    let reference = helix(20);
    let elsewhere = Se3::exp(&Vector6::new(2.0, -1.0, 0.5, 10.0, -7.0, 3.0));
    let estimated: Vec<Se3> = reference.iter().map(|&pose| elsewhere * pose).collect();
    let error = ate(&estimated, &reference).unwrap();
    assert!(error.translation_m.max <= 1e-13);
    let found = error.reference_from_estimated.matrix() - elsewhere.inverse().matrix();
    assert!(found.amax() <= 1e-12);
    let relative = rpe(&estimated, &reference, 3).unwrap();
    assert!(relative.translation_m.max <= 1e-12 && relative.rotation_deg.max <= 1e-6);
}

#[test]
fn scale_is_not_aligned() {
    let reference = at(&[[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]);
    let estimated = at(&[[-2.0, 0.0, 0.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]);
    let error = ate(&estimated, &reference).unwrap().translation_m;
    assert!((error.max - 1.0).abs() <= 1e-15 && (error.mean - 2.0 / 3.0).abs() <= 1e-15);
}

/// Along different lines, one stretched: what the stretch leaves is the error.
#[test]
fn lines_are_aligned() {
    let along = |step: [f64; 3]| -> Vec<Se3> {
        let positions = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|i| step.map(|x| i * x));
        at(&positions)
    };
    for step in [
        [0.0, 3.0, 0.0],
        [0.0, 0.0, -3.0],
        [-3.0, 0.0, 0.0],
        [1.0, 2.0, 2.0],
    ] {
        let error = ate(&along(step), &along([0.0, 2.5, 0.0])).unwrap();
        assert!((error.translation_m.max - 1.0).abs() <= 1e-12);
        assert!((error.translation_m.median - 0.5).abs() <= 1e-12);
    }
}

#[test]
fn standing_still_is_defined() {
    let still = at(&[[4.0, -5.0, 6.0]; 4]);
    let error = ate(&still, &still).unwrap();
    assert_eq!(error.translation_m.max, 0.0);
    let moving = at(&[[0.0; 3], [2.0, 0.0, 0.0], [0.0; 3], [2.0, 0.0, 0.0]]);
    for (a, b) in [(&still, &moving), (&moving, &still)] {
        assert!((ate(a, b).unwrap().translation_m.rmse - 1.0).abs() <= 1e-15);
    }
}

#[test]
fn too_few_or_unpaired_poses() {
    let poses = helix(5);
    assert_eq!(
        ate(&poses[..2], &poses[..2]),
        Err(EvalError::TooFewPoses {
            poses: 2,
            minimum: 3
        })
    );
    assert_eq!(
        rpe(&poses, &poses, 5),
        Err(EvalError::TooFewPoses {
            poses: 5,
            minimum: 6
        })
    );
    assert!(rpe(&poses, &poses, usize::MAX).is_err());
    assert!(rpe(&poses[..2], &poses[..2], 1).is_ok());
    assert_eq!(rpe(&poses, &poses, 0), Err(EvalError::ZeroDelta));
    assert_eq!(
        ate(&poses, &poses[1..]),
        Err(EvalError::UnequalLengths {
            estimated: 5,
            reference: 4
        })
    );
}

#[test]
fn impossible_positions_are_named() {
    for value in [f64::NAN, f64::INFINITY, -1e300] {
        let mut poses = helix(5);
        poses[3].translation.y = value;
        assert_eq!(
            ate(&helix(5), &poses),
            Err(EvalError::PoseOutOfRange {
                trajectory: "reference",
                index: 3
            })
        );
        assert!(rpe(&poses, &helix(5), 1).is_err());
    }
    let far = at(&[[1e9, 0.0, 0.0], [0.0, -1e9, 0.0], [0.0, 0.0, 1e9]]);
    assert!(ate(&far, &helix(3)).unwrap().translation_m.rmse.is_finite());
}
