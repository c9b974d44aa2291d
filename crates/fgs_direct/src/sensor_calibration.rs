//! Where and when the depth image was measured, from the motions of both sensors.
//!
//! Input: pairs of frames whose motion was measured twice, by their depth images alone and by their
//! colour images. Output: the [`DepthSensor`] for which both are the motion of one rigid body
//! (hand-eye calibration with a delay). Gauss-Newton with the weights of a multivariate Student's t
//! distribution, whose covariance is estimated along with it: registration errs in some directions
//! ten times as much as in others.
//!
//! The translation between the sensors is taken as given: what a driver leaves of it, millimetres,
//! moves the sensors apart by less than registration's error.

use fgs_geom::{DepthSensor, Se3, skew};
use nalgebra::{Matrix4, Matrix6, SMatrix, Vector3, Vector4, Vector6};

type Matrix6x4 = SMatrix<f64, 6, 4>;

/// Gauss-Newton's steps; five are usual, and some dozens where a few motions could be outliers.
const MAX_ITERATIONS: usize = 100;

/// Converged when delay (s) and angles (rad) change by less.
const MAX_LAST_STEP: f64 = 1e-6;

/// Degrees of freedom of Student's distribution. With fewer, the fastest motions, which say most
/// about the delay but are measured worst, are taken for outliers.
const STUDENT: f64 = 10.0;

/// The covariance is re-estimated so often per step.
const COVARIANCE_ITERATIONS: usize = 5;

/// Registration is not better than this, rad and metres.
const MIN_NOISE: f64 = 1e-5;

/// Errors of motions close in time are not independent of one another, those of such parts of the
/// recording are.
const BLOCKS: usize = 6;

/// Fewer motions say nothing: the covariance of their errors alone is 21 numbers.
const MIN_MOTIONS: usize = 15;

/// The rotation is left as it was if the standard error of any angle is larger, rad: a quarter of a
/// pixel of a 640 pixel wide image.
const MAX_ROTATION_ERROR: f64 = 5e-4;

/// The motion between two frames, as both sensors saw it.
#[derive(Clone, Debug)]
pub struct SensorMotion {
    /// Between the depth images, in the axes of the depth sensor.
    pub depth_second_from_first: Se3,
    /// Between the colour images, in the axes of the colour camera.
    pub color_second_from_first: Se3,
    /// The colour camera's twist `[omega, v]` when it took either image, in its axes, rad/s and m/s.
    /// Its errors must be far smaller than the differences between frames, or the delay is
    /// underestimated.
    pub velocities: [Vector6<f64>; 2],
}

/// What [`calibrate`] found.
#[derive(Clone, Debug)]
pub struct SensorCalibration {
    /// The sensor that fits best. Its translation is the given one, and its rotation where
    /// `rotation_error` is `None`.
    pub sensor: DepthSensor,
    /// Standard error of the delay, seconds: from the scatter of parts of the recording.
    pub delay_error_secs: f64,
    /// Standard errors of the rotation about the depth sensor's axes, rad; `None` if the motions do
    /// not determine it.
    pub rotation_error: Option<Vector3<f64>>,
    /// The delays that fit the first, second and last third of the motions best, seconds; `None` if
    /// they are too few.
    pub delays_of_thirds_secs: Option<[f64; 3]>,
}

/// The depth sensor that explains motions in the order of time best, starting from a given one.
/// `None` for too few motions, and if they do not hold the delay at all: at rest, and at constant
/// velocity.
pub fn calibrate(motions: &[SensorMotion], given: &DepthSensor) -> Option<SensorCalibration> {
    let turned = fit(motions, given, 4);
    let held = turned.filter(|fit| fit.error.fixed_rows::<3>(1).max() <= MAX_ROTATION_ERROR);
    let rotation_error = held.as_ref().map(|fit| fit.error.fixed_rows::<3>(1).into());
    let Fit { sensor, error } = match held {
        Some(fit) => fit,
        None => fit(motions, given, 1)?,
    };
    let start = DepthSensor {
        color_from_depth: sensor.color_from_depth,
        ..*given
    };
    let third = |i: usize| {
        let part = &motions[i * motions.len() / 3..(i + 1) * motions.len() / 3];
        fit(part, &start, 1).map(|fit| fit.sensor.delay_secs)
    };
    let thirds = third(0).zip(third(1)).zip(third(2));
    let delays_of_thirds_secs = thirds.map(|((a, b), c)| [a, b, c]);
    let spread = delays_of_thirds_secs.map_or(0.0, |delays| {
        let mean = delays.iter().sum::<f64>() / 3.0;
        (delays.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / 6.0).sqrt()
    });
    Some(SensorCalibration {
        sensor,
        delay_error_secs: error[0].max(spread),
        rotation_error,
        delays_of_thirds_secs,
    })
}

struct Fit {
    sensor: DepthSensor,
    /// Standard errors of delay and rotation; 0 for what is not free.
    error: Vector4<f64>,
}

