//! The parts of an optimisation step, and the whole of it.

use std::hint::black_box;

use anyhow::ensure;
use fgs_geom::{KeyframeId, View};
use fgs_splat::{
    Adam, Cotangents, CpuModel, GaussianGradients, GaussianModel, Gaussians, LearningRates,
    LossSettings, ModelSettings, Rasterizer, Rendered, Target, photometric_loss,
};

use super::input::Input;
use super::scene::{Scene, check_fall};
use super::stage::{Bench, Stage};

/// Parameters of a gaussian.
const PARAMETERS: f64 = 14.0;
/// Operations for one gaussian at one pixel, forward and backward, as the kernels count.
const FORWARD_FLOPS: f64 = 36.0;
const BACKWARD_FLOPS: f64 = 80.0;

/// Hands every stage to `bench`, with so many gaussians.
pub fn bench(input: &Input, count: usize, bench: &mut Bench<'_>) -> anyhow::Result<()> {
    let scene = Scene::new(&input.frames[0], count)?;
    let Scene {
        gaussians,
        view,
        target,
    } = &scene;
    let settings = LossSettings::default();
    let pixels = (view.camera.width * view.camera.height) as f64;
    let size = format!("{count} gaussians");
    let gaussian_bytes = 4.0 * PARAMETERS * count as f64;

    let mut rasterizer = Rasterizer::default();
    let pass = rasterizer.render(gaussians, view);
    let pairs = pass.evaluations() as f64;
    let rendered = pass.rendered().clone();
    let forward_work = format!("{size}, {:.1}M evaluations", 1e-6 * pairs);
    bench(Stage {
        name: "forward",
        work: forward_work.clone(),
        bytes: gaussian_bytes + 20.0 * pixels,
        flops: FORWARD_FLOPS * pairs,
        check: Box::new(|| {
            let covered = rendered
                .alpha
                .data()
                .iter()
                .filter(|alpha| **alpha > 0.5)
                .count();
            ensure!(
                covered as f64 > 0.05 * pixels,
                "only {covered} pixels are covered"
            );
            Ok(())
        }),
        run: Box::new(|| {
            black_box(rasterizer.render(gaussians, view));
        }),
    })?;

    let color_only = LossSettings {
        depth_weight: 0.0,
        ..settings.clone()
    };
    for (name, settings) in [
        ("forward + backward, colour", &color_only),
        ("forward + backward", &settings),
    ] {
        let cotangents = cotangents_of(&rendered, target, settings)?;
        let mut rasterizer = Rasterizer::default();
        let mut timed = GaussianGradients::default();
        bench(Stage {
            name,
            work: forward_work.clone(),
            bytes: 3.0 * gaussian_bytes + 40.0 * pixels,
            flops: (FORWARD_FLOPS + BACKWARD_FLOPS) * pairs,
            check: Box::new(|| check_gradient(gaussians, view, target, settings)),
            run: Box::new(|| {
                let mut pass = rasterizer.render(gaussians, view);
                pass.vjp(&cotangents, &mut timed);
                black_box(&timed);
            }),
        })?;
    }

    let cotangents = cotangents_of(&rendered, target, &settings)?;
    let mut gradients = GaussianGradients::default();
    Rasterizer::default()
        .render(gaussians, view)
        .vjp(&cotangents, &mut gradients);
    let loss = loss_of(gaussians, view, target, &settings)?;
    let mut timed = Cotangents::default();
    bench(Stage {
        name: "loss and its gradient",
        work: format!("{}x{}", view.camera.width, view.camera.height),
        bytes: 47.0 * pixels,
        // Four blurs forward and three back of three channels, 11 taps along each axis.
        flops: 7.0 * 3.0 * 2.0 * 22.0 * pixels,
        check: Box::new(|| {
            ensure!(loss.is_finite() && loss > 0.0, "{loss}");
            Ok(())
        }),
        run: Box::new(|| {
            let loss = photometric_loss(&rendered, target, &settings, &mut timed);
            black_box(loss.is_ok());
        }),
    })?;

    let rates = LearningRates::default();
    let touched = gradients.touched.len() as f64;
    let (mut adam, mut moving) = (Adam::default(), gaussians.clone());
    adam.extend(count);
    bench(Stage {
        name: "Adam",
        work: format!("{touched} gaussians touched"),
        bytes: 28.0 * PARAMETERS * touched,
        flops: 15.0 * PARAMETERS * touched,
        check: Box::new(|| {
            let (mut adam, mut moving) = (Adam::default(), gaussians.clone());
            adam.extend(count);
            adam.step(&mut moving, &gradients, &rates)?;
            ensure!(
                loss_of(&moving, view, target, &settings)? < loss,
                "a step does not lower the loss"
            );
            Ok(())
        }),
        run: Box::new(|| {
            black_box(adam.step(&mut moving, &gradients, &rates).is_ok());
        }),
    })?;

    let new_model = || -> anyhow::Result<(CpuModel, KeyframeId)> {
        let mut model = CpuModel::new(ModelSettings::default());
        let id = scene.fill(&mut model)?;
        Ok((model, id))
    };
    let (mut model, id) = new_model()?;
    bench(Stage {
        name: "whole step",
        work: size,
        bytes: (3.0 * 4.0 + 28.0) * PARAMETERS * touched + 87.0 * pixels,
        flops: (FORWARD_FLOPS + BACKWARD_FLOPS) * pairs + 924.0 * pixels,
        check: Box::new(|| {
            let (mut model, id) = new_model()?;
            model.step(id)?;
            model.step(id)?;
            check_fall(&model.take_stats())
        }),
        run: Box::new(|| {
            black_box(model.step(id).is_ok());
            model.take_stats();
        }),
    })
}

