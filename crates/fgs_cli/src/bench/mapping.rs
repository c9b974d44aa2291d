//! The parts of an optimisation step, and the whole of it.
//!
//! The scene: 100 000 gaussians at random pixels with depth of one frame, each axis depth / f times
//! 1 to 2 long, turned at random, with opacity 0.99 and the pixel's colour.

use std::hint::black_box;

use anyhow::ensure;
use fgs_geom::{RgbdFrame, Se3, View, has_depth};
use fgs_splat::{
    Adam, Cotangents, CpuModel, Gaussian, GaussianGradients, GaussianModel, Gaussians,
    LearningRates, LossSettings, ModelSettings, Rasterizer, Rendered, Seeds, Target, ViewId,
    photometric_loss,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::input::Input;
use super::stage::{Bench, Stage};

const GAUSSIANS: usize = 100_000;
/// Parameters of a gaussian.
const PARAMETERS: f64 = 14.0;
/// Operations for one gaussian at one pixel, forward and backward, as the kernels count.
const FORWARD_FLOPS: f64 = 36.0;
const BACKWARD_FLOPS: f64 = 80.0;

/// Hands every stage to `bench`.
pub fn bench(input: &Input, bench: &mut Bench<'_>) -> anyhow::Result<()> {
    let frame = &input.frames[0];
    let view = View {
        camera: frame.camera,
        world_from_camera: Se3::identity(),
    };
    let gaussians = scene(frame)?;
    let target = Target::new(frame.color.clone(), frame.depth_m.clone())?;
    let settings = LossSettings::default();
    let pixels = (view.camera.width * view.camera.height) as f64;
    let size = format!("{GAUSSIANS} gaussians");
    let gaussian_bytes = 4.0 * PARAMETERS * GAUSSIANS as f64;

    let mut rasterizer = Rasterizer::default();
    let pass = rasterizer.render(&gaussians, &view);
    let pairs = pass.evaluations() as f64;
    let rendered = pass.rendered().clone();
    let (scene_ref, view_ref) = (&gaussians, &view);
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
            black_box(rasterizer.render(scene_ref, view_ref));
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
        let cotangents = cotangents_of(&rendered, &target, settings)?;
        let mut rasterizer = Rasterizer::default();
        let mut timed = GaussianGradients::default();
        bench(Stage {
            name,
            work: forward_work.clone(),
            bytes: 3.0 * gaussian_bytes + 40.0 * pixels,
            flops: (FORWARD_FLOPS + BACKWARD_FLOPS) * pairs,
            check: Box::new(|| check_gradient(&gaussians, &view, &target, settings)),
            run: Box::new(|| {
                let mut pass = rasterizer.render(scene_ref, view_ref);
                pass.vjp(&cotangents, &mut timed);
                black_box(&timed);
            }),
        })?;
    }

    let cotangents = cotangents_of(&rendered, &target, &settings)?;
    let mut gradients = GaussianGradients::default();
    Rasterizer::default()
        .render(&gaussians, &view)
        .vjp(&cotangents, &mut gradients);
    let loss = loss_of(&gaussians, &view, &target, &settings)?;
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
            let loss = photometric_loss(&rendered, &target, &settings, &mut timed);
            black_box(loss.is_ok());
        }),
    })?;

    let rates = LearningRates::default();
    let touched = gradients.touched.len() as f64;
    let (mut adam, mut moving) = (Adam::default(), gaussians.clone());
    adam.extend(GAUSSIANS);
    bench(Stage {
        name: "Adam",
        work: format!("{touched} gaussians touched"),
        bytes: 28.0 * PARAMETERS * touched,
        flops: 15.0 * PARAMETERS * touched,
        check: Box::new(|| {
            let (mut adam, mut moving) = (Adam::default(), gaussians.clone());
            adam.extend(GAUSSIANS);
            adam.step(&mut moving, &gradients, &rates)?;
            ensure!(
                loss_of(&moving, &view, &target, &settings)? < loss,
                "a step does not lower the loss"
            );
            Ok(())
        }),
        run: Box::new(|| {
            black_box(adam.step(&mut moving, &gradients, &rates).is_ok());
        }),
    })?;

    let new_model = || -> anyhow::Result<(CpuModel, ViewId)> {
        let mut model = CpuModel::new(ModelSettings::default());
        model.insert(&Seeds {
            gaussians: gaussians.clone(),
            sparse_ids: vec![None; GAUSSIANS],
        })?;
        let id = model.add_view(view, target.clone())?;
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
            let losses: Vec<f32> = model.take_stats().iter().map(|step| step.loss).collect();
            ensure!(losses[1] < losses[0], "the loss goes from {losses:?}");
            Ok(())
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
    // Far enough for single precision, near enough for a straight line.
    let step = 1.0;
    let slope = (moved(step)? - moved(-step)?) / (2.0 * step);
    let error = (slope / length - 1.0).abs();
    ensure!(error <= 0.02, "the gradient is off by {error}");
    Ok(())
}

fn scene(frame: &RgbdFrame) -> anyhow::Result<Gaussians> {
    let camera = &frame.camera;
    let measured: Vec<(usize, usize)> = (0..camera.height)
        .flat_map(|v| (0..camera.width).map(move |u| (u, v)))
        .filter(|&(u, v)| has_depth(frame.depth_m.at(u, v)))
        .collect();
    ensure!(!measured.is_empty(), "the frame has no depth");
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut gaussians = Gaussians::default();
    for _ in 0..GAUSSIANS {
        let (u, v) = measured[rng.random_range(0..measured.len())];
        let depth_m = f64::from(frame.depth_m.at(u, v));
        let mean = camera.unproject(u as f64, v as f64, depth_m);
        let pixel_m = (depth_m / camera.intrinsics.fx) as f32;
        gaussians.push(&Gaussian {
            mean: [mean.x, mean.y, mean.z].map(|x| x as f32),
            quat: std::array::from_fn(|_| rng.random_range(-1.0..1.0)),
            scales: std::array::from_fn(|_| pixel_m * rng.random_range(1.0..2.0)),
            opacity: 0.99,
            rgb: frame.color.at(u, v).map(|c| f32::from(c) / 255.0),
        });
    }
    Ok(gaussians)
}
