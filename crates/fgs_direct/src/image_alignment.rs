//! The motion between two colour images, from points of the first whose depth is known.
//!
//! Input: points in the axes of the first camera, and a start. Output: the motion after which the
//! points are as bright in the second image as in the first, up to a gain and an offset that are
//! estimated along with it. Gauss-Newton with Cauchy weights at the measured noise, from the
//! coarsest resolution to the finest.

use fgs_geom::Se3;
use nalgebra::{Matrix6, SMatrix, SVector, Vector3, Vector6};

use crate::{IntensityImage, IntensityPyramid};

type Vector8 = SVector<f64, 8>;
type Matrix8 = SMatrix<f64, 8, 8>;

/// Steps at the finest resolution. Noise adds to the gradients' squares, so steps are too short; most
/// images take 5 to 20.
const MAX_ITERATIONS: usize = 60;

/// Steps at each of the others, which only provide a start.
const MAX_COARSE_ITERATIONS: usize = 8;

/// Converged when a step turns by less, rad, ...
const MAX_LAST_TURN: f64 = 1e-4;

/// ... and moves by less, metres. Smaller steps may go to and fro for ever: brightness between pixels
/// has kinks.
const MAX_LAST_SHIFT: f64 = 3e-4;

/// Fewer points than this do not determine motion, gain and offset.
const MIN_POINTS: usize = 50;

/// Half a step of 8-bit images: residuals are not smaller than this.
const MIN_NOISE: f64 = 0.5 / 255.0;

/// Residual of half weight, in standard deviations: 95 % efficient for Gaussian noise.
const CAUCHY: f64 = 2.385;

/// Where two images agree best.
#[derive(Clone, Debug)]
pub struct ImageAlignment {
    /// From the axes of the first camera to those of the second.
    pub second_from_first: Se3,
    /// Its inverse covariance under left perturbations, `[omega, v]` in the second camera's axes (rad,
    /// metres), if the points' residuals are independent.
    pub information: Matrix6<f64>,
    /// Standard deviation of the residuals, brightness from 0 to 1.
    pub noise: f64,
}

/// Gauss-Newton's normal equations for `[omega, v, gain, offset]`.
struct NormalEquations {
    hessian: Matrix8,
    gradient: Vector8,
    noise: f64,
}

#[derive(Clone, Copy)]
struct State {
    second_from_first: Se3,
    gain: f64,
    offset: f64,
}

/// Aligns `points`, in the axes of the first camera, with the second image, starting from the motion
/// `start`. `None` if too few points are seen in both images, if they determine no motion, or if the
/// search does not settle.
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

/// Residual `second - gain * first - offset` of a point that was as bright as `brightness`, and its
/// derivatives; `None` where the second image does not show it.
#[inline]
fn row(
    point: &Vector3<f64>,
    brightness: f64,
    second: &IntensityImage,
    state: &State,
) -> Option<(f64, Vector8)> {
    let y = state.second_from_first.transform(point);
    let pixel = second.camera.project(&y)?;
    let [value, du, dv] = second.sample(pixel.x, pixel.y)?.map(f64::from);
    let k = second.camera.intrinsics;
    let (gx, gy) = (du * k.fx / y.z, dv * k.fy / y.z);
    let by_point = Vector3::new(gx, gy, -(gx * y.x + gy * y.y) / y.z);
    let turn = y.cross(&by_point);
    let jacobian = Vector8::from([
        turn.x,
        turn.y,
        turn.z,
        by_point.x,
        by_point.y,
        by_point.z,
        -brightness,
        -1.0,
    ]);
    Some((value - state.gain * brightness - state.offset, jacobian))
}

fn linearize(
    points: &[(Vector3<f64>, f64)],
    second: &IntensityImage,
    state: &State,
) -> Option<NormalEquations> {
    let rows: Vec<(f64, Vector8)> = points
        .iter()
        .filter_map(|(point, brightness)| row(point, *brightness, second, state))
        .collect();
    if rows.len() < MIN_POINTS {
        return None;
    }
    let mut sizes: Vec<f64> = rows.iter().map(|(residual, _)| residual.abs()).collect();
    let middle = sizes.len() / 2;
    let median = *sizes.select_nth_unstable_by(middle, f64::total_cmp).1;
    // The standard deviation of Gaussian noise with this median.
    let noise = (1.4826 * median).max(MIN_NOISE);
    let mut hessian = Matrix8::zeros();
    let mut gradient = Vector8::zeros();
    for (residual, jacobian) in &rows {
        let weight = 1.0 / (1.0 + (residual / (CAUCHY * noise)).powi(2)) / (noise * noise);
        hessian.syger(weight, jacobian, jacobian, 1.0);
        gradient += weight * *residual * jacobian;
    }
    hessian.fill_upper_triangle_with_lower_triangle();
    Some(NormalEquations {
        hessian,
        gradient,
        noise,
    })
}

#[cfg(test)]
#[path = "image_alignment_tests.rs"]
mod tests;
