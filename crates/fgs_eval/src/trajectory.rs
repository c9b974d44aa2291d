//! Absolute and relative trajectory error (J. Sturm et al., "A benchmark for the evaluation of
//! RGB-D SLAM systems", 2012), with the same results as `evo`.
//!
//! Input: estimated and reference poses `world_from_camera`, paired by index. What the paper
//! reports as "ATE RMSE" is the mean in its code.

use fgs_geom::Se3;
use nalgebra::Vector3;

use crate::{EvalError, Statistics, align_positions};

/// Beyond this distance from the origin squares of squares would overflow long before any recording
/// reaches it.
const MAX_COORDINATE_M: f64 = 1e9;

/// Fewer positions can be aligned almost perfectly whatever they are.
const MIN_POSES_TO_ALIGN: usize = 3;

/// Absolute trajectory error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ate {
    /// Distances between aligned estimated and reference positions, metres.
    pub translation_m: Statistics,
    /// The rigid alignment (no scale) that was applied.
    pub reference_from_estimated: Se3,
}

/// Relative pose error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rpe {
    /// Translation part of the errors, metres over the frame delta.
    pub translation_m: Statistics,
    /// Rotation angle of the errors, degrees over the frame delta.
    pub rotation_deg: Statistics,
}

/// Absolute trajectory error after least-squares rigid alignment of the positions. For straight or
/// stationary trajectories the alignment is not unique, but the error is ([`align_positions`]).
///
/// # Errors
/// For lists of unequal length, fewer than 3 poses, and values out of range.
pub fn ate(estimated: &[Se3], reference: &[Se3]) -> Result<Ate, EvalError> {
    check(estimated, reference, MIN_POSES_TO_ALIGN)?;
    let positions = |poses: &[Se3]| -> Vec<Vector3<f64>> {
        poses.iter().map(|pose| pose.translation).collect()
    };
    let (estimated, reference) = (positions(estimated), positions(reference));
    let reference_from_estimated = align_positions(&estimated, &reference);
    let errors_m = (estimated.iter().zip(&reference))
        .map(|(e, r)| (reference_from_estimated.transform(e) - r).norm())
        .collect();
    Ok(Ate {
        translation_m: summary(errors_m, MIN_POSES_TO_ALIGN)?,
        reference_from_estimated,
    })
}

/// Relative pose error over all pose pairs `(i, i + delta)`, `delta` in frames: the difference
/// between estimated and reference relative motion.
///
/// # Errors
/// For lists of unequal length, a delta of 0, no more than `delta` poses, and values out of range.
pub fn rpe(estimated: &[Se3], reference: &[Se3], delta: usize) -> Result<Rpe, EvalError> {
    if delta == 0 {
        return Err(EvalError::ZeroDelta);
    }
    let minimum = delta.saturating_add(1);
    check(estimated, reference, minimum)?;
    let motions = |poses: &[Se3]| -> Vec<Se3> {
        let pairs = poses.iter().zip(&poses[delta..]);
        pairs.map(|(from, to)| from.inverse() * *to).collect()
    };
    let errors: Vec<Se3> = (motions(reference).iter().zip(motions(estimated)))
        .map(|(reference, estimated)| reference.inverse() * estimated)
        .collect();
    let translations_m = errors.iter().map(|e| e.translation.norm()).collect();
    let rotations_deg = errors
        .iter()
        .map(|e| e.rotation.angle().to_degrees())
        .collect();
    Ok(Rpe {
        translation_m: summary(translations_m, minimum)?,
        rotation_deg: summary(rotations_deg, minimum)?,
    })
}

fn summary(errors: Vec<f64>, minimum: usize) -> Result<Statistics, EvalError> {
    Statistics::of(errors).ok_or(EvalError::TooFewPoses { poses: 0, minimum })
}

fn check(estimated: &[Se3], reference: &[Se3], minimum: usize) -> Result<(), EvalError> {
    if estimated.len() != reference.len() {
        return Err(EvalError::UnequalLengths {
            estimated: estimated.len(),
            reference: reference.len(),
        });
    }
    if estimated.len() < minimum {
        return Err(EvalError::TooFewPoses {
            poses: estimated.len(),
            minimum,
        });
    }
    for (trajectory, poses) in [("estimated", estimated), ("reference", reference)] {
        let in_range = |pose: &Se3| {
            let coordinates = pose.translation.iter().all(|x| x.abs() <= MAX_COORDINATE_M);
            coordinates && pose.rotation.coords.iter().all(|x| x.is_finite())
        };
        if let Some(index) = poses.iter().position(|pose| !in_range(pose)) {
            return Err(EvalError::PoseOutOfRange { trajectory, index });
        }
    }
    Ok(())
}
