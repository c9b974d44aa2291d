//! Sparse Adam (Kingma and Ba 2015): updates only the gaussians that a step touches.
//!
//! Entry i of the state belongs to gaussian i. Textbook Adam moves every parameter at every step, by
//! momentum alone where the gradient is zero. Here a gaussian that is not touched keeps its
//! parameters and moments: otherwise gaussians out of view would drift, and a step's cost would grow
//! with the map.
//!
//! Each gaussian counts its own steps. Its bias correction and its learning rates depend on that
//! count, so that the old parts of a growing map settle while the new ones still fit quickly.

use crate::gaussians::retain;
use crate::kernel::{Kernel, dispatch};
use crate::rigid_motion::{RigidMotion, squared, transformed};
use crate::{GaussianGradient, GaussianGradients, Gaussians, SettingError};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::LazyLock;
use thiserror::Error;

/// Decay of the first moment (Kingma and Ba 2015).
pub(crate) const BETA_1: f64 = 0.9;
/// Decay of the second moment (Kingma and Ba 2015).
pub(crate) const BETA_2: f64 = 0.999;
/// Learning rates decay as `1 / sqrt(1 + t / DECAY_STEPS)` with a gaussian's step count `t`, slowly
/// enough for Adam to converge (Kingma and Ba 2015, Theorem 4.1); those of the centres as the square
/// of that, since a centre that keeps moving undoes what the other parameters have learnt. A gaussian
/// is fitted after a few dozen steps; later gradients mostly reflect differences between views.
pub(crate) const DECAY_STEPS: f64 = 50.0;
/// Far below any gradient. The loss is a mean over a million values, so gradients around the
/// customary 1e-8 are common, and it would damp them.
pub(crate) const EPSILON: f32 = 1e-15;
/// Steps whose corrections are tabulated: more than most gaussians ever take.
const TABLED_STEPS: u32 = 1 << 14;
/// Gaussians per task, for any number of threads.
const CHUNK: usize = 4096;

/// Learning rates: how far a parameter of a new gaussian moves per step under a constant gradient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearningRates {
    /// Of the centres, metres.
    pub means: f32,
    /// Of the components of the quaternions.
    pub quats: f32,
    /// Of the logarithms of the scales.
    pub log_scales: f32,
    /// Of the opacity logits.
    pub opacity_logits: f32,
    /// Of the colours, as spherical harmonics of degree 0.
    pub sh: f32,
}

impl Default for LearningRates {
    /// Differs from the paper, whose code has 2.5e-6 for the means, 5e-3 for the log-scales, 0.05
    /// for the opacities, 1e-2 for the quaternions and 3.5e-3 for the colours, all constant: at few
    /// steps per frame, centres stay where noise put them and colours do not converge; at many, the
    /// map does not settle.
    fn default() -> Self {
        Self {
            means: 4e-4,
            quats: 2e-2,
            log_scales: 3e-2,
            opacity_logits: 0.1,
            sh: 2e-2,
        }
    }
}

impl LearningRates {
    /// Checks the limits.
    ///
    /// # Errors
    /// If a rate is outside 0..=1.
    pub fn validate(&self) -> Result<(), SettingError> {
        SettingError::unless_share("means", self.means.into())?;
        SettingError::unless_share("quats", self.quats.into())?;
        SettingError::unless_share("log_scales", self.log_scales.into())?;
        SettingError::unless_share("opacity_logits", self.opacity_logits.into())?;
        SettingError::unless_share("sh", self.sh.into())
    }
}

/// Why no step was taken.
#[derive(Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum AdamError {
    /// The state is for another number of gaussians, or gradients are missing or superfluous.
    #[error(
        "Adam's inputs disagree: state of {adam} gaussians, {gaussians} gaussians, {touched} touched \
         ones, {gradients} gradients"
    )]
    Length {
        /// Entries of the state.
        adam: usize,
        /// Number of gaussians.
        gaussians: usize,
        /// Number of touched gaussians.
        touched: usize,
        /// Number of gradients.
        gradients: usize,
    },
    /// Touched indices are not strictly ascending, or not below the number of gaussians.
    #[error("touched indices must be strictly ascending and below {gaussians}")]
    Touched {
        /// Number of gaussians.
        gaussians: usize,
    },
}

/// A gaussian's 14 parameters, padded to a cache line of `f32`.
const PLACES: usize = 16;

/// A value for each parameter of a gaussian: centre, quaternion, log-scales, opacity logit and
/// colour, then zeros.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[repr(align(64))]
pub(crate) struct ByParameter(pub(crate) [f32; PLACES]);

