use num_dual::Dual64;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;

const RATE_HZ: f64 = 30.0;

/// Seconds of motion.
const DURATION_SECS: f64 = 10.0;

/// A hand-held camera that turns and moves about all axes, up to 0.7 rad/s and 0.4 m/s.
fn walk(t: f64) -> Se3 {
    Se3::exp(&Vector6::new(
        0.20 * (2.0 * t).sin(),
        0.30 * (2.3 * t).sin(),
        0.15 * (2.9 * t).sin(),
        0.25 * (1.5 * t).sin(),
        0.10 * (2.1 * t).sin(),
        0.20 * (1.9 * t).sin(),
    ))
}

fn velocity(pose: &dyn Fn(f64) -> Se3, t: f64) -> Vector6<f64> {
    (pose(t - 1e-4).inverse() * pose(t + 1e-4)).log() / 2e-4
}

fn sensor(delay_secs: f64, tangent: [f64; 6]) -> DepthSensor {
    DepthSensor {
        delay_secs,
        color_from_depth: Se3::exp(&Vector6::from(tangent)),
    }
}

/// What both sensors measure, with errors of `noise` rad and metres.
fn motions(pose: &dyn Fn(f64) -> Se3, truth: &DepthSensor, noise: f64) -> Vec<SensorMotion> {
    let mut random = Pcg64::seed_from_u64(5);
    let world_from_depth = |t: f64| pose(t + truth.delay_secs) * truth.color_from_depth;
    let motion = |i: usize| {
        let (first, second) = (i as f64 / RATE_HZ, (i + 9) as f64 / RATE_HZ);
        let error = Vector6::from_fn(|_, _| noise * (random.random::<f64>() - 0.5) * 12_f64.sqrt());
        SensorMotion {
            depth_second_from_first: Se3::exp(&error)
                * world_from_depth(second).inverse()
                * world_from_depth(first),
            color_second_from_first: pose(second).inverse() * pose(first),
            velocities: [velocity(pose, first), velocity(pose, second)],
        }
    };
    (0..(DURATION_SECS * RATE_HZ) as usize).map(motion).collect()
}

fn angle_between(a: &DepthSensor, b: &DepthSensor) -> f64 {
    (a.color_from_depth.rotation.inverse() * b.color_from_depth.rotation).angle()
}

#[test]
fn delay_and_rotation_are_found() {
    for (delay_secs, tangent) in [
        (-0.012, [0.0; 6]),
        (0.0, [0.0; 6]),
        (0.02, [0.01, -0.02, 0.015, 0.0, 0.0, 0.0]),
    ] {
        let truth = sensor(delay_secs, tangent);
        let found = calibrate(&motions(&walk, &truth, 0.0), &DepthSensor::default()).unwrap();
        // The velocity changes within the delay: by 3 rad/s^2 * delay / 2 = 4 % of 0.7 rad/s.
        let error = (found.sensor.delay_secs - delay_secs).abs();
        assert!(error <= 1e-7 + 0.01 * delay_secs.abs(), "{error}");
        assert!(angle_between(&found.sensor, &truth) <= 1e-6 + 0.01 * delay_secs.abs());
        assert!(found.rotation_error.is_some());
        for third in found.delays_of_thirds_secs.unwrap() {
            assert!((third - delay_secs).abs() <= 1e-7 + 0.03 * delay_secs.abs());
        }
    }
}

#[test]
fn a_known_translation_is_respected() {
    let truth = sensor(-0.012, [0.0, 0.0, 0.0, 0.1, -0.05, 0.02]);
    let given = DepthSensor {
        delay_secs: 0.0,
        ..truth
    };
    let found = calibrate(&motions(&walk, &truth, 0.0), &given).unwrap();
    assert!((found.sensor.delay_secs + 0.012).abs() <= 2e-4);
    assert!(angle_between(&found.sensor, &truth) <= 2e-4);
    assert_eq!(
        found.sensor.color_from_depth.translation,
        truth.color_from_depth.translation
    );
}

#[test]
fn standard_errors_tell_the_error() {
    let truth = sensor(-0.012, [0.003, -0.002, 0.001, 0.0, 0.0, 0.0]);
    let exact = calibrate(&motions(&walk, &truth, 0.0), &DepthSensor::default()).unwrap();
    let noisy = calibrate(&motions(&walk, &truth, 0.002), &DepthSensor::default()).unwrap();
    let error = (noisy.sensor.delay_secs - exact.sensor.delay_secs).abs();
    // 300 motions with velocities 0.5 rad/s apart: 0.002 / 0.5 / sqrt(300) = 0.2 ms.
    assert!((5e-5..4e-4).contains(&noisy.delay_error_secs));
    assert!(error <= 3.0 * noisy.delay_error_secs, "{error}");
    assert!(noisy.delay_error_secs >= 3.0 * exact.delay_error_secs);
    // With such noise, angles are known to milliradians only: not reported, and not changed.
    assert!(noisy.rotation_error.is_none());
    assert_eq!(noisy.sensor.color_from_depth, Se3::identity());
}

#[test]
fn outliers_do_not_matter() {
    let truth = sensor(-0.012, [0.0; 6]);
    let mut motions = motions(&walk, &truth, 0.0005);
    for motion in motions.iter_mut().step_by(10) {
        let slip = Se3::exp(&Vector6::new(0.05, 0.0, 0.02, 0.1, 0.0, 0.0));
        motion.depth_second_from_first = slip * motion.depth_second_from_first;
    }
    let found = calibrate(&motions, &DepthSensor::default()).unwrap();
    assert!((found.sensor.delay_secs + 0.012).abs() <= 5e-4, "{found:?}");
}

