//! Registration by Gauss-Newton, with the correspondences updated in every iteration (paper Sec.
//! III-B).
//!
//! Gauss-Newton is preferred to Levenberg-Marquardt for three reasons. The correspondences change
//! with every step, so comparing costs across steps does not tell whether a step was good. The
//! floor on the covariances keeps the system well-posed even on a single plane. Steps are
//! centimetres at most, where the linearisation is accurate.
//! Invariant: the result is bit-identical for any number of threads.

use fgs_geom::{Se3, dispatch};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::registration::pair_batch::PairBatch;
use crate::registration::{AlignError, Alignment, Conditioning, LinearSystem, Settings};
use crate::target::LastingNearest;
use crate::{Point, PointMap};

/// Points per parallel task. Fixed, so that the order of summation does not depend on the number of
/// threads.
const CHUNK_POINTS: usize = 1024;

/// How far a search looks beyond the nearest point, as a fraction of the correspondence distance.
/// The correspondence then stays valid while the query moves by up to half this margin. A larger
/// margin makes the first search expensive.
const MARGIN: f32 = 0.05;

/// Size of the subsample that is aligned first.
const SAMPLE_POINTS: usize = 1000;

/// Maximum number of iterations on the subsample before it is abandoned.
const MAX_SAMPLE_ITERATIONS: usize = 10;

/// Three non-collinear points determine a rigid motion.
const MIN_PAIRS: usize = 3;

/// Below this RMS radius the points do not constrain rotation: rounding of their `f32` positions
/// reaches a hundredth of it.
const MIN_RADIUS_M: f64 = 1e-4;

/// Below this ratio of eigenvalues, a direction is constrained by rounding errors only.
const MIN_CONDITIONING: f64 = 1e-10;

/// The pose `target_from_source` that aligns the source with the target, starting from `initial`.
/// Failing to converge is not an error: see [`Alignment::converged`].
///
/// # Errors
/// Empty or non-finite input, and correspondences that do not determine the pose.
pub fn align(
    source: &[Point],
    target: &PointMap,
    initial: &Se3,
    settings: &Settings,
) -> Result<Alignment, AlignError> {
    check(source, target, initial)?;
    let start = align_sample(source, target, initial, settings);
    align_all(source, target, &start.unwrap_or(*initial), settings)
}

/// Pose from a subsample, accurate enough that all points then need only one or two iterations.
/// `None` if there are too few points to save time or the subsample does not converge.
fn align_sample(
    source: &[Point],
    target: &PointMap,
    initial: &Se3,
    settings: &Settings,
) -> Option<Se3> {
    let step = source.len() / SAMPLE_POINTS;
    if step < 2 {
        return None;
    }
    let sample: Vec<Point> = source.iter().step_by(step).copied().collect();
    // Smaller steps are below the accuracy of the subsample.
    let coarse = Settings::default();
    let settings = Settings {
        max_iterations: settings.max_iterations.min(MAX_SAMPLE_ITERATIONS),
        rotation_epsilon_rad: settings
            .rotation_epsilon_rad
            .max(coarse.rotation_epsilon_rad),
        translation_epsilon_m: settings
            .translation_epsilon_m
            .max(coarse.translation_epsilon_m),
        ..*settings
    };
    let alignment = align_all(&sample, target, initial, &settings).ok()?;
    alignment.converged.then_some(alignment.target_from_source)
}

/// Gauss-Newton over all points.
fn align_all(
    source: &[Point],
    target: &PointMap,
    initial: &Se3,
    settings: &Settings,
) -> Result<Alignment, AlignError> {
    let (centroid, radius_m) = extent(source);
    let mut target_from_source = *initial;
    let mut nearest = vec![LastingNearest::unknown(); source.len()];
    let mut iterations = 0;
    loop {
        let system = linearize(source, target, &target_from_source, settings, &mut nearest);
        iterations += 1;
        if system.pairs < MIN_PAIRS {
            return Err(AlignError::TooFewPairs {
                pairs: system.pairs,
                points: source.len(),
                max_distance_m: settings.max_correspondence_distance_m,
            });
        }
        let undetermined = AlignError::Undetermined {
            pairs: system.pairs,
        };
        let hessian = system.hessian();
        let conditioning = Conditioning::new(&hessian, &centroid, radius_m);
        if !(radius_m >= MIN_RADIUS_M && conditioning.weakest >= MIN_CONDITIONING) {
            return Err(undetermined);
        }
        let Some(cholesky) = hessian.cholesky() else {
            return Err(undetermined);
        };
        let step = -cholesky.solve(&system.gradient);
        if !step.iter().all(|value| value.is_finite()) {
            return Err(undetermined);
        }
        target_from_source = (target_from_source * Se3::exp(&step)).renormalized();
        let converged = step.fixed_rows::<3>(0).norm() <= settings.rotation_epsilon_rad
            && step.fixed_rows::<3>(3).norm() <= settings.translation_epsilon_m;
        if converged || iterations >= settings.max_iterations {
            return Ok(Alignment {
                target_from_source,
                converged,
                iterations,
                inliers: system.pairs,
                inlier_share: system.pairs as f64 / source.len() as f64,
                rms_residual_m: (system.squared_residual / system.weight).sqrt(),
                conditioning,
                hessian,
                residual_variance: system.cost / (system.weight - 6.0).max(1.0),
            });
        }
    }
}

