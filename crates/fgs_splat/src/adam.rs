//! Adam (Kingma and Ba 2015) on the gaussians that a step touches.
//!
//! Input: gaussians, their gradients, and the indices of those that the step saw. Output: the
//! gaussians moved. State grows and shrinks with the map, entry i belonging to gaussian i.
//!
//! Each gaussian counts its own steps, so that a new one has its own bias correction. Textbook
//! Adam moves every parameter at every step, by momentum alone where the gradient is zero; here
//! a gaussian that is not touched rests, moments included. A gaussian out of view would otherwise
//! drift after the last view that saw it, and a step would cost the size of the map.
//!
//! A gaussian's learning rates fall with its own steps, so that a map that keeps growing settles
//! where it is old while it is quick to fit where it is new.

use crate::gaussians::retain;
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
/// Learning rates fall as `1 / sqrt(1 + t / DECAY_STEPS)`, slowly enough for Adam to arrive
/// anywhere (Kingma and Ba 2015, Theorem 4.1), those of the centres as the square of that: a centre
/// that keeps moving undoes what the other parameters have learnt. A gaussian is fitted after a few
/// dozen steps; what moves it from then on is mostly the difference between views.
pub(crate) const DECAY_STEPS: f64 = 50.0;
/// Far below any gradient: the loss is a mean over a million values, so that gradients near the
/// customary 1e-8 are common and would be damped by it.
pub(crate) const EPSILON: f32 = 1e-15;
/// Steps whose corrections are worked out once: more than most gaussians ever make.
const TABLED_STEPS: u32 = 1 << 14;
/// Gaussians that one task moves, whatever the number of threads.
const CHUNK: usize = 4096;

/// Step sizes: how far a parameter of a new gaussian moves in a step with a steady gradient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearningRates {
    /// Of the centres, metres.
    pub means: f32,
    /// Of the quaternions' entries.
    pub quats: f32,
    /// Of the logarithms of the scales.
    pub log_scales: f32,
    /// Of the opacity logits.
    pub opacity_logits: f32,
    /// Of the spherical harmonics of degree 0.
    pub sh: f32,
}

impl Default for LearningRates {
    /// Differs from the paper, whose code has 2.5e-6 for the means, 5e-3 for the log-scales, 0.05
    /// for the opacities, 1e-2 for the quaternions and 3.5e-3 for the colours, all constant: at a
    /// few steps per frame its centres stay where noise put them and its colours do not arrive, and
    /// at many its map does not settle.
    fn default() -> Self {
        Self {
            means: 4e-4,
            quats: 2e-2,
            log_scales: 1e-2,
            opacity_logits: 0.04,
            sh: 2e-2,
        }
    }
}

impl LearningRates {
    /// # Errors
    /// A rate outside 0..=1.
    pub fn validate(&self) -> Result<(), SettingError> {
        SettingError::unless_share("means", self.means.into())?;
        SettingError::unless_share("quats", self.quats.into())?;
        SettingError::unless_share("log_scales", self.log_scales.into())?;
        SettingError::unless_share("opacity_logits", self.opacity_logits.into())?;
        SettingError::unless_share("sh", self.sh.into())
    }
}

/// Why no step was made.
#[derive(Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum AdamError {
    /// The state is for another number of gaussians, or gradients are missing.
    #[error(
        "Adam holds {adam} gaussians, but there are {gaussians}, and {gradients} gradients of \
         {touched} touched ones"
    )]
    Length {
        /// Entries of the state.
        adam: usize,
        /// Gaussians to be moved.
        gaussians: usize,
        /// Touched gaussians.
        touched: usize,
        /// Gradients.
        gradients: usize,
    },
    /// Touched indices are not strictly ascending, or not below the number of gaussians.
    #[error("touched indices must ascend without repetition and be below {gaussians}")]
    Touched {
        /// Number of gaussians.
        gaussians: usize,
    },
}

/// First and second moments of every parameter, and each gaussian's number of steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Adam {
    first: Gaussians,
    second: Gaussians,
    steps: Vec<u32>,
}

impl Adam {
    /// Gaussians that there is state for.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether there is no state.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Adds fresh state for `count` new gaussians at the end.
    pub fn extend(&mut self, count: usize) {
        let len = self.len() + count;
        self.first.resize(len);
        self.second.resize(len);
        self.steps.resize(len, 0);
    }

    /// Keeps the state of gaussian i where `keep[i]`, in order.
    ///
    /// # Panics
    /// Unless there is one flag for each gaussian.
    pub fn retain(&mut self, keep: &[bool]) {
        self.first.retain(keep);
        self.second.retain(keep);
        retain(&mut self.steps, keep);
    }

    /// Turns the moments of gaussian i with it: see [`crate::rigid_motion`].
    pub(crate) fn turn(&mut self, i: usize, motion: &RigidMotion) {
        let RigidMotion { rotation, left, .. } = motion;
        for (moments, rotation, left) in [
            (&mut self.first, rotation, left),
            (&mut self.second, &squared(rotation), &squared(left)),
        ] {
            moments.means[i] = transformed(rotation, &moments.means[i]);
            moments.quats[i] = transformed(left, &moments.quats[i]);
        }
    }

