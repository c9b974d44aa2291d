//! When the depth image was measured, from the motions of both sensors.
//!
//! Input: pairs of frames whose motion was measured twice, by their depth images alone and by their
//! colour images. Output: the delay for which both are the motion of one rigid body. Gauss-Newton
//! with the weights of a multivariate Student's t distribution, whose covariance is estimated along
//! with it: registration errs in some directions ten times as much as in others.
//!
//! The sensors' places relative to each other are taken as given. They show in the motions only as
//! far as the camera turns between the frames (hand-eye calibration): an image shifted by a pixel
//! changes a motion of ten degrees by a sixth of a pixel, less than registration's bias.

use fgs_geom::{DepthSensor, Se3, skew};
use nalgebra::{Matrix6, Vector6};

/// Gauss-Newton's steps; five are usual, and some dozens where a few motions could be outliers.
const MAX_ITERATIONS: usize = 100;

/// Converged when the delay changes by less, seconds.
const MAX_LAST_STEP: f64 = 1e-6;

/// Degrees of freedom of Student's distribution. With fewer, the fastest motions, which say most
/// about the delay but are measured worst, are taken for outliers.
const STUDENT: f64 = 10.0;

/// The covariance is re-estimated so often per step.
const COVARIANCE_ITERATIONS: usize = 5;

/// Registration is not better than this, rad and metres.
const MIN_NOISE: f64 = 1e-5;

/// Errors of motions close in time are not independent of one another, those of so many parts of the
/// recording are.
const BLOCKS: usize = 6;

/// Fewer motions say nothing: the covariance of their errors alone is 21 numbers.
const MIN_MOTIONS: usize = 15;

/// The motion between two frames, as both sensors saw it.
#[derive(Clone, Debug)]
pub struct SensorMotion {
    /// Between the depth images, in the axes of the depth sensor.
    pub depth_second_from_first: Se3,
    /// Between the colour images, in the axes of the colour camera.
    pub color_second_from_first: Se3,
    /// The colour camera's twist `[omega, v]` when it took either image, in its axes, rad/s and m/s.
    /// Where its errors are not far smaller than the differences between frames, the delay is
    /// underestimated.
    pub velocities: [Vector6<f64>; 2],
}

/// What [`depth_delay`] found.
#[derive(Clone, Debug)]
pub struct DepthDelay {
    /// [`DepthSensor::delay_secs`].
    pub delay_secs: f64,
    /// Its standard error, from the scatter of parts of the recording, seconds.
    pub standard_error_secs: f64,
    /// What the first, second and last third of the motions say alone; `None` if that is too few.
    pub thirds_secs: Option<[f64; 3]>,
}

/// The delay of a depth sensor at a known place that explains motions in the order of time best; the
/// search starts at the given delay. `None` for too few motions, and if they do not hold the delay at
/// all: at rest, and at constant velocity.
pub fn depth_delay(motions: &[SensorMotion], given: &DepthSensor) -> Option<DepthDelay> {
    let (delay_secs, standard_error_secs) = fit(motions, given)?;
    let third = |i: usize| {
        let part = &motions[i * motions.len() / 3..(i + 1) * motions.len() / 3];
        fit(part, given).map(|(delay, _)| delay)
    };
    let thirds = third(0).zip(third(1)).zip(third(2));
    let thirds_secs = thirds.map(|((a, b), c)| [a, b, c]);
    let spread = thirds_secs.map_or(0.0, |delays| {
        let mean = delays.iter().sum::<f64>() / 3.0;
        (delays
            .iter()
            .map(|delay| (delay - mean).powi(2))
            .sum::<f64>()
            / 6.0)
            .sqrt()
    });
    Some(DepthDelay {
        delay_secs,
        standard_error_secs: standard_error_secs.max(spread),
        thirds_secs,
    })
}

/// How far a prediction is from the measured motion of the colour camera, and its derivative by the
/// delay.
struct Row {
    residual: Vector6<f64>,
    by_delay: Vector6<f64>,
}

/// The delay and its standard error.
fn fit(motions: &[SensorMotion], given: &DepthSensor) -> Option<(f64, f64)> {
    if motions.len() < MIN_MOTIONS {
        return None;
    }
    let mut sensor = *given;
    let mut covariance = None;
    for _ in 0..MAX_ITERATIONS {
        let rows: Vec<Row> = motions.iter().map(|motion| row(motion, &sensor)).collect();
        let start = covariance.unwrap_or_else(|| scatter(&rows, |_| 1.0));
        let noise = student_covariance(&rows, start)?;
        covariance = Some(noise);
        let information = noise.cholesky()?.inverse();
        let mut hessian = 0.0;
        let mut gradients = [0.0; BLOCKS];
        for (i, Row { residual, by_delay }) in rows.iter().enumerate() {
            let weighted = student_weight(residual, &information) * information * by_delay;
            hessian += weighted.dot(by_delay);
            gradients[i * BLOCKS / rows.len()] += weighted.dot(residual);
        }
        let step = -gradients.iter().sum::<f64>() / hessian;
        if !step.is_finite() {
            return None;
        }
        sensor.delay_secs += step;
        if step.abs() <= MAX_LAST_STEP {
            let blocks = BLOCKS as f64;
            let spread: f64 = gradients.iter().map(|gradient| gradient * gradient).sum();
            let standard_error = (spread * blocks / (blocks - 1.0)).sqrt() / hessian;
            return Some((sensor.delay_secs, standard_error));
        }
    }
    None
}

/// With `X_i = exp(delay w_i) color_from_depth`, the colour camera should move by `X_2 D X_1^-1` where
/// the depth sensor moves by `D`. The residual is the left perturbation that is left over; the
/// derivative is exact where that is zero.
fn row(motion: &SensorMotion, sensor: &DepthSensor) -> Row {
    let [first, second] = motion.velocities.map(|w| sensor.color_from_depth(&w));
    let predicted = second * motion.depth_second_from_first * first.inverse();
    let [w_first, w_second] = motion.velocities;
    Row {
        residual: (predicted * motion.color_second_from_first.inverse()).log(),
        by_delay: w_second - adjoint(&predicted) * w_first,
    }
}

/// The residuals' weighted mean square, and the least noise.
fn scatter(rows: &[Row], weight: impl Fn(&Vector6<f64>) -> f64) -> Matrix6<f64> {
    let squares = rows
        .iter()
        .map(|row| weight(&row.residual) * row.residual * row.residual.transpose());
    let least = Matrix6::identity() * (MIN_NOISE * MIN_NOISE);
    squares.sum::<Matrix6<f64>>() / rows.len() as f64 + least
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
#[path = "depth_delay_tests.rs"]
mod tests;