#[test]
fn what_the_motion_does_not_hold_is_not_reported() {
    let truth = sensor(-0.012, [0.0; 6]);
    let given = DepthSensor::default();
    let rest = |_| Se3::identity();
    assert!(calibrate(&motions(&rest, &truth, 0.0), &given).is_none());
    assert!(calibrate(&motions(&walk, &truth, 0.0)[..MIN_MOTIONS - 1], &given).is_none());
    // The delay shows in a shaking camera that does not turn; rotation hardly does.
    let shake = |t: f64| Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.1 * (4.0 * t).sin(), 0.0, 0.0));
    let found = calibrate(&motions(&shake, &truth, 0.0005), &given).unwrap();
    assert!((found.sensor.delay_secs + 0.012).abs() <= 4.0 * found.delay_error_secs);
    assert!(found.delay_error_secs <= 1e-3 && found.rotation_error.is_none());
}

#[test]
fn numbers_that_are_none_give_nothing() {
    let mut motions = motions(&walk, &sensor(0.01, [0.0; 6]), 0.0);
    motions[7].velocities[0][2] = f64::NAN;
    assert!(calibrate(&motions, &DepthSensor::default()).is_none());
}

type Dual4 = [[Dual64; 4]; 4];

fn dual(pose: &Se3) -> Dual4 {
    let matrix = pose.matrix();
    std::array::from_fn(|i| std::array::from_fn(|j| Dual64::from(matrix[(i, j)])))
}

fn product(a: &Dual4, b: &Dual4) -> Dual4 {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            (0..4).map(|k| a[i][k] * b[k][j]).fold(Dual64::from(0.0), |x, y| x + y)
        })
    })
}

/// exp of a twist by its series, independent of the closed form.
fn exp(twist: [Dual64; 6]) -> Dual4 {
    let zero = Dual64::from(0.0);
    let [x, y, z, a, b, c] = twist;
    let matrix = [[zero, -z, y, a], [z, zero, -x, b], [-y, x, zero, c], [zero; 4]];
    let mut sum = dual(&Se3::identity());
    let mut term = sum;
    for k in 1..20 {
        term = product(&term, &matrix).map(|row| row.map(|value| value / f64::from(k)));
        sum = std::array::from_fn(|i| std::array::from_fn(|j| sum[i][j] + term[i][j]));
    }
    sum
}

/// `X_2 D X_1^-1` with its derivative by parameter `axis`.
fn predicted(motion: &SensorMotion, sensor: &DepthSensor, axis: usize) -> Dual4 {
    let parameter = |i: usize, value: f64| {
        let value = Dual64::from(value);
        if i == axis { value.derivative() } else { value }
    };
    let delay = parameter(0, sensor.delay_secs);
    let turn: [Dual64; 6] =
        std::array::from_fn(|i| if i < 3 { parameter(i + 1, 0.0) } else { 0.0.into() });
    let moved = |side: usize, sign: f64| {
        let w = motion.velocities[side];
        exp(std::array::from_fn(|i| delay * w[i] * sign))
    };
    let x = dual(&sensor.color_from_depth);
    let x_inverse = dual(&sensor.color_from_depth.inverse());
    let factors = [
        moved(1, 1.0),
        x,
        exp(turn),
        dual(&motion.depth_second_from_first),
        exp(turn.map(|value| -value)),
        x_inverse,
        moved(0, -1.0),
    ];
    factors[1..].iter().fold(factors[0], |a, b| product(&a, b))
}

#[test]
fn derivatives_are_those_of_dual_numbers() {
    let sensor = sensor(0.13, [0.3, -0.2, 0.1, 0.2, 0.1, -0.3]);
    let mut motion = SensorMotion {
        depth_second_from_first: Se3::exp(&Vector6::new(0.4, -0.1, 0.3, 0.5, 0.2, -0.6)),
        color_second_from_first: Se3::identity(),
        velocities: [
            Vector6::new(0.7, -1.1, 0.4, 0.3, 0.9, -0.2),
            Vector6::new(-0.3, 0.8, 0.6, -0.5, 0.1, 1.2),
        ],
    };
    let value = predicted(&motion, &sensor, 9);
    let matrix = nalgebra::Matrix4::from_fn(|i, j| value[i][j].re);
    // Where the residual is zero.
    motion.color_second_from_first = Se3::from_matrix(&matrix).unwrap();
    let Row { residual, jacobian } = row(&motion, &sensor);
    assert!(residual.amax() <= 1e-9, "{residual}");
    for axis in 0..4 {
        let derivative = predicted(&motion, &sensor, axis);
        let derivative = nalgebra::Matrix4::from_fn(|i, j| derivative[i][j].eps);
        // A left perturbation by the twist t changes M by [t] M.
        let twist = derivative * matrix.try_inverse().unwrap();
        let expected = Vector6::new(
            twist[(2, 1)],
            twist[(0, 2)],
            twist[(1, 0)],
            twist[(0, 3)],
            twist[(1, 3)],
            twist[(2, 3)],
        );
        let difference = (jacobian.column(axis) - expected).amax();
        assert!(difference <= 1e-12, "{axis}: {difference}");
        assert!(expected.amax() >= 0.1);
    }
}
