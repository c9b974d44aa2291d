//! The time that a camera takes to read its rows, from pairs of its images.
//!
//! With a readout of `r` seconds and the camera's twist `w`, a point `p` in the camera's axes when
//! row `v` was read is `exp(r s w) p` in its axes when the middle row was, with
//! `s = row_delay_secs(v, height, 1)`. Between rows `v1` and `v2` of two images it moves to
//!
//! `q = exp(-r s2 w2) T exp(r s1 w1) p`
//!
//! where `T` is the motion between both middle rows. Each pair has a motion and perhaps other unknowns
//! of its own; the readout is shared by all. Gauss-Newton, in which each pair's own unknowns are
//! eliminated. With constant velocity both images are distorted alike, so only pairs between whose
//! images the velocity changes tell anything.

use fgs_geom::{Camera, Se3, row_delay_secs};
use nalgebra::{Matrix3, SVector, Vector2, Vector3, Vector6};
use rayon::prelude::*;

use crate::TimeEstimate;
use crate::normal_equations::NormalEquations;
use crate::time_estimate::{MIN_MEASUREMENTS, Parabola};

/// Maximum number of Gauss-Newton steps.
const MAX_ITERATIONS: usize = 40;

/// Converged when the readout changes by less than this, seconds.
const MAX_LAST_STEP: f64 = 2e-5;

/// No camera takes longer, seconds.
const MAX_READOUT_SECS: f64 = 0.2;

/// The row that sees a point depends on where the camera was when it read that row. After two rounds the
/// error is far below a hundredth of a pixel.
const ROUNDS: usize = 2;

/// When a row was read, and the camera's axes then.
#[derive(Clone, Copy)]
pub(crate) struct Row {
    /// When it was read, after the middle row and as a share of the readout.
    delay: f64,
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

impl Row {
    /// The rows of an image taken at a velocity `[omega, v]`, rad/s and m/s.
    pub(crate) fn all(height: usize, velocity: &Vector6<f64>, readout_secs: f64) -> Vec<Self> {
        let row = |v| {
            let delay = row_delay_secs(v, height, 1.0);
            let middle_from_row = Se3::exp(&(delay * readout_secs * velocity));
            Self {
                delay,
                rotation: *middle_from_row.rotation.to_rotation_matrix().matrix(),
                translation: middle_from_row.translation,
            }
        };
        (0..height).map(row).collect()
    }

    /// From the axes of this row to those of the middle row.
    #[inline]
    pub(crate) fn in_middle(self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// From the axes of the middle row to those of this row.
    #[inline]
    pub(crate) fn of_middle(self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation.tr_mul(&(point - self.translation))
    }
}

/// Where the camera sees a point that is given in the axes of its middle row.
#[inline]
pub(crate) fn pixel(middle: &Vector3<f64>, rows: &[Row], camera: &Camera) -> Option<Vector2<f64>> {
    let mut pixel = camera.project(middle)?;
    for _ in 0..ROUNDS {
        let row = rows.get(nearest_row(pixel.y, rows.len()))?;
        pixel = camera.project(&row.of_middle(middle))?;
    }
    Some(pixel)
}

/// Of `height` rows.
#[inline]
pub(crate) fn nearest_row(y: f64, height: usize) -> usize {
    (y.round().max(0.0) as usize).min(height.saturating_sub(1))
}

/// The motion between two images, and the camera's twists at both.
#[derive(Clone, Debug)]
pub(crate) struct RollingMotion {
    pub second_from_first: Se3,
    /// `[omega, v]` in the camera's own axes at the time of each image, rad/s and m/s.
    pub velocities: [Vector6<f64>; 2],
}

/// Derivatives of what depends on `q`.
pub(crate) struct RollingJacobian {
    /// By the motion, perturbed from the left.
    pub by_motion: Vector6<f64>,
    /// By the readout; as if the rows did not depend on it.
    pub by_readout: f64,
}

impl RollingMotion {
    /// `middle` is the point in the axes of the second image's middle row, `by_point` the derivative by
    /// the point `q` in those of its own row.
    #[inline]
    pub(crate) fn jacobian(
        &self,
        rows: [&Row; 2],
        first_velocity_in_second: &Vector6<f64>,
        middle: &Vector3<f64>,
        by_point: &Vector3<f64>,
    ) -> RollingJacobian {
        let [first, second] = rows;
        let along = second.rotation * by_point;
        let around = middle.cross(&along);
        let by_motion = Vector6::new(around.x, around.y, around.z, along.x, along.y, along.z);
        let twist = first.delay * first_velocity_in_second - second.delay * self.velocities[1];
        RollingJacobian {
            by_motion,
            by_readout: by_motion.dot(&twist),
        }
    }

