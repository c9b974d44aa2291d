//! The relative pose of two colour images, from points of the first with known depth.
//!
//! Input: points in the frame of the first camera and an initial motion. Output: the motion that
//! minimises the photometric residuals between the two images, estimated jointly with gain and
//! offset. Gauss-Newton with Cauchy weights scaled by the estimated noise, from the coarsest
//! pyramid level to the finest.

use fgs_geom::Se3;
use nalgebra::{Matrix6, SVector, Vector3, Vector6};

use crate::normal_equations::NormalEquations;
use crate::residual;
use crate::{IntensityImage, IntensityPyramid};

type Vector8 = SVector<f64, 8>;

/// Maximum number of steps at the finest level. Image noise adds to the squared gradients and so
/// makes the steps too short; most images take 5 to 20.
const MAX_ITERATIONS: usize = 60;

/// Maximum number of steps at each coarser level, which only provides a start for the next.
const MAX_COARSE_ITERATIONS: usize = 8;

/// Converged when the rotation of a step is below this, rad, ...
const MAX_LAST_TURN: f64 = 1e-4;

/// ... and its translation is below this, metres. Smaller steps may oscillate forever, since
/// bilinear interpolation has kinks.
const MAX_LAST_SHIFT: f64 = 3e-4;

/// Half a quantisation step of 8-bit images: a floor on the noise of the residuals.
pub(crate) const MIN_NOISE: f64 = 0.5 / 255.0;

/// Result of aligning two images.
#[derive(Clone, Debug)]
pub struct ImageAlignment {
    /// Maps the first camera frame to the second.
    pub second_from_first: Se3,
    /// Information matrix for left perturbations, `[omega, v]` in the second camera frame (rad,
    /// metres), assuming that the residuals of the points are independent.
    pub information: Matrix6<f64>,
    /// Standard deviation of the residuals, brightness from 0 to 1.
    pub noise: f64,
}

#[derive(Clone, Copy)]
struct State {
    second_from_first: Se3,
    gain: f64,
    offset: f64,
}

/// Aligns `points`, given in the first camera frame, with the second image, starting from the
/// motion `start`. `None` if too few points are visible in both images, if they do not determine
/// the motion, or if the iteration does not converge.
pub fn align_images(
    first: &IntensityPyramid,
    second: &IntensityPyramid,
    points: &[Vector3<f64>],
    start: &Se3,
) -> Option<ImageAlignment> {
    let mut state = State {
        second_from_first: *start,
        gain: 1.0,
        offset: 0.0,
    };
    let mut last = None;
    let levels = first.levels.iter().zip(&second.levels);
    for (level, (first, second)) in levels.enumerate().rev() {
        let max_iterations = match level {
            0 => MAX_ITERATIONS,
            _ => MAX_COARSE_ITERATIONS,
        };
        let seen: Vec<(Vector3<f64>, f64)> = points
            .iter()
            .filter_map(|point| {
                let pixel = first.camera.project(point)?;
                let [brightness, ..] = first.sample(pixel.x, pixel.y)?;
                Some((*point, f64::from(brightness)))
            })
            .collect();
        last = None;
        for _ in 0..max_iterations {
            let equations = linearize(&seen, second, &state)?;
            let step = -equations.hessian.cholesky()?.solve(&equations.gradient);
            if !step.iter().all(|value| value.is_finite()) {
                return None;
            }
            let motion: Vector6<f64> = step.fixed_rows::<6>(0).into_owned();
            state.second_from_first = (Se3::exp(&motion) * state.second_from_first).renormalized();
            state.gain += step[6];
            state.offset += step[7];
            let (turn, shift) = (motion.fixed_rows::<3>(0), motion.fixed_rows::<3>(3));
            if turn.amax() <= MAX_LAST_TURN && shift.amax() <= MAX_LAST_SHIFT {
                last = Some(equations);
                break;
            }
        }
    }
    let NormalEquations { hessian, noise, .. } = last?;
    let mixed = hessian.fixed_view::<6, 2>(0, 6);
    let eliminated = mixed * hessian.fixed_view::<2, 2>(6, 6).try_inverse()? * mixed.transpose();
    Some(ImageAlignment {
        second_from_first: state.second_from_first,
        information: hessian.fixed_view::<6, 6>(0, 0) - eliminated,
        noise,
    })
}

/// Photometric residual `second - gain * first - offset` of a point with brightness `brightness` in
/// the first image, and its derivatives; `None` if the point is not visible in the second image.
#[inline]
fn row(
    point: &Vector3<f64>,
    brightness: f64,
    second: &IntensityImage,
    state: &State,
) -> Option<(f64, Vector8)> {
    let (value, by_pose) = residual::brightness(second, &state.second_from_first.transform(point))?;
    // Perturbed from the left, the motion moves the point the other way than the camera's pose does.
    let mut jacobian = Vector8::zeros();
    jacobian.fixed_rows_mut::<6>(0).copy_from(&-by_pose);
    (jacobian[6], jacobian[7]) = (-brightness, -1.0);
    Some((value - state.gain * brightness - state.offset, jacobian))
}

/// Normal equations for `[omega, v, gain, offset]`.
fn linearize(
    points: &[(Vector3<f64>, f64)],
    second: &IntensityImage,
    state: &State,
) -> Option<NormalEquations<8>> {
    let rows: Vec<(f64, Vector8)> = points
        .iter()
        .filter_map(|(point, brightness)| row(point, *brightness, second, state))
        .collect();
    NormalEquations::robust(&rows, MIN_NOISE)
}

#[cfg(test)]
#[path = "image_alignment_tests.rs"]
mod tests;