fn check(source: &[Point], target: &PointMap, initial: &Se3) -> Result<(), AlignError> {
    if source.is_empty() {
        return Err(AlignError::EmptySource);
    }
    if target.is_empty() {
        return Err(AlignError::EmptyTarget);
    }
    if let Some(index) = source.iter().position(|point| !point.is_finite()) {
        return Err(AlignError::NonFiniteSource { index });
    }
    if !initial.matrix().iter().all(|value| value.is_finite()) {
        return Err(AlignError::NonFiniteStart);
    }
    Ok(())
}

/// The normal equations at a pose, with updated correspondences.
fn linearize(
    source: &[Point],
    target: &PointMap,
    target_from_source: &Se3,
    settings: &Settings,
    nearest: &mut [LastingNearest],
) -> LinearSystem {
    let rotation = target_from_source
        .rotation
        .to_rotation_matrix()
        .into_inner();
    let translation = target_from_source.translation;
    let partial: Vec<LinearSystem> = source
        .par_chunks(CHUNK_POINTS)
        .zip(nearest.par_chunks_mut(CHUNK_POINTS))
        .map(|(source, nearest)| {
            linearize_chunk(source, target, &rotation, &translation, settings, nearest)
        })
        .collect();
    let mut system = LinearSystem::zero();
    partial.iter().for_each(|part| system += part);
    system
}

fn linearize_chunk(
    source: &[Point],
    target: &PointMap,
    rotation: &Matrix3<f64>,
    translation: &Vector3<f64>,
    settings: &Settings,
    nearest: &mut [LastingNearest],
) -> LinearSystem {
    dispatch(LinearizeChunk {
        source,
        target,
        rotation,
        translation,
        settings,
        nearest,
    })
}

/// Finds the correspondences and accumulates them, compiled for each instruction set.
struct LinearizeChunk<'a> {
    source: &'a [Point],
    target: &'a PointMap,
    rotation: &'a Matrix3<f64>,
    translation: &'a Vector3<f64>,
    settings: &'a Settings,
    nearest: &'a mut [LastingNearest],
}

impl fgs_geom::Kernel for LinearizeChunk<'_> {
    type Output = LinearSystem;

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) -> LinearSystem {
        let max_distance_m = self.settings.max_correspondence_distance_m;
        let margin_m = MARGIN * max_distance_m;
        for (point, nearest) in self.source.iter().zip(&mut *self.nearest) {
            let position = point.position.cast::<f64>();
            let query = (self.rotation * position + self.translation).cast::<f32>();
            if !nearest.holds_at(&query) {
                *nearest = self
                    .target
                    .lasting_nearest(&query, max_distance_m, margin_m);
            }
        }
        // A register holds half as many f64 as f32. Stable Rust cannot derive one const argument
        // from another, hence the branch.
        if WIDTH == 16 {
            self.sum::<8>()
        } else {
            self.sum::<4>()
        }
    }
}

impl LinearizeChunk<'_> {
    /// Accumulates the correspondences, `LANES` at a time.
    #[inline(always)]
    fn sum<const LANES: usize>(self) -> LinearSystem {
        let mut batch =
            PairBatch::<LANES>::new(self.rotation, self.translation, self.settings.kernel);
        for (point, nearest) in self.source.iter().zip(self.nearest) {
            if let Some(slot) = nearest.slot {
                batch.push(point, self.target.point_in(slot));
            }
        }
        batch.finish()
    }
}

/// Centroid of the points and their RMS distance from it.
fn extent(source: &[Point]) -> (Vector3<f64>, f64) {
    let n = source.len() as f64;
    let positions = source.iter().map(|point| point.position.cast::<f64>());
    let centroid = positions.clone().sum::<Vector3<f64>>() / n;
    let variance = positions
        .map(|p| (p - centroid).norm_squared())
        .sum::<f64>()
        / n;
    (centroid, variance.sqrt())
}

#[cfg(test)]
#[path = "align_tests.rs"]
mod tests;

#[cfg(test)]
#[path = "information_tests.rs"]
mod information_tests;