    /// Moves the gaussians that the gradients touch against them.
    ///
    /// A gaussian with a gradient entry that is not finite, or whose square overflows, rests with
    /// its state. Returns how many did.
    ///
    /// # Errors
    /// If lengths differ, or `touched` does not ascend or reaches beyond the gaussians.
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

        let active: Vec<Active> = touched
            .par_iter()
            .zip(gradients)
            .with_min_len(CHUNK)
            .filter(|(_, gradient)| is_usable(gradient))
            .map(|(index, gradient)| Active {
                index: *index,
                gradient,
                corrections: Corrections::after(self.steps[*index as usize]),
            })
            .collect();
        for gaussian in &active {
            let steps = &mut self.steps[gaussian.index as usize];
            *steps = steps.saturating_add(1);
        }

        let (first, second) = (&mut self.first, &mut self.second);
        update(
            &active,
            |decay| rates.means * decay * decay,
            &mut gaussians.means,
            |gradient| gradient.d_mean,
            &mut first.means,
            &mut second.means,
        );
        update(
            &active,
            |decay| rates.quats * decay,
            &mut gaussians.quats,
            |gradient| gradient.d_quat,
            &mut first.quats,
            &mut second.quats,
        );
        update(
            &active,
            |decay| rates.log_scales * decay,
            &mut gaussians.log_scales,
            |gradient| gradient.d_log_scales,
            &mut first.log_scales,
            &mut second.log_scales,
        );
        update(
            &active,
            |decay| rates.opacity_logits * decay,
            gaussians.opacity_logits.as_chunks_mut::<1>().0,
            |gradient| [gradient.d_opacity_logit],
            first.opacity_logits.as_chunks_mut::<1>().0,
            second.opacity_logits.as_chunks_mut::<1>().0,
        );
        update(
            &active,
            |decay| rates.sh * decay,
            &mut gaussians.sh,
            |gradient| gradient.d_sh,
            &mut first.sh,
            &mut second.sh,
        );
        Ok(touched.len() - active.len())
    }
}

/// Whether all derivatives, and their squares, are finite.
fn is_usable(gradient: &GaussianGradient) -> bool {
    let usable = |values: &[f32]| values.iter().all(|g| (g * g).is_finite());
    usable(&gradient.d_mean)
        && usable(&gradient.d_quat)
        && usable(&gradient.d_log_scales)
        && usable(&[gradient.d_opacity_logit])
        && usable(&gradient.d_sh)
}

/// A gaussian to be moved.
struct Active<'a> {
    index: u32,
    gradient: &'a GaussianGradient,
    corrections: Corrections,
}

/// What a gaussian's number of steps makes of its moments and learning rates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Corrections {
    /// What is left of the learning rates (of the centres' its square).
    decay: f32,
    /// `1 / (1 - beta_1^t)`, the bias correction of the first moment.
    pub(crate) first: f32,
    /// `1 / sqrt(1 - beta_2^t)`, which the second moment's root is multiplied by.
    pub(crate) second_root: f32,
}

impl Corrections {
    /// Those of the first steps.
    pub(crate) fn table() -> &'static [Self] {
        static TABLE: LazyLock<Vec<Corrections>> =
            LazyLock::new(|| (0..TABLED_STEPS).map(Corrections::new).collect());
        &TABLE
    }

    fn after(steps_before: u32) -> Self {
        match Self::table().get(steps_before as usize) {
            Some(tabled) => *tabled,
            None => Self::new(steps_before),
        }
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

/// One step of one of the parameters' arrays. `active` ascends; `rate` is the learning rate by what
/// age has left of it.
fn update<const K: usize>(
    active: &[Active<'_>],
    rate: impl Fn(f32) -> f32 + Sync,
    params: &mut [[f32; K]],
    d_params: impl Fn(&GaussianGradient) -> [f32; K] + Sync,
    first: &mut [[f32; K]],
    second: &mut [[f32; K]],
) {
    params
        .par_chunks_mut(CHUNK)
        .zip(first.par_chunks_mut(CHUNK))
        .zip(second.par_chunks_mut(CHUNK))
        .enumerate()
        .for_each(|(chunk, ((params, first), second))| {
            let start = chunk * CHUNK;
            let position = |end| active.partition_point(|a| (a.index as usize) < end);
            for gaussian in &active[position(start)..position(start + params.len())] {
                let local = gaussian.index as usize - start;
                let Corrections {
                    decay,
                    first: correction,
                    second_root,
                } = gaussian.corrections;
                let rate = rate(decay) * correction;
                let d_params = d_params(gaussian.gradient);
                for k in 0..K {
                    let gradient = d_params[k];
                    let (m, v) = (&mut first[local][k], &mut second[local][k]);
                    *m = BETA_1 as f32 * *m + (1.0 - BETA_1) as f32 * gradient;
                    *v = BETA_2 as f32 * *v + (1.0 - BETA_2) as f32 * gradient * gradient;
                    let root = v.sqrt() * second_root;
                    params[local][k] -= rate * *m / (root + EPSILON);
                }
            }
        });
}

#[cfg(test)]
mod tests;
