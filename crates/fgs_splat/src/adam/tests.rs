//! Adam against the textbook in f64, per gaussian, while the map grows and shrinks.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const RATES: [f32; 14] = [
    4e-4, 4e-4, 4e-4, 2e-2, 2e-2, 2e-2, 2e-2, 3e-2, 3e-2, 3e-2, 0.1, 2e-2, 2e-2, 2e-2,
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
    let gradient = |index: &u32| {
        let i = *index as usize;
        GaussianGradient {
            d_mean: derivatives.means[i],
            d_quat: derivatives.quats[i],
            d_log_scales: derivatives.log_scales[i],
            d_opacity_logit: derivatives.opacity_logits[i],
            d_sh: derivatives.sh[i],
        }
    };
    GaussianGradients {
        touched: touched.to_vec(),
        gradients: touched.iter().map(gradient).collect(),
    }
}

/// One parameter under Adam as in its paper with falling rates, in f64.
#[derive(Clone, Default)]
struct Textbook {
    m: f64,
    v: f64,
    t: i32,
}

impl Textbook {
    fn step(&mut self, gradient: f64, rate: f64, decay_power: f64) -> f64 {
        let rate = rate / (1.0 + f64::from(self.t) / 50.0).powf(decay_power);
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
                let decay_power = if k < 3 { 1.0 } else { 0.5 };
                let (gradient, rate) = (gradient[k].into(), RATES[k].into());
                moved[i][k] += textbook[i][k].step(gradient, rate, decay_power);
            }
        }
    }
    for (i, moved) in moved.iter().enumerate() {
        let actual = params(&gaussians, i);
        for k in 0..14 {
            let error = (f64::from(actual[k]) - moved[k]).abs();
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
    let mut ragged = gradients_of(&gradients, &[0, 2]);
    ragged.gradients.pop();
    let length = adam.step(&mut gaussians, &ragged, &rates);
    assert!(matches!(length, Err(AdamError::Length { touched: 2, .. })));
    for touched in [&[3][..], &[1, 1], &[2, 0]] {
        let mut wrong = gradients_of(&gradients, &vec![0; touched.len()]);
        wrong.touched = touched.to_vec();
        let result = adam.step(&mut gaussians, &wrong, &rates);
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

#[test]
fn a_gaussian_moves_alone_as_in_a_large_map() {
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let (before, gradients) = (random(&mut rng, 9000, 1.0), random(&mut rng, 9000, 1.0));
    // Other gradients in the second step, so that the first one's moments matter.
    let second = random(&mut rng, 9000, 1.0);
    let rates = LearningRates::default();
    let (mut gaussians, mut adam) = (before.clone(), Adam::default());
    adam.extend(9000);
    let touched: Vec<u32> = (0..9000).collect();
    for gradients in [&gradients, &second] {
        adam.step(&mut gaussians, &gradients_of(gradients, &touched), &rates)
            .unwrap();
    }
    for i in [0, 4095, 4096, 8191, 8192, 8999] {
        let keep: Vec<bool> = (0..9000).map(|k| k == i).collect();
        let (mut alone, mut adam) = (before.clone(), Adam::default());
        alone.retain(&keep);
        adam.extend(1);
        for gradients in [&gradients, &second] {
            let mut gradient = gradients.clone();
            gradient.retain(&keep);
            adam.step(&mut alone, &gradients_of(&gradient, &[0]), &rates)
                .unwrap();
        }
        assert_eq!(params(&alone, 0), params(&gaussians, i));
    }
}
