//! Each stage against its CPU counterpart, on all scenes.

use std::sync::Arc;

use fgs_geom::{Image, KeyframeId, Se3, View};
use nalgebra::Vector6;

use super::scenes::{Scene, model_of, random_target, scenes};
use crate::cpu::tests::inspect;
use crate::cpu::tests::scenes::{random_gaussians, random_view, rng, to_f32};
use crate::gaussians::SH0_FACTOR;
use crate::gpu::gpu_model::GpuModel;
use crate::gpu::layout::{self, Count, TILE};
use crate::gpu::readback::read;
use crate::{
    Cotangents, GaussianGradients, GaussianModel, LossSettings, ModelSettings, Rasterizer,
    photometric_loss,
};

fn fetch<T: bytemuck::Pod>(model: &GpuModel, name: &str, len: usize) -> Vec<T> {
    let buffer = model.work.map.buffers.get(name).unwrap();
    read(model.work.map.device(), buffer, 0, len).unwrap()
}

/// Runs `check` on every scene after a forward and a backward pass with a random target. Data left in
/// the buffers by another, smaller view must not matter. Every other scene has colours that the camera
/// did not see.
fn on_all_scenes(check: impl Fn(&Scene, &crate::Target, &GpuModel, &[u32])) {
    for (seed, scene) in (0..).zip(scenes()) {
        let Some(mut model) = model_of(&scene, &ModelSettings::default()) else {
            return;
        };
        let mut target = random_target(&mut rng(seed), &scene.view);
        if seed % 2 == 1 {
            let camera = &scene.view.camera;
            let valid = Image::from_fn(camera.width, camera.height, |u, v| (u / 9 + v / 4) % 3 > 0);
            target = target.with_color_valid(Arc::new(valid)).unwrap();
        }
        let aside = Se3::exp(&Vector6::new(0.05, -0.1, 0.05, 0.1, 0.05, -0.2));
        let [width, height] = [scene.view.camera.width, scene.view.camera.height];
        let other = View {
            world_from_camera: scene.view.world_from_camera * aside,
            ..random_view(&mut rng(98), width.div_ceil(2), height.div_ceil(2))
        };
        let other_target = random_target(&mut rng(99), &other);
        let [other_id, id] = [0, 1].map(KeyframeId);
        model.add_view(other_id, other, other_target).unwrap();
        model.add_view(id, scene.view, target.clone()).unwrap();
        model.work.find_visible(other_id).unwrap();
        let counts = model.work.find_visible(id).unwrap();
        check(&scene, &target, &model, &counts);
    }
}

fn relative_error(actual: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(actual.len(), expected.len());
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    let pairs = actual.iter().zip(expected);
    let error = norm(&mut pairs.map(|(a, b)| f64::from(a - b)));
    error / norm(&mut expected.iter().map(|x| f64::from(*x))).max(1e-30)
}

#[test]
fn splats_are_the_cpus() {
    on_all_scenes(|scene, _, model, counts| {
        let visible = counts[Count::VISIBLE as usize] as usize;
        let gaussian_of: Vec<u32> = fetch(model, "gaussian_of", visible);
        let splats: Vec<layout::Splat> = fetch(model, "splats", visible);
        assert!(gaussian_of.is_sorted_by(|a, b| a < b), "{}", scene.name);
        let expected = inspect::splats(&scene.gaussians, &scene.view);
        for (gaussian, splat) in expected {
            let Ok(at) = gaussian_of.binary_search(&gaussian) else {
                panic!("{}: gaussian {gaussian} is missing", scene.name);
            };
            let actual = splats[at];
            let numbers = [
                &actual.mean2d[..],
                &[actual.whiten_xx, actual.whiten_xy, actual.whiten_yy],
                &[actual.opacity],
                &actual.color,
                &[actual.center_depth],
                &actual.plane,
                &[actual.plane_offset],
            ]
            .concat();
            // The sign of a normal perpendicular to the ray is arbitrary.
            let faces = splat[13].abs() > 1e-4;
            for (i, (a, b)) in numbers.iter().zip(splat).enumerate() {
                let error = (a - b).abs() / (1.0 + b.abs());
                assert!(
                    error <= 1e-4 || (i >= 10 && !faces),
                    "{}: value {i} of gaussian {gaussian} is {a}, not {b}",
                    scene.name
                );
            }
        }
    });
}