impl ByParameter {
    #[inline(always)]
    fn of(gradient: &GaussianGradient) -> Self {
        let [x, y, z] = gradient.d_mean;
        let [qw, qx, qy, qz] = gradient.d_quat;
        let [s0, s1, s2] = gradient.d_log_scales;
        let opacity = gradient.d_opacity_logit;
        let [r, g, b] = gradient.d_sh;
        Self([
            x, y, z, qw, qx, qy, qz, s0, s1, s2, opacity, r, g, b, 0.0, 0.0,
        ])
    }
}

/// Adam's state: first and second moments of every parameter, and each gaussian's step count.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Adam {
    pub(crate) first: Vec<ByParameter>,
    pub(crate) second: Vec<ByParameter>,
    pub(crate) steps: Vec<u32>,
}

impl Adam {
    /// Number of gaussians.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether there is no state.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Whether there is state of exactly `len` gaussians.
    pub(crate) fn has_len(&self, len: usize) -> bool {
        [self.first.len(), self.second.len(), self.steps.len()] == [len; 3]
    }

    /// Appends the state of `count` new gaussians.
    pub fn extend(&mut self, count: usize) {
        let len = self.len() + count;
        self.first.resize(len, ByParameter::default());
        self.second.resize(len, ByParameter::default());
        self.steps.resize(len, 0);
    }

    /// Appends the state of other gaussians.
    pub(crate) fn append(&mut self, other: Self) {
        self.first.extend(other.first);
        self.second.extend(other.second);
        self.steps.extend(other.steps);
    }

    /// Keeps the state of the gaussians i with `keep[i]`, in order.
    ///
    /// # Panics
    /// Unless there is one flag for each gaussian.
    pub fn retain(&mut self, keep: &[bool]) {
        retain(&mut self.first, keep);
        retain(&mut self.second, keep);
        retain(&mut self.steps, keep);
    }

    /// Rotates the moments of gaussian i along with it; see [`crate::rigid_motion`].
    pub(crate) fn turn(&mut self, i: usize, motion: &RigidMotion) {
        let RigidMotion { rotation, left, .. } = motion;
        for (moments, rotation, left) in [
            (&mut self.first, rotation, left),
            (&mut self.second, &squared(rotation), &squared(left)),
        ] {
            let moments = &mut moments[i].0;
            let [x, y, z, qw, qx, qy, qz, ..] = *moments;
            moments[..3].copy_from_slice(&transformed(rotation, &[x, y, z]));
            moments[3..7].copy_from_slice(&transformed(left, &[qw, qx, qy, qz]));
        }
    }

    /// Updates the touched gaussians.
    ///
    /// Those whose gradient has an entry that is not finite, or whose square overflows, are skipped,
    /// their state too. Returns their number.
    ///
    /// # Errors
    /// If lengths differ, or `touched` is not strictly ascending or has an index out of range.
    pub fn step(
        &mut self,
        gaussians: &mut Gaussians,
        gradients: &GaussianGradients,
        rates: &LearningRates,
    ) -> Result<usize, AdamError> {
        let GaussianGradients { touched, gradients } = gradients;
        let len = self.len();
        if (gaussians.len(), gradients.len()) != (len, touched.len()) {
            return Err(AdamError::Length {
                adam: len,
                gaussians: gaussians.len(),
                touched: touched.len(),
                gradients: gradients.len(),
            });
        }
        let ascending = touched.is_sorted_by(|a, b| a < b);
        if !ascending || touched.last().is_some_and(|last| *last as usize >= len) {
            return Err(AdamError::Touched { gaussians: len });
        }

        let table = Corrections::table();
        let skipped = (
            gaussians.means.par_chunks_mut(CHUNK),
            gaussians.quats.par_chunks_mut(CHUNK),
            gaussians.log_scales.par_chunks_mut(CHUNK),
            gaussians.opacity_logits.par_chunks_mut(CHUNK),
            gaussians.sh.par_chunks_mut(CHUNK),
            self.first.par_chunks_mut(CHUNK),
            self.second.par_chunks_mut(CHUNK),
            self.steps.par_chunks_mut(CHUNK),
        )
            .into_par_iter()
            .enumerate()
            .map(
                |(chunk, (means, quats, log_scales, opacity_logits, sh, first, second, steps))| {
                    let start = chunk * CHUNK;
                    let position = |end| touched.partition_point(|i| (*i as usize) < end);
                    let range = position(start)..position(start + steps.len());
                    dispatch(MoveChunk {
                        start,
                        touched: &touched[range.clone()],
                        gradients: &gradients[range],
                        rates,
                        table,
                        means,
                        quats,
                        log_scales,
                        opacity_logits,
                        sh,
                        first,
                        second,
                        steps,
                    })
                },
            )
            .sum();
        Ok(skipped)
    }
}

