use nalgebra::Matrix4;
use num_dual::Dual64;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;

const RATE_HZ: f64 = 30.0;

/// Duration of the motion.
const DURATION_SECS: f64 = 10.0;

/// A hand-held camera that rotates and translates about all axes, up to 0.7 rad/s and 0.4 m/s.
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
        ..DepthSensor::default()
    }
}

/// The measurements of both sensors, with errors of `noise` rad and metres.
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
    (0..(DURATION_SECS * RATE_HZ) as usize)
        .map(motion)
        .collect()
}

#[test]
fn the_delay_is_found() {
    for delay_secs in [-0.012, 0.0, 0.02] {
        for tangent in [[0.0; 6], [0.03, -0.02, 0.05, 0.1, -0.05, 0.02]] {
            let truth = sensor(delay_secs, tangent);
            let given = DepthSensor {
                delay_secs: 0.005,
                ..truth
            };
            let found = depth_delay(&motions(&walk, &truth, 0.0), &given).unwrap();
            // The velocity changes within the delay: by 2 rad/s^2 * delay / 2, that is 2 % of 0.7
            // rad/s.
            let error = (found.secs - delay_secs).abs();
            assert!(error <= 1e-6 + 0.01 * delay_secs.abs(), "{error}");
            for third in found.thirds_secs.unwrap() {
                assert!((third - delay_secs).abs() <= 1e-6 + 0.03 * delay_secs.abs());
            }
        }
    }
}

#[test]
fn standard_errors_tell_the_error() {
    let truth = sensor(-0.012, [0.0; 6]);
    let given = DepthSensor::default();
    let exact = depth_delay(&motions(&walk, &truth, 0.0), &given).unwrap();
    let noisy = depth_delay(&motions(&walk, &truth, 0.002), &given).unwrap();
    // 300 motions with velocity changes of 0.5 rad/s: 0.002 / 0.5 / sqrt(300) = 0.2 ms.
    let expected = 5e-5..6e-4;
    assert!(expected.contains(&noisy.standard_error_secs), "{noisy:?}");
    let error = (noisy.secs - exact.secs).abs();
    assert!(error <= 3.0 * noisy.standard_error_secs, "{error}");
    // Too few motions to split into thirds.
    let few = depth_delay(&motions(&walk, &truth, 0.002)[..40], &given).unwrap();
    assert!(few.thirds_secs.is_none());
    assert!((3e-4..2e-3).contains(&few.standard_error_secs), "{few:?}");
    assert!(exact.standard_error_secs <= 0.5 * noisy.standard_error_secs);
}

#[test]
fn a_delay_that_drifts_has_a_large_standard_error() {
    let given = DepthSensor::default();
    let [early, late] = [-0.004, -0.016].map(|delay| motions(&walk, &sensor(delay, [0.0; 6]), 0.0));
    let drifting: Vec<_> = early[..150].iter().chain(&late[150..]).cloned().collect();
    let found = depth_delay(&drifting, &given).unwrap();
    assert!(found.standard_error_secs >= 2e-3, "{found:?}");
    let [first, _, last] = found.thirds_secs.unwrap();
    assert!((first + 0.004).abs() <= 3e-4 && (last + 0.016).abs() <= 3e-4);
}

#[test]
fn outliers_do_not_matter() {
    let mut motions = motions(&walk, &sensor(-0.012, [0.0; 6]), 0.0005);
    // On their own, these outliers would give 0.1 s.
    for motion in motions.iter_mut().step_by(10) {
        let slip = Se3::exp(&(-0.1 * (motion.velocities[1] - motion.velocities[0])));
        motion.depth_second_from_first = slip * motion.depth_second_from_first;
    }
    let found = depth_delay(&motions, &DepthSensor::default()).unwrap();
    assert!((found.secs + 0.012).abs() <= 5e-4, "{found:?}");
}