#[test]
fn lists_are_sorted_and_hold_every_tile_that_the_cpus_do() {
    on_all_scenes(|scene, _, model, counts| {
        let visible = counts[Count::VISIBLE as usize] as usize;
        let entries = counts[Count::ENTRIES as usize] as usize;
        let gaussian_of: Vec<u32> = fetch(model, "gaussian_of", visible);
        let splats: Vec<layout::Splat> = fetch(model, "splats", visible);
        let keys: Vec<u32> = fetch(model, "tile_keys", entries);
        let slots: Vec<u32> = fetch(model, "slots", entries);
        let slot_splats: Vec<u32> = fetch(model, "slot_splats", entries);
        let touches: Vec<[u32; 2]> = fetch(model, "touches", visible);
        let camera = &scene.view.camera;
        let columns = camera.width.div_ceil(TILE as usize);
        let tiles = columns * camera.height.div_ceil(TILE as usize);
        let ranges: Vec<[u32; 2]> = fetch(model, "ranges", tiles);

        // Every slot occurs once, and a splat's slots are contiguous.
        let mut seen = vec![false; entries];
        for &slot in &slots {
            assert!(!std::mem::replace(&mut seen[slot as usize], true));
        }
        for (splat, [first, number]) in touches.iter().enumerate() {
            for slot in *first..first + number {
                assert_eq!(slot_splats[slot as usize] as usize, splat);
            }
        }
        // Ranges are runs of one tile, sorted by depth, then by gaussian.
        let mut pairs = std::collections::BTreeSet::new();
        let mut end_before = 0;
        for (tile, [start, end]) in ranges.into_iter().enumerate() {
            assert_eq!(start, end_before);
            end_before = end;
            let range = start as usize..end as usize;
            assert!(keys[range.clone()].iter().all(|key| *key as usize == tile));
            let order: Vec<(u32, u32)> = slots[range]
                .iter()
                .map(|slot| {
                    let splat = slot_splats[*slot as usize];
                    (splats[splat as usize].center_depth.to_bits(), splat)
                })
                .collect();
            assert!(order.is_sorted_by(|a, b| a < b), "{}", scene.name);
            pairs.extend(
                order
                    .iter()
                    .map(|(_, splat)| (tile, gaussian_of[*splat as usize])),
            );
        }
        assert_eq!(end_before as usize, entries);
        // No tile is missing in which a pixel takes the gaussian, and few are superfluous.
        let [possible, taken] = inspect::tiles(&scene.gaussians, &scene.view, TILE as usize);
        let missing: Vec<_> = taken.difference(&pairs).collect();
        assert!(missing.is_empty(), "{}: {missing:?}", scene.name);
        let (actual, most) = (pairs.len(), possible.len() + possible.len() / 20 + 3);
        assert!(
            actual <= most,
            "{}: {actual} tiles touched, not {most}",
            scene.name
        );
    });
}

#[test]
fn images_are_the_cpus() {
    on_all_scenes(|scene, _, model, _| {
        let mut rasterizer = Rasterizer::default();
        let pass = rasterizer.render(&scene.gaussians, &scene.view);
        let expected = pass.rendered();
        let pixels = scene.view.camera.width * scene.view.camera.height;
        let shown: Vec<[f32; 4]> = fetch(model, "rendered", pixels);
        let states: Vec<layout::PixelState> = fetch(model, "pixel_states", pixels);
        let mut flips = 0;
        for i in 0..pixels {
            let [r, g, b] = expected.color.data()[i];
            let actual = [shown[i][0], shown[i][1], shown[i][2], shown[i][3]];
            let wanted = [r, g, b, expected.depth_m.data()[i]];
            let alpha = 1.0 - states[i].transmittance;
            let errors = actual.iter().zip(wanted).map(|(a, b)| (a - b).abs());
            let error = errors.fold((alpha - expected.alpha.data()[i]).abs(), f32::max);
            // A gaussian with an alpha of just 1/255 may be drawn on one side only.
            assert!(error <= 0.02, "{}: pixel {i} is off by {error}", scene.name);
            flips += usize::from(error > 1e-4);
        }
        assert!(flips <= pixels / 100, "{}: {flips} of {pixels}", scene.name);
    });
}