fn cotangents_of(
    rendered: &Rendered,
    target: &Target,
    settings: &LossSettings,
) -> anyhow::Result<Cotangents> {
    let mut cotangents = Cotangents::default();
    photometric_loss(rendered, target, settings, &mut cotangents)?;
    Ok(cotangents)
}

fn loss_of(
    gaussians: &Gaussians,
    view: &View,
    target: &Target,
    settings: &LossSettings,
) -> anyhow::Result<f64> {
    let mut rasterizer = Rasterizer::default();
    let pass = rasterizer.render(gaussians, view);
    let mut cotangents = Cotangents::default();
    Ok(photometric_loss(pass.rendered(), target, settings, &mut cotangents)?.total)
}

/// Along the colours' gradient the loss changes as the gradient says.
fn check_gradient(
    gaussians: &Gaussians,
    view: &View,
    target: &Target,
    settings: &LossSettings,
) -> anyhow::Result<()> {
    let mut rasterizer = Rasterizer::default();
    let mut gradients = GaussianGradients::default();
    let mut pass = rasterizer.render(gaussians, view);
    let cotangents = cotangents_of(pass.rendered(), target, settings)?;
    pass.vjp(&cotangents, &mut gradients);
    let by_color = gradients.gradients.iter().map(|gradient| gradient.d_sh);
    let squares = by_color.clone().flatten().map(|d| f64::from(d).powi(2));
    let length = squares.sum::<f64>().sqrt();
    ensure!(length > 0.0, "the gradient is zero");
    let moved = |step: f64| {
        let mut moved = gaussians.clone();
        for (&index, d_sh) in gradients.touched.iter().zip(by_color.clone()) {
            for (sh, d) in moved.sh[index as usize].iter_mut().zip(d_sh) {
                *sh += (step * f64::from(d) / length) as f32;
            }
        }
        loss_of(&moved, view, target, settings)
    };
    // Far enough for single precision, near enough for a straight line, also with gaussians so many
    // that most colours are nearly right.
    let step = 0.03;
    let slope = (moved(step)? - moved(-step)?) / (2.0 * step);
    let error = (slope / length - 1.0).abs();
    ensure!(error <= 0.02, "the gradient is off by {error}");
    Ok(())
}