/// How far a sensor's prediction is from the measured motion of the colour camera, and the
/// derivatives by delay and rotation.
struct Row {
    residual: Vector6<f64>,
    jacobian: Matrix6x4,
}

/// Fits the first `free` of delay and rotation.
fn fit(motions: &[SensorMotion], given: &DepthSensor, free: usize) -> Option<Fit> {
    if motions.len() < MIN_MOTIONS {
        return None;
    }
    let mut sensor = *given;
    let mut covariance = None;
    for _ in 0..MAX_ITERATIONS {
        let rows: Vec<Row> = motions.iter().map(|motion| row(motion, &sensor)).collect();
        let noise = covariance.unwrap_or_else(|| scatter(&rows, |_| 1.0));
        let noise = student_covariance(&rows, noise)?;
        covariance = Some(noise);
        let information = noise.cholesky()?.inverse();
        let mut hessian = Matrix4::zeros();
        let mut scores = [Vector4::zeros(); BLOCKS];
        for (i, Row { residual, jacobian }) in rows.iter().enumerate() {
            let weight = student_weight(residual, &information);
            let weighted = weight * jacobian.transpose() * information;
            hessian += weighted * jacobian;
            scores[i * BLOCKS / rows.len()] += weighted * residual;
        }
        let gradient: Vector4<f64> = scores.iter().sum();
        let free_hessian = hessian.view((0, 0), (free, free)).into_owned();
        let free_inverse = free_hessian.cholesky()?.inverse();
        let mut inverse = Matrix4::zeros();
        inverse.view_mut((0, 0), (free, free)).copy_from(&free_inverse);
        let step = -inverse * gradient;
        let blocks = BLOCKS as f64;
        let spread: Matrix4<f64> = scores.iter().map(|score| score * score.transpose()).sum();
        let variance = (inverse * spread * inverse).diagonal() * (blocks / (blocks - 1.0));
        if !step.iter().chain(variance.iter()).all(|value| value.is_finite()) {
            return None;
        }
        sensor.delay_secs += step[0];
        let turn = Vector6::new(step[1], step[2], step[3], 0.0, 0.0, 0.0);
        sensor.color_from_depth = (sensor.color_from_depth * Se3::exp(&turn)).renormalized();
        if step.amax() <= MAX_LAST_STEP {
            let error = variance.map(f64::sqrt);
            return Some(Fit { sensor, error });
        }
    }
    None
}

/// With `X_i = exp(delay w_i) color_from_depth`, the colour camera should move by `X_2 D X_1^-1` where
/// the depth sensor moves by `D`. The residual is the left perturbation that is left over;
/// derivatives are exact where it is zero.
fn row(motion: &SensorMotion, sensor: &DepthSensor) -> Row {
    let [first, second] = motion.velocities;
    let [x_first, x_second] = motion.velocities.map(|w| sensor.color_from_depth(&w));
    let predicted = x_second * motion.depth_second_from_first * x_first.inverse();
    let moved = adjoint(&predicted);
    let turned = adjoint(&x_second) - moved * adjoint(&x_first);
    let mut jacobian = Matrix6x4::zeros();
    jacobian.set_column(0, &(second - moved * first));
    jacobian
        .fixed_columns_mut::<3>(1)
        .copy_from(&turned.fixed_columns::<3>(0));
    Row {
        residual: (predicted * motion.color_second_from_first.inverse()).log(),
        jacobian,
    }
}

/// The residuals' weighted mean square and that of rounding.
fn scatter(rows: &[Row], weight: impl Fn(&Vector6<f64>) -> f64) -> Matrix6<f64> {
    let squares = rows
        .iter()
        .map(|row| weight(&row.residual) * row.residual * row.residual.transpose());
    squares.sum::<Matrix6<f64>>() / rows.len() as f64
        + Matrix6::identity() * (MIN_NOISE * MIN_NOISE)
}

fn student_covariance(rows: &[Row], start: Matrix6<f64>) -> Option<Matrix6<f64>> {
    let mut covariance = start;
    for _ in 0..COVARIANCE_ITERATIONS {
        let information = covariance.cholesky()?.inverse();
        covariance = scatter(rows, |residual| student_weight(residual, &information));
    }
    Some(covariance)
}

fn student_weight(residual: &Vector6<f64>, information: &Matrix6<f64>) -> f64 {
    (STUDENT + 6.0) / (STUDENT + residual.dot(&(information * residual)))
}

/// The matrix that takes a twist `[omega, v]` in the axes of `b` to those of `a`.
fn adjoint(a_from_b: &Se3) -> Matrix6<f64> {
    let rotation = *a_from_b.rotation.to_rotation_matrix().matrix();
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    let lever = skew(&a_from_b.translation) * rotation;
    adjoint.fixed_view_mut::<3, 3>(3, 0).copy_from(&lever);
    adjoint
}

#[cfg(test)]
#[path = "sensor_calibration_tests.rs"]
mod tests;