    /// The twist at the first image in the axes of the second.
    pub(crate) fn first_velocity_in_second(&self) -> Vector6<f64> {
        self.second_from_first.adjoint() * self.velocities[0]
    }

    /// Moves on by a left perturbation.
    pub(crate) fn perturb(&mut self, motion: &Vector6<f64>) {
        self.second_from_first = (Se3::exp(motion) * self.second_from_first).renormalized();
    }
}

/// Where the unknowns of a pair should go.
struct Solution<const N: usize> {
    /// The pair's error over the readout, its other unknowns being at their best.
    parabola: Parabola,
    /// The step for this pair alone.
    step: SVector<f64, N>,
    /// How the step depends on that of the readout.
    by_readout: SVector<f64, N>,
}

impl<const N: usize> Solution<N> {
    fn of(equations: &NormalEquations<N>) -> Option<Self> {
        let covariance = equations.hessian.cholesky()?.inverse();
        let variance = covariance[(N - 1, N - 1)];
        let step = -(covariance * equations.gradient);
        let by_readout = covariance.column(N - 1) / variance;
        let is_finite = step
            .iter()
            .chain(&by_readout)
            .all(|value| value.is_finite());
        is_finite.then(|| Self {
            parabola: Parabola {
                slope: -step[N - 1] / variance,
                curvature: 1.0 / variance,
            },
            step,
            by_readout,
        })
    }
}

/// Two images of a camera with `N - 1` unknowns of their own.
pub(crate) trait Pair<const N: usize>: Send + Sync {
    /// The last unknown is the readout. `None` if the pair tells nothing.
    fn linearize(&self, readout_secs: f64) -> Option<NormalEquations<N>>;

    /// Moves the pair's own unknowns.
    fn step(&mut self, step: &SVector<f64, N>);
}

/// The readout that best explains the pairs, which are in temporal order and take their own unknowns
/// from it. `None` if too few tell anything.
pub(crate) fn fit<const N: usize>(
    pairs: &mut [impl Pair<N>],
    start_secs: f64,
) -> Option<TimeEstimate> {
    let mut readout_secs = start_secs;
    for _ in 0..MAX_ITERATIONS {
        let solve = |pair: &_| Solution::of(&Pair::linearize(pair, readout_secs)?);
        let solutions: Vec<_> = pairs.par_iter().map(solve).collect();
        let parabolas: Vec<_> = solutions.iter().flatten().map(|one| one.parabola).collect();
        let step = Parabola::sum(&parabolas).step();
        readout_secs += step;
        let is_possible = (-MAX_READOUT_SECS..=MAX_READOUT_SECS).contains(&readout_secs);
        if parabolas.len() < MIN_MEASUREMENTS || !is_possible {
            return None;
        }
        for (pair, solution) in pairs.iter_mut().zip(solutions) {
            if let Some(Solution {
                step: own,
                by_readout,
                ..
            }) = solution
            {
                pair.step(&(own + by_readout * (step - own[N - 1])));
            }
        }
        if step.abs() <= MAX_LAST_STEP {
            return Some(TimeEstimate::at_minimum(readout_secs, &parabolas));
        }
    }
    None
}

#[cfg(test)]
#[path = "readout_tests.rs"]
mod tests;
