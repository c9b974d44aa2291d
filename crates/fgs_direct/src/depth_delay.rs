//! Time offset between depth and colour images, estimated from the motions of both sensors.
//!
//! Input: pairs of frames whose relative motion was measured twice, by registering their depth
//! images and by aligning their colour images. Output: the delay for which both are motions of the
//! same rigid body. Gauss-Newton with robust weights from a multivariate Student's t distribution.
//! Its covariance is estimated jointly, since registration errors are up to ten times larger in
//! some directions than in others.
//!
//! The extrinsics between the sensors are taken as given. The motions constrain them only as far as
//! the camera rotates between the frames (hand-eye calibration): an image shift of one pixel
//! changes a motion of ten degrees by a sixth of a pixel, which is less than the bias of
//! registration.

use fgs_geom::{DepthSensor, Se3};
use nalgebra::{Matrix6, Vector6};

use crate::TimeEstimate;
use crate::time_estimate::{MIN_MEASUREMENTS, Parabola};

/// Maximum number of Gauss-Newton steps. Five are typical; some dozens are needed where it is
/// unclear whether a few motions are outliers.
const MAX_ITERATIONS: usize = 100;

/// Converged when the delay changes by less than this, seconds.
const MAX_LAST_STEP: f64 = 1e-6;

/// Degrees of freedom of Student's t distribution. With fewer, the fastest motions are treated as
/// outliers: they carry most information about the delay but have the largest errors.
const STUDENT: f64 = 10.0;

/// Number of updates of the covariance per step.
const COVARIANCE_ITERATIONS: usize = 5;

/// Lower bound on the registration error, rad and metres.
const MIN_NOISE: f64 = 1e-5;

/// The motion between two frames, as measured by both sensors.
#[derive(Clone, Debug)]
pub struct SensorMotion {
    /// Motion between the depth images, in the depth sensor frame.
    pub depth_second_from_first: Se3,
    /// Motion between the colour images, in the colour camera frame.
    pub color_second_from_first: Se3,
    /// Twist `[omega, v]` of the colour camera at the time of each image, in its own frame, rad/s
    /// and m/s. Its errors must be far smaller than the change of velocity between the frames,
    /// otherwise the delay is underestimated.
    pub velocities: [Vector6<f64>; 2],
}

/// The delay of a depth sensor with known extrinsics that best explains the motions, which must be
/// in temporal order. The search starts at the delay of `given`. `None` if there are too few
/// motions or if they do not constrain the delay at all, as at rest and at constant velocity.
pub fn depth_delay(motions: &[SensorMotion], given: &DepthSensor) -> Option<TimeEstimate> {
    if motions.len() < MIN_MEASUREMENTS {
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
        let parabola = |Row { residual, by_delay }: &Row| {
            let weighted = student_weight(residual, &information) * information * by_delay;
            Parabola {
                slope: weighted.dot(residual),
                curvature: weighted.dot(by_delay),
            }
        };
        let parabolas: Vec<_> = rows.iter().map(parabola).collect();
        let step = Parabola::sum(&parabolas).step();
        if !step.is_finite() {
            return None;
        }
        sensor.delay_secs += step;
        if step.abs() <= MAX_LAST_STEP {
            return Some(TimeEstimate::at_minimum(sensor.delay_secs, &parabolas));
        }
    }
    None
}

/// Residual between predicted and measured motion of the colour camera, and its derivative with
/// respect to the delay.
struct Row {
    residual: Vector6<f64>,
    by_delay: Vector6<f64>,
}

/// With `X_i = exp(delay w_i) color_from_depth`, the colour camera should move by `X_2 D X_1^-1`
/// when the depth sensor moves by `D`. The residual is the left perturbation between prediction and
/// measurement; the derivative is exact where the residual is zero.
fn row(motion: &SensorMotion, sensor: &DepthSensor) -> Row {
    let [first, second] = motion.velocities.map(|w| sensor.color_from_depth(&w));
    let predicted = second * motion.depth_second_from_first * first.inverse();
    let [w_first, w_second] = motion.velocities;
    Row {
        residual: (predicted * motion.color_second_from_first.inverse()).log(),
        by_delay: w_second - predicted.adjoint() * w_first,
    }
}

/// Weighted second moment of the residuals, plus the noise floor.
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

#[cfg(test)]
#[path = "depth_delay_tests.rs"]
mod tests;
