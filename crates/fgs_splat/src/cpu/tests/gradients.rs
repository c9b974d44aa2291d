//! Gradients against dual numbers through the reference.

use fgs_geom::{Image, View};
use num_dual::Dual64;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::scenes::{convert, random_gaussians, random_view, rng, thicken, to_f32};
use crate::cpu::{Rasterizer, Real};
use crate::{Cotangents, GaussianGradients, Gaussians, reference};

pub fn random_cotangents(rng: &mut Pcg64Mcg, view: &View) -> Cotangents<f64> {
    let (width, height) = (view.camera.width, view.camera.height);
    let mut number = || rng.random_range(-1.0..1.0);
    Cotangents {
        d_color: Image::from_fn(width, height, |_, _| [number(), number(), number()]),
        d_depth_m: Image::from_fn(width, height, |_, _| number()),
        d_alpha: Image::from_fn(width, height, |_, _| number()),
    }
}

/// The derivatives by the 14 parameters of each of `len` gaussians, in a row.
pub fn gradient_rows<T: Real>(gradients: &GaussianGradients<T>, len: usize) -> Vec<[T; 14]> {
    let mut rows = vec![[T::ZERO; 14]; len];
    for (&index, d) in gradients.touched.iter().zip(&gradients.gradients) {
        let logit = [d.d_opacity_logit];
        let flat = [&d.d_mean[..], &d.d_quat, &d.d_log_scales, &logit, &d.d_sh].concat();
        rows[index as usize] = std::array::from_fn(|i| flat[i]);
    }
    rows
}

fn parameter<T>(gaussians: &mut Gaussians<T>, index: usize, component: usize) -> &mut T {
    match component {
        0..3 => &mut gaussians.means[index][component],
        3..7 => &mut gaussians.quats[index][component - 3],
        7..10 => &mut gaussians.log_scales[index][component - 7],
        10 => &mut gaussians.opacity_logits[index],
        _ => &mut gaussians.sh[index][component - 11],
    }
}

/// The derivative of `<cotangents, render>` by each parameter, by dual numbers.
fn dual_gradient(
    gaussians: &Gaussians<f64>,
    view: &View,
    cotangents: &Cotangents<f64>,
) -> Vec<[f64; 14]> {
    let mut dual = convert(gaussians, Dual64::from_re);
    (0..gaussians.len())
        .map(|index| {
            std::array::from_fn(|component| {
                parameter(&mut dual, index, component).eps = 1.0;
                let pixels = reference::render(&dual, view);
                parameter(&mut dual, index, component).eps = 0.0;
                let mut sum = 0.0;
                for (i, pixel) in pixels.iter().enumerate() {
                    let d_color = cotangents.d_color.data()[i];
                    for (d, color) in d_color.iter().zip(&pixel.color) {
                        sum += d * color.eps;
                    }
                    sum += cotangents.d_depth_m.data()[i] * pixel.depth_m.eps;
                    sum += cotangents.d_alpha.data()[i] * pixel.alpha.eps;
                }
                sum
            })
        })
        .collect()
}

pub fn vjp<T: Real>(
    gaussians: &Gaussians<T>,
    view: &View,
    cotangents: &Cotangents<T>,
) -> GaussianGradients<T> {
    let mut rasterizer = Rasterizer::default();
    let mut gradients = GaussianGradients::default();
    rasterizer
        .render(gaussians, view)
        .vjp(cotangents, &mut gradients);
    gradients
}

pub fn cotangents_to_f32(cotangents: &Cotangents<f64>) -> Cotangents<f32> {
    Cotangents {
        d_color: cotangents.d_color.map(|c| c.map(|v| v as f32)),
        d_depth_m: cotangents.d_depth_m.map(|&v| v as f32),
        d_alpha: cotangents.d_alpha.map(|&v| v as f32),
    }
}

#[test]
fn every_gradient_agrees_with_dual_numbers() {
    let mut strong = [0_usize; 14];
    let mut worst = 0.0_f64;
    let scenes = [
        (1, 1, false),
        (17, 33, false),
        (20, 13, false),
        (33, 17, false),
        (18, 7, true),
    ];
    for (seed, (width, height, thick)) in (0..).zip(scenes) {
        let mut rng = rng(seed);
        let view = random_view(&mut rng, width, height);
        let mut gaussians = random_gaussians(&mut rng, &view, if thick { 40 } else { 12 });
        if thick {
            thicken(&mut gaussians);
        }
        let cotangents = random_cotangents(&mut rng, &view);
        let expected = dual_gradient(&gaussians, &view, &cotangents);
        let gradients = vjp(&gaussians, &view, &cotangents);
        let found = gradient_rows(&gradients, gaussians.len());
        for (expected, found) in expected.iter().zip(&found) {
            // Components of one kind share a scale: errors are relative to the largest.
            for group in [0..3, 3..7, 7..10, 10..11, 11..14] {
                let scale = group.clone().map(|i| expected[i].abs()).fold(0.0, f64::max);
                for i in group {
                    let error = (expected[i] - found[i]).abs();
                    assert!(
                        error <= 1e-9 * scale.max(1e-6),
                        "{width}x{height}, component {i}: {} instead of {}",
                        found[i],
                        expected[i]
                    );
                    worst = worst.max(error / scale.max(1e-6));
                    strong[i] += usize::from(expected[i].abs() > 1e-2);
                }
            }
        }
        let single = vjp(&to_f32(&gaussians), &view, &cotangents_to_f32(&cotangents));
        let (mut error2, mut norm2) = (0.0, 0.0);
        for (double, single) in found.iter().zip(gradient_rows(&single, gaussians.len())) {
            for (double, single) in double.iter().zip(single) {
                error2 += (double - f64::from(single)).powi(2);
                norm2 += double * double;
            }
        }
        assert!(
            error2.sqrt() <= 1e-4 * norm2.sqrt() + 1e-6,
            "{error2} {norm2}"
        );
    }
    println!("worst relative error {worst:e}, gradients above the floor {strong:?}");
    assert!(strong.iter().all(|&count| count >= 10), "{strong:?}");
}
