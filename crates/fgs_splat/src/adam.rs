//! Adam (Kingma and Ba 2015) on the gaussians that a step touches.
//!
//! Input: gaussians, their gradients, and the indices of those that the step saw. Output: the
//! gaussians moved. State grows and shrinks with the map, entry i belonging to gaussian i.
//!
//! Each gaussian counts its own steps, so that a new one has its own bias correction. Textbook
//! Adam moves every parameter at every step, by momentum alone where the gradient is zero; here
//! a gaussian that is not touched rests, moments included. A gaussian out of view would otherwise
//! drift after the last view that saw it, and a step would cost the size of the map.

use crate::gaussians::retain;
use crate::{GaussianGradients, Gaussians};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Decay of the first moment (Kingma and Ba 2015).
const BETA_1: f64 = 0.9;
/// Decay of the second moment (Kingma and Ba 2015).
const BETA_2: f64 = 0.999;
/// Far below any gradient: the loss is a mean over a million values, so that gradients near the
/// customary 1e-8 are common and would be damped by it.
const EPSILON: f32 = 1e-15;
/// Gaussians that one task moves, whatever the number of threads.
const CHUNK: usize = 4096;

/// Step sizes: how far a parameter moves in a step with a steady gradient.
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
    /// Those of the published system.
    fn default() -> Self {
        Self {
            means: 2.5e-6,
            quats: 1e-2,
            log_scales: 5e-3,
            opacity_logits: 0.05,
            sh: 3.5e-3,
        }
    }
}

/// Why no step was made.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum AdamError {
    /// The state is for another number of gaussians.
    #[error("Adam holds {adam} gaussians, but there are {gaussians} and {gradients} gradients")]
    Length {
        /// Entries of the state.
        adam: usize,
        /// Gaussians to be moved.
        gaussians: usize,
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
        let touched = &gradients.touched;
        let len = self.len();
        if (gaussians.len(), gradients.d_means.len()) != (len, len) {
            return Err(AdamError::Length {
                adam: len,
                gaussians: gaussians.len(),
                gradients: gradients.d_means.len(),
            });
        }
        let ascending = touched.is_sorted_by(|a, b| a < b);
        if !ascending || touched.last().is_some_and(|last| *last as usize >= len) {
            return Err(AdamError::Touched { gaussians: len });
        }

        let active: Vec<u32> = touched
            .par_iter()
            .with_min_len(CHUNK)
            .copied()
            .filter(|index| is_usable(gradients, *index as usize))
            .collect();
        for index in &active {
            let steps = &mut self.steps[*index as usize];
            *steps = steps.saturating_add(1);
        }

        let (first, second) = (&mut self.first, &mut self.second);
        let update = Update {
            active: &active,
            steps: &self.steps,
        };
        update.run(
            rates.means,
            &mut gaussians.means,
            &gradients.d_means,
            &mut first.means,
            &mut second.means,
        );
        update.run(
            rates.quats,
            &mut gaussians.quats,
            &gradients.d_quats,
            &mut first.quats,
            &mut second.quats,
        );
        update.run(
            rates.log_scales,
            &mut gaussians.log_scales,
            &gradients.d_log_scales,
            &mut first.log_scales,
            &mut second.log_scales,
        );
        update.run(
            rates.opacity_logits,
            gaussians.opacity_logits.as_chunks_mut::<1>().0,
            gradients.d_opacity_logits.as_chunks::<1>().0,
            first.opacity_logits.as_chunks_mut::<1>().0,
            second.opacity_logits.as_chunks_mut::<1>().0,
        );
        update.run(
            rates.sh,
            &mut gaussians.sh,
            &gradients.d_sh,
            &mut first.sh,
            &mut second.sh,
        );
        Ok(touched.len() - active.len())
    }
}

/// Whether all gradients of gaussian i, and their squares, are finite.
fn is_usable(gradients: &GaussianGradients, i: usize) -> bool {
    let usable = |values: &[f32]| values.iter().all(|g| (g * g).is_finite());
    usable(&gradients.d_means[i])
        && usable(&gradients.d_quats[i])
        && usable(&gradients.d_log_scales[i])
        && usable(&[gradients.d_opacity_logits[i]])
        && usable(&gradients.d_sh[i])
}

/// What the parameters' arrays have in common: the ascending indices of the gaussians to move, and
/// every gaussian's number of steps, this one included.
struct Update<'a> {
    active: &'a [u32],
    steps: &'a [u32],
}