#[test]
fn cotangents_are_the_cpus() {
    on_all_scenes(|scene, target, model, _| {
        // From the device's own image, so that only the loss is compared.
        let (rendered, pixels) = rendered_by(scene, model);
        let mut expected = Cotangents::default();
        let settings = LossSettings::default();
        photometric_loss(&rendered, target, &settings, &mut expected).unwrap();
        let actual: Vec<[f32; 4]> = fetch(model, "cotangents", pixels);
        let d_alpha: Vec<f32> = fetch(model, "d_alpha", pixels);
        let colors: Vec<f32> = actual.iter().flat_map(|d| [d[0], d[1], d[2]]).collect();
        let depths: Vec<f32> = actual.iter().map(|d| d[3]).collect();
        for (what, actual, expected) in [
            ("colour", colors, expected.d_color.data().as_flattened()),
            ("depth", depths, expected.d_depth_m.data()),
            ("alpha", d_alpha, expected.d_alpha.data()),
        ] {
            let error = relative_error(&actual, expected);
            assert!(error <= 1e-4, "{}: {what} is off by {error}", scene.name);
        }
    });
}

/// The images that the device has rendered, and their number of pixels.
fn rendered_by(scene: &Scene, model: &GpuModel) -> (crate::Rendered, usize) {
    let (width, height) = (scene.view.camera.width, scene.view.camera.height);
    let pixels = width * height;
    let shown: Vec<[f32; 4]> = fetch(model, "rendered", pixels);
    let states: Vec<layout::PixelState> = fetch(model, "pixel_states", pixels);
    let mut rendered = crate::Rendered::default();
    rendered.resize(width, height);
    for i in 0..pixels {
        let [r, g, b, depth] = shown[i];
        rendered.color.data_mut()[i] = [r, g, b];
        rendered.depth_m.data_mut()[i] = depth;
        rendered.alpha.data_mut()[i] = 1.0 - states[i].transmittance;
    }
    (rendered, pixels)
}