#[test]
fn a_camera_that_only_moves_or_only_rests() {
    let truth = sensor(-0.012, [0.0; 6]);
    let given = DepthSensor::default();
    let shake = |t: f64| {
        Se3::exp(&Vector6::new(
            0.0,
            0.0,
            0.0,
            0.1 * (4.0 * t).sin(),
            0.0,
            0.0,
        ))
    };
    let found = depth_delay(&motions(&shake, &truth, 0.0005), &given).unwrap();
    assert!((found.secs + 0.012).abs() <= 4.0 * found.standard_error_secs);
    assert!(found.standard_error_secs <= 5e-4);
    let rest = |_| Se3::identity();
    assert!(depth_delay(&motions(&rest, &truth, 0.0), &given).is_none());
    assert!(depth_delay(&motions(&walk, &truth, 0.0)[..MIN_MEASUREMENTS - 1], &given).is_none());
}

#[test]
fn numbers_that_are_none_give_nothing() {
    let mut motions = motions(&walk, &sensor(0.01, [0.0; 6]), 0.0);
    motions[7].velocities[0][2] = f64::NAN;
    assert!(depth_delay(&motions, &DepthSensor::default()).is_none());
}

type Dual4 = [[Dual64; 4]; 4];

fn dual(pose: &Se3) -> Dual4 {
    let matrix = pose.matrix();
    std::array::from_fn(|i| std::array::from_fn(|j| Dual64::from(matrix[(i, j)])))
}

fn product(a: &Dual4, b: &Dual4) -> Dual4 {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            (0..4)
                .map(|k| a[i][k] * b[k][j])
                .fold(Dual64::from(0.0), |x, y| x + y)
        })
    })
}

/// Exponential of a twist by its series, independent of the closed form.
fn exp(twist: [Dual64; 6]) -> Dual4 {
    let zero = Dual64::from(0.0);
    let [x, y, z, a, b, c] = twist;
    let matrix = [
        [zero, -z, y, a],
        [z, zero, -x, b],
        [-y, x, zero, c],
        [zero; 4],
    ];
    let mut sum = dual(&Se3::identity());
    let mut term = sum;
    for k in 1..20 {
        term = product(&term, &matrix).map(|row| row.map(|value| value / f64::from(k)));
        sum = std::array::from_fn(|i| std::array::from_fn(|j| sum[i][j] + term[i][j]));
    }
    sum
}

/// `X_2 D X_1^-1` with its derivative with respect to the delay.
fn predicted(motion: &SensorMotion, sensor: &DepthSensor) -> Dual4 {
    let delay = Dual64::from(sensor.delay_secs).derivative();
    let moved = |side: usize, sign: f64| {
        let w = motion.velocities[side];
        exp(std::array::from_fn(|i| delay * w[i] * sign))
    };
    let factors = [
        dual(&sensor.color_from_depth),
        dual(&motion.depth_second_from_first),
        dual(&sensor.color_from_depth.inverse()),
        moved(0, -1.0),
    ];
    factors.iter().fold(moved(1, 1.0), |a, b| product(&a, b))
}

#[test]
fn the_derivative_is_that_of_dual_numbers() {
    let sensor = sensor(0.13, [0.3, -0.2, 0.1, 0.2, 0.1, -0.3]);
    let mut motion = SensorMotion {
        depth_second_from_first: Se3::exp(&Vector6::new(0.4, -0.1, 0.3, 0.5, 0.2, -0.6)),
        color_second_from_first: Se3::identity(),
        velocities: [
            Vector6::new(0.7, -1.1, 0.4, 0.3, 0.9, -0.2),
            Vector6::new(-0.3, 0.8, 0.6, -0.5, 0.1, 1.2),
        ],
    };
    let value = predicted(&motion, &sensor);
    let matrix = Matrix4::from_fn(|i, j| value[i][j].re);
    // The derivative is exact only where the residual is zero.
    motion.color_second_from_first = Se3::from_matrix(&matrix).unwrap();
    let Row { residual, by_delay } = row(&motion, &sensor);
    assert!(residual.amax() <= 1e-12, "{residual}");
    // A left perturbation by the twist t changes M by [t] M to first order.
    let derivative = Matrix4::from_fn(|i, j| value[i][j].eps);
    let twist = derivative * matrix.try_inverse().unwrap();
    let places = [(2, 1), (0, 2), (1, 0), (0, 3), (1, 3), (2, 3)];
    let expected = Vector6::from(places.map(|place| twist[place]));
    assert!(
        (by_delay - expected).amax() <= 1e-12,
        "{by_delay} {expected}"
    );
    assert!(expected.amin() >= 0.1);
}