impl Update<'_> {
    fn run<const K: usize>(
        &self,
        rate: f32,
        params: &mut [[f32; K]],
        gradients: &[[f32; K]],
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
                for index in self.active_in(start, start + params.len()) {
                    let i = *index as usize;
                    let local = i - start;
                    let steps = self.steps[i].min(i32::MAX as u32) as i32;
                    let first_correction = (1.0 - BETA_1.powi(steps)) as f32;
                    let second_correction = (1.0 - BETA_2.powi(steps)) as f32;
                    for k in 0..K {
                        let gradient = gradients[i][k];
                        let (m, v) = (&mut first[local][k], &mut second[local][k]);
                        *m = BETA_1 as f32 * *m + (1.0 - BETA_1) as f32 * gradient;
                        *v = BETA_2 as f32 * *v + (1.0 - BETA_2) as f32 * gradient * gradient;
                        let m = *m / first_correction;
                        let v = *v / second_correction;
                        params[local][k] -= rate * m / (v.sqrt() + EPSILON);
                    }
                }
            });
    }

    /// The active indices from `start` to before `end`.
    fn active_in(&self, start: usize, end: usize) -> &[u32] {
        let from = self.active.partition_point(|i| (*i as usize) < start);
        let to = self.active.partition_point(|i| (*i as usize) < end);
        &self.active[from..to]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    const RATES: [f32; 14] = [
        2.5e-6, 2.5e-6, 2.5e-6, 1e-2, 1e-2, 1e-2, 1e-2, 5e-3, 5e-3, 5e-3, 0.05, 3.5e-3, 3.5e-3,
        3.5e-3,
    ];

    /// All parameters of gaussian i, in the order of [`RATES`].
    fn params(gaussians: &Gaussians, i: usize) -> [f32; 14] {
        let g = gaussians;
        let logit = [g.opacity_logits[i]];
        let parts: [&[f32]; 5] = [&g.means[i], &g.quats[i], &g.log_scales[i], &logit, &g.sh[i]];
        parts.concat().try_into().unwrap()
    }

    fn random(rng: &mut Pcg64Mcg, len: usize, scale: f32) -> Gaussians {
        let mut random = Gaussians::zeros(len);
        let arrays: [&mut [f32]; 5] = [
            random.means.as_flattened_mut(),
            random.quats.as_flattened_mut(),
            random.log_scales.as_flattened_mut(),
            &mut random.opacity_logits,
            random.sh.as_flattened_mut(),
        ];
        for value in arrays.into_iter().flatten() {
            *value = scale * rng.random_range(-1.0f32..1.0);
        }
        random
    }

    fn gradients_of(derivatives: &Gaussians, touched: &[u32]) -> GaussianGradients {
        let d = derivatives.clone();
        GaussianGradients {
            d_means: d.means,
            d_quats: d.quats,
            d_log_scales: d.log_scales,
            d_opacity_logits: d.opacity_logits,
            d_sh: d.sh,
            touched: touched.to_vec(),
        }
    }

    /// One parameter under Adam as in the paper, in f64.
    #[derive(Clone, Default)]
    struct Textbook {
        m: f64,
        v: f64,
        t: i32,
    }

    impl Textbook {
        fn step(&mut self, gradient: f64, rate: f64) -> f64 {
            self.t += 1;
            self.m = 0.9 * self.m + 0.1 * gradient;
            self.v = 0.999 * self.v + 0.001 * gradient * gradient;
            let m = self.m / (1.0 - 0.9f64.powi(self.t));
            let v = self.v / (1.0 - 0.999f64.powi(self.t));
            -rate * m / (v.sqrt() + 1e-15)
        }
    }

    /// Steps with random touched sets while the map grows and shrinks; each gaussian must move
    /// as the textbook moves it over the steps that touched it.
    #[test]
    fn follows_the_textbook_per_gaussian() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let (mut gaussians, mut adam) = (Gaussians::default(), Adam::default());
        let mut textbook: Vec<[Textbook; 14]> = vec![];
        let mut moved: Vec<[f64; 14]> = vec![];
        for step in 0..60 {
            if step % 20 == 0 {
                gaussians.extend(&Gaussians::zeros(40));
                adam.extend(40);
                textbook.resize(adam.len(), Default::default());
                moved.resize(adam.len(), [0.0; 14]);
            }
            if step % 20 == 10 {
                let keep: Vec<bool> = (0..adam.len()).map(|_| rng.random_bool(0.7)).collect();
                gaussians.retain(&keep);
                adam.retain(&keep);
                retain(&mut textbook, &keep);
                retain(&mut moved, &keep);
            }
            let len = adam.len();
            let gradients = random(&mut rng, len, 1e-6);
            let touched: Vec<u32> = (0..len as u32).filter(|_| rng.random_bool(0.5)).collect();
            let rates = LearningRates::default();
            assert_eq!(
                adam.step(&mut gaussians, &gradients_of(&gradients, &touched), &rates),
                Ok(0)
            );
            for i in touched.iter().map(|i| *i as usize) {
                let gradient = params(&gradients, i);
                for k in 0..14 {
                    moved[i][k] += textbook[i][k].step(gradient[k].into(), RATES[k].into());
                }
            }
        }
        for i in 0..adam.len() {
            let actual = params(&gaussians, i);
            for k in 0..14 {
                let error = (f64::from(actual[k]) - moved[i][k]).abs();
                assert!(error <= 1e-4 * f64::from(RATES[k]), "{i} {k} {error}");
            }
        }
        assert_eq!((gaussians.len(), textbook.len()), (adam.len(), adam.len()));
    }

    #[test]
    fn first_step_is_the_learning_rate() {
        let mut gaussians = Gaussians::zeros(3);
        let mut adam = Adam::default();
        adam.extend(3);
        let gradients = random(&mut Pcg64Mcg::seed_from_u64(2), 3, 1e-6);
        let rates = LearningRates::default();
        assert_eq!(
            adam.step(&mut gaussians, &gradients_of(&gradients, &[1]), &rates),
            Ok(0)
        );
        for (k, moved) in params(&gaussians, 1).into_iter().enumerate() {
            let expected = -RATES[k] * params(&gradients, 1)[k].signum();
            assert!((moved - expected).abs() <= 1e-5 * RATES[k], "{k}");
        }
        assert_eq!(params(&gaussians, 0), [0.0; 14]);
        assert_eq!(params(&gaussians, 2), [0.0; 14]);
    }

    #[test]
    fn gradients_that_are_not_finite_rest_and_are_counted() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let before = random(&mut rng, 7, 1.0);
        let mut gradients = random(&mut rng, 7, 1.0);
        gradients.means[0][2] = f32::NAN;
        gradients.quats[1][3] = f32::INFINITY;
        gradients.log_scales[2][1] = f32::NEG_INFINITY;
        gradients.opacity_logits[3] = 1e30;
        gradients.sh[4][0] = f32::NAN;
        gradients.sh[5] = [1e19, 1e-40, 0.0];
        let (mut gaussians, mut adam) = (before.clone(), Adam::default());
        adam.extend(7);
        let touched = [0, 1, 2, 3, 4, 5];
        let rates = LearningRates::default();
        let untouched = adam.clone();
        assert_eq!(
            adam.step(&mut gaussians, &gradients_of(&gradients, &touched), &rates),
            Ok(5)
        );
        for i in 0..7 {
            let rests = params(&gaussians, i) == params(&before, i);
            assert_eq!(rests, i != 5, "{i}");
            assert!(params(&gaussians, i).iter().all(|x| x.is_finite()));
        }
        let all_but_5: Vec<bool> = (0..7).map(|i| i != 5).collect();
        adam.retain(&all_but_5);
        let mut expected = untouched;
        expected.retain(&all_but_5);
        assert_eq!(adam, expected);
    }

    #[test]
    fn wrong_lengths_and_indices_are_refused() {
        let (mut gaussians, mut adam) = (Gaussians::zeros(3), Adam::default());
        let (gradients, rates) = (Gaussians::zeros(3), LearningRates::default());
        let length = adam.step(&mut gaussians, &gradients_of(&gradients, &[]), &rates);
        assert!(matches!(length, Err(AdamError::Length { adam: 0, .. })));
        adam.extend(3);
        for touched in [&[3][..], &[1, 1], &[2, 0]] {
            let result = adam.step(&mut gaussians, &gradients_of(&gradients, touched), &rates);
            assert_eq!(result, Err(AdamError::Touched { gaussians: 3 }));
        }
        assert_eq!(
            adam.step(&mut gaussians, &gradients_of(&gradients, &[0, 2]), &rates),
            Ok(0)
        );
        assert_eq!(gaussians, Gaussians::zeros(3));
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let mut rng = Pcg64Mcg::seed_from_u64(4);
        let (before, gradients) = (random(&mut rng, 9000, 1.0), random(&mut rng, 9000, 1.0));
        let touched: Vec<u32> = (0..9000).filter(|i| i % 3 != 0).collect();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.unwrap().install(|| {
                let (mut gaussians, mut adam) = (before.clone(), Adam::default());
                adam.extend(9000);
                for _ in 0..3 {
                    let rates = LearningRates::default();
                    adam.step(&mut gaussians, &gradients_of(&gradients, &touched), &rates)
                        .unwrap();
                }
                (gaussians, adam)
            })
        };
        assert_eq!(run(1), run(5));
    }
}