#[test]
fn every_gradient_is_the_cpus() {
    on_all_scenes(|scene, _, model, counts| {
        let visible = counts[Count::VISIBLE as usize] as usize;
        let pixels = scene.view.camera.width * scene.view.camera.height;
        // From the device's own cotangents, so that only the backward pass is compared.
        let by_pixel: Vec<[f32; 4]> = fetch(model, "cotangents", pixels);
        let d_alpha: Vec<f32> = fetch(model, "d_alpha", pixels);
        let mut cotangents = Cotangents::zeros(&scene.view.camera);
        for i in 0..pixels {
            let [r, g, b, depth] = by_pixel[i];
            cotangents.d_color.data_mut()[i] = [r, g, b];
            cotangents.d_depth_m.data_mut()[i] = depth;
            cotangents.d_alpha.data_mut()[i] = d_alpha[i];
        }
        let mut expected = GaussianGradients::default();
        let mut rasterizer = Rasterizer::default();
        let mut pass = rasterizer.render(&scene.gaussians, &scene.view);
        pass.vjp(&cotangents, &mut expected);

        let gaussian_of: Vec<u32> = fetch(model, "gaussian_of", visible);
        let gradients: Vec<layout::Gradient> = fetch(model, "gradients", visible);
        let mut actual = vec![layout::Gradient::default(); scene.gaussians.len()];
        for (gaussian, gradient) in gaussian_of.iter().zip(gradients) {
            actual[*gaussian as usize] = gradient;
        }
        let touched = actual
            .iter()
            .filter(|gradient| gradient.touched == 1)
            .count();
        assert_eq!(touched, counts[Count::TOUCHED as usize] as usize);
        let flips = touched.abs_diff(expected.touched.len());
        assert!(
            flips <= 2,
            "{}: {flips} flips of touched gaussians",
            scene.name
        );
        let actual: Vec<_> = expected
            .touched
            .iter()
            .map(|i| actual[*i as usize])
            .collect();
        let rows = || actual.iter().zip(&expected.gradients);
        let compare = |what: &str, pairs: Vec<(f32, f32)>| {
            let (actual, expected): (Vec<f32>, Vec<f32>) = pairs.into_iter().unzip();
            let error = relative_error(&actual, &expected);
            assert!(error <= 1e-3, "{}: {what} is off by {error}", scene.name);
        };
        compare(
            "mean",
            rows()
                .flat_map(|(a, b)| a.mean.into_iter().zip(b.d_mean))
                .collect(),
        );
        compare(
            "quat",
            rows()
                .flat_map(|(a, b)| a.quat.into_iter().zip(b.d_quat))
                .collect(),
        );
        let logs = rows().flat_map(|(a, b)| a.log_scales.into_iter().zip(b.d_log_scales));
        compare("log-scales", logs.collect());
        compare(
            "opacity",
            rows()
                .map(|(a, b)| (a.opacity_logit, b.d_opacity_logit))
                .collect(),
        );
        compare(
            "colour",
            rows()
                .flat_map(|(a, b)| a.sh.into_iter().zip(b.d_sh))
                .collect(),
        );
    });
}

/// Whether one thread or the workgroup adds up a splat's slots: in slot order, to the last bit.
#[test]
fn sums_of_few_slots_and_of_many_are_added_in_their_order() {
    let mut rng = rng(55);
    let view = random_view(&mut rng, 320, 240);
    let mut gaussians = to_f32(&random_gaussians(&mut rng, &view, 600));
    for i in (0..600).step_by(50) {
        gaussians.log_scales[i] = [0.5; 3];
        gaussians.opacity_logits[i] = -3.0;
    }
    gaussians.log_scales[51] = [-1.0; 3];
    gaussians.sh.fill([0.3; 3]);
    let scene = Scene {
        name: "large ones among small ones",
        view,
        gaussians,
    };
    let Some(mut model) = model_of(&scene, &ModelSettings::default()) else {
        return;
    };
    let id = KeyframeId(0);
    let target = random_target(&mut rng, &view);
    model.add_view(id, view, target).unwrap();
    let counts = model.work.find_visible(id).unwrap();
    let visible = counts[Count::VISIBLE as usize] as usize;
    let entries = counts[Count::ENTRIES as usize] as usize;
    let touches: Vec<[u32; 2]> = fetch(&model, "touches", visible);
    let sums: Vec<[[f32; 4]; 4]> = fetch(&model, "sums", entries);
    let gradients: Vec<layout::Gradient> = fetch(&model, "gradients", visible);
    let (mut large, mut small) = (0, 0);
    for ([first, number], gradient) in touches.iter().zip(&gradients) {
        let slots = &sums[*first as usize..(first + number) as usize];
        let taken = || slots.iter().filter(|slot| slot[3][2] > 0.0);
        assert_eq!(gradient.touched == 1, taken().count() > 0);
        if gradient.touched == 0 {
            continue;
        }
        for color in 0..3 {
            let sum = taken().fold(0.0, |sum, slot| sum + slot[0][color]);
            let expected = (SH0_FACTOR as f32) * sum;
            assert_eq!(gradient.sh[color].to_bits(), expected.to_bits());
        }
        let many = *number > 512;
        large += usize::from(many);
        small += usize::from(!many);
    }
    assert!(large > 3 && small > 100, "{large} {small}");
}