/// Updates the touched ones of consecutive gaussians. Run it through [`dispatch`].
struct MoveChunk<'a> {
    /// Index of the first gaussian.
    start: usize,
    touched: &'a [u32],
    gradients: &'a [GaussianGradient],
    rates: &'a LearningRates,
    table: &'static [Corrections],
    means: &'a mut [[f32; 3]],
    quats: &'a mut [[f32; 4]],
    log_scales: &'a mut [[f32; 3]],
    opacity_logits: &'a mut [f32],
    sh: &'a mut [[f32; 3]],
    first: &'a mut [ByParameter],
    second: &'a mut [ByParameter],
    steps: &'a mut [u32],
}

impl Kernel for MoveChunk<'_> {
    /// How many gaussians are skipped because their gradient is not usable.
    type Output = usize;

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) -> usize {
        let rates = self.rates;
        let rates = ByParameter::of(&GaussianGradient {
            d_mean: [rates.means; 3],
            d_quat: [rates.quats; 4],
            d_log_scales: [rates.log_scales; 3],
            d_opacity_logit: rates.opacity_logits,
            d_sh: [rates.sh; 3],
        });
        let mut skipped = 0;
        for (index, gradient) in self.touched.iter().zip(self.gradients) {
            let i = *index as usize - self.start;
            let gradient = ByParameter::of(gradient);
            let usable = |ok: bool, g: &f32| ok & (g * g).is_finite();
            if !gradient.0.iter().fold(true, usable) {
                skipped += 1;
                continue;
            }
            let steps_before = self.steps[i];
            self.steps[i] = steps_before.saturating_add(1);
            let corrections = match self.table.get(steps_before as usize) {
                Some(tabled) => *tabled,
                None => Corrections::new(steps_before),
            };
            let step = step(
                &corrections,
                &rates,
                &gradient,
                &mut self.first[i],
                &mut self.second[i],
            );
            let [x, y, z, qw, qx, qy, qz, s0, s1, s2, opacity, r, g, b, ..] = step;
            subtract(&mut self.means[i], [x, y, z]);
            subtract(&mut self.quats[i], [qw, qx, qy, qz]);
            subtract(&mut self.log_scales[i], [s0, s1, s2]);
            self.opacity_logits[i] -= opacity;
            subtract(&mut self.sh[i], [r, g, b]);
        }
        skipped
    }
}

/// Updates a gaussian's moments. Returns what to subtract from its parameters.
#[inline(always)]
fn step(
    corrections: &Corrections,
    rates: &ByParameter,
    gradient: &ByParameter,
    first: &mut ByParameter,
    second: &mut ByParameter,
) -> [f32; PLACES] {
    let Corrections {
        decay,
        first: correction,
        second_root,
    } = *corrections;
    let (ByParameter(mut m), ByParameter(mut v)) = (*first, *second);
    let mut step = [0.0; PLACES];
    for k in 0..PLACES {
        let gradient = gradient.0[k];
        m[k] = BETA_1 as f32 * m[k] + (1.0 - BETA_1) as f32 * gradient;
        v[k] = BETA_2 as f32 * v[k] + (1.0 - BETA_2) as f32 * gradient * gradient;
        let root = v[k].sqrt() * second_root;
        let decay = if k < 3 { decay * decay } else { decay };
        step[k] = rates.0[k] * decay * correction * m[k] / (root + EPSILON);
    }
    (*first, *second) = (ByParameter(m), ByParameter(v));
    step
}

#[inline(always)]
fn subtract<const K: usize>(params: &mut [f32; K], step: [f32; K]) {
    for (param, step) in params.iter_mut().zip(step) {
        *param -= step;
    }
}

/// Bias corrections and decay of the learning rates at a gaussian's step t, from 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Corrections {
    /// Factor of the learning rates; of the centres' rate its square.
    decay: f32,
    /// `1 / (1 - beta_1^t)`, the bias correction of the first moment.
    pub(crate) first: f32,
    /// `1 / sqrt(1 - beta_2^t)`, the bias correction of the second moment's root.
    pub(crate) second_root: f32,
}

impl Corrections {
    /// The corrections of the first `TABLED_STEPS` steps.
    pub(crate) fn table() -> &'static [Self] {
        static TABLE: LazyLock<Vec<Corrections>> =
            LazyLock::new(|| (0..TABLED_STEPS).map(Corrections::new).collect());
        &TABLE
    }

    fn new(steps_before: u32) -> Self {
        let steps = steps_before.min(i32::MAX as u32 - 1) as i32 + 1;
        Self {
            decay: (1.0 + f64::from(steps_before) / DECAY_STEPS).sqrt().recip() as f32,
            first: (1.0 - BETA_1.powi(steps)).recip() as f32,
            second_root: (1.0 - BETA_2.powi(steps)).sqrt().recip() as f32,
        }
    }
}

#[cfg(test)]
mod tests;
