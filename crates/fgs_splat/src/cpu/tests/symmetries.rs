//! What must not change a render, and inputs that must not break it.

use fgs_geom::{Instructions, Se3, View};
use nalgebra::{Quaternion, Vector3, Vector6};
use rand::RngExt;

use super::gradients::{cotangents_to_f32, gradient_rows, random_cotangents, vjp};
use super::scenes::{random_gaussians, random_view, rng, to_f32};
use super::values::render;
use crate::cpu::Rasterizer;
use crate::kernel::ONLY;
use crate::{GaussianGradients, Gaussians};

fn permute(gaussians: &Gaussians<f64>, order: &[usize]) -> Gaussians<f64> {
    Gaussians {
        means: order.iter().map(|&i| gaussians.means[i]).collect(),
        quats: order.iter().map(|&i| gaussians.quats[i]).collect(),
        log_scales: order.iter().map(|&i| gaussians.log_scales[i]).collect(),
        opacity_logits: order.iter().map(|&i| gaussians.opacity_logits[i]).collect(),
        sh: order.iter().map(|&i| gaussians.sh[i]).collect(),
        inferred: order.iter().map(|&i| gaussians.inferred[i]).collect(),
    }
}

fn scene(seed: u64) -> (Gaussians<f64>, View) {
    let mut rng = rng(seed);
    let view = random_view(&mut rng, 50, 37);
    let gaussians = random_gaussians(&mut rng, &view, 80);
    (gaussians, view)
}

#[test]
fn the_order_of_storage_does_not_matter() {
    let (gaussians, view) = scene(1);
    let backwards: Vec<usize> = (0..gaussians.len()).rev().collect();
    let permuted = permute(&gaussians, &backwards);
    let (once, again) = (to_f32(&gaussians), to_f32(&permuted));
    assert_eq!(render(&once, &view), render(&again, &view));
    let cotangents = cotangents_to_f32(&random_cotangents(&mut rng(2), &view));
    let rows = gradient_rows(&vjp(&once, &view, &cotangents), once.len());
    let mut permuted_rows = gradient_rows(&vjp(&again, &view, &cotangents), again.len());
    permuted_rows.reverse();
    assert_eq!(rows, permuted_rows);
}

#[test]
fn culled_gaussians_do_not_matter() {
    let (gaussians, view) = scene(3);
    let clean = to_f32(&gaussians);
    let mut all = clean.clone();
    let camera = view.world_from_camera;
    for axis_point in [[0.0, 0.0, -1.0], [0.0, 0.0, 0.1], [90.0, 0.0, 1.0]] {
        let mean = camera.transform(&Vector3::from(axis_point));
        all.means
            .insert(0, [mean.x as f32, mean.y as f32, mean.z as f32]);
        all.quats.insert(0, [1.0, 0.0, 0.0, 0.0]);
        all.log_scales.insert(0, [-3.0; 3]);
        all.opacity_logits.insert(0, 3.0);
        all.sh.insert(0, [1.0; 3]);
    }
    assert_eq!(render(&clean, &view), render(&all, &view));
    let cotangents = cotangents_to_f32(&random_cotangents(&mut rng(4), &view));
    let gradients = vjp(&all, &view, &cotangents);
    let rows = gradient_rows(&gradients, all.len());
    assert!(rows[..3].iter().flatten().all(|&d| d == 0.0));
    assert!(gradients.touched.iter().all(|&index| index >= 3));
    assert_eq!(
        rows[3..],
        gradient_rows(&vjp(&clean, &view, &cotangents), clean.len())
    );
}

/// The linearisation is clamped about the image's middle, so only gaussians well inside can be
/// compared.
#[test]
fn a_crop_at_tiles_shows_the_same() {
    let mut rng = rng(5);
    let view = random_view(&mut rng, 64, 48);
    let mut gaussians = random_gaussians(&mut rng, &view, 120);
    for i in 0..gaussians.len() {
        let (u, v) = (rng.random_range(18.0..46.0), rng.random_range(18.0..30.0));
        let mean = view.camera.unproject(u, v, rng.random_range(0.5..4.0));
        gaussians.means[i] = view.world_from_camera.transform(&mean).into();
    }
    let mut cropped = view;
    cropped.camera.width = 32;
    cropped.camera.height = 16;
    cropped.camera.intrinsics.cx -= 16.0;
    cropped.camera.intrinsics.cy -= 16.0;
    let whole = render(&gaussians, &view);
    let part = render(&gaussians, &cropped);
    for v in 0..16 {
        for u in 0..32 {
            let (whole, part) = (whole.color.at(u + 16, v + 16), part.color.at(u, v));
            for (whole, part) in whole.iter().zip(part) {
                assert!((whole - part).abs() <= 1e-12);
            }
        }
    }
    assert!(part.alpha.data().iter().sum::<f64>() > 100.0);
}

#[test]
fn camera_and_scene_move_together() {
    let (gaussians, view) = scene(6);
    let motion = Se3::exp(&Vector6::new(0.7, -0.5, 0.9, 1.0, -2.0, 0.5));
    let mut moved = gaussians.clone();
    for (mean, quat) in moved.means.iter_mut().zip(&mut moved.quats) {
        *mean = motion.transform(&Vector3::from(*mean)).into();
        let [w, x, y, z] = *quat;
        let turned = motion.rotation.into_inner() * Quaternion::new(w, x, y, z);
        *quat = [turned.w, turned.i, turned.j, turned.k];
    }
    let moved_view = View {
        world_from_camera: motion * view.world_from_camera,
        ..view
    };
    let (here, there) = (render(&gaussians, &view), render(&moved, &moved_view));
    for (a, b) in here.color.data().iter().zip(there.color.data()) {
        assert!((a[0] - b[0]).abs() <= 1e-10);
    }
    for (a, b) in here.depth_m.data().iter().zip(there.depth_m.data()) {
        assert!((a - b).abs() <= 1e-10);
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let mut rng = rng(8);
    let view = random_view(&mut rng, 150, 90);
    // Several chunks of gaussians.
    let gaussians = to_f32(&random_gaussians(&mut rng, &view, 9000));
    let cotangents = cotangents_to_f32(&random_cotangents(&mut rng, &view));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().unwrap();
        pool.install(|| {
            let mut rasterizer = Rasterizer::default();
            let mut gradients = GaussianGradients::default();
            // The second pass reuses the memory of the first.
            [(); 2].map(|()| {
                let mut pass = rasterizer.render(&gaussians, &view);
                pass.vjp(&cotangents, &mut gradients);
                (pass.rendered().clone(), pass.visible(), gradients.clone())
            })
        })
    };
    let [first, second] = run(1);
    assert!(first.1.len() > 100);
    assert_eq!(first.1, first.2.touched);
    assert_eq!(first, second);
    assert_eq!([first, second], run(16));
}

/// On every instruction set that this processor has the results differ by rounding only.
#[test]
fn instruction_sets_agree_but_for_rounding() {
    let (gaussians, view) = scene(18);
    let gaussians = to_f32(&gaussians);
    let cotangents = cotangents_to_f32(&random_cotangents(&mut rng(19), &view));
    let run = |set: Instructions| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        pool.unwrap().install(|| {
            ONLY.set(Some(set));
            let rows = gradient_rows(&vjp(&gaussians, &view, &cotangents), gaussians.len());
            let mut values = render(&gaussians, &view).color.data().concat();
            values.extend(rows.concat());
            values
        })
    };
    let norm = |values: &mut dyn Iterator<Item = f32>| values.map(|x| x * x).sum::<f32>().sqrt();
    let plain = run(Instructions::Plain);
    let size = norm(&mut plain.iter().copied());
    for set in Instructions::ALL
        .into_iter()
        .filter(|set| set.is_available())
    {
        let values = run(set);
        let difference = norm(&mut plain.iter().zip(&values).map(|(a, b)| a - b));
        assert!(
            size > 1.0 && difference <= 1e-5 * size,
            "{set}: {difference} of {size}"
        );
    }
}

#[test]
fn memory_of_another_scene_does_not_show() {
    let (gaussians, view) = scene(9);
    let (other, other_view) = {
        let mut rng = rng(10);
        let view = random_view(&mut rng, 70, 20);
        (random_gaussians(&mut rng, &view, 200), view)
    };
    let cotangents = random_cotangents(&mut rng(11), &view);
    let mut rasterizer = Rasterizer::default();
    let mut gradients = GaussianGradients::default();
    let other_cotangents = random_cotangents(&mut rng(12), &other_view);
    rasterizer
        .render(&other, &other_view)
        .vjp(&other_cotangents, &mut gradients);
    let mut pass = rasterizer.render(&gaussians, &view);
    assert_eq!(*pass.rendered(), render(&gaussians, &view));
    pass.vjp(&cotangents, &mut gradients);
    assert_eq!(gradients, vjp(&gaussians, &view, &cotangents));
}

#[test]
fn visible_means_contributing() {
    let (gaussians, view) = scene(13);
    let mut rasterizer = Rasterizer::default();
    let pass = rasterizer.render(&gaussians, &view);
    let (whole, visible) = (pass.rendered().clone(), pass.visible());
    let mut hidden = 0;
    for i in 0..gaussians.len() {
        let others: Vec<usize> = (0..gaussians.len()).filter(|&j| j != i).collect();
        let without = render(&permute(&gaussians, &others), &view);
        assert_eq!(without != whole, visible.contains(&(i as u32)), "{i}");
        hidden += usize::from(without == whole);
    }
    assert!((5..75).contains(&hidden), "{hidden}");
}

#[test]
fn damaged_gaussians_are_not_drawn_or_finite() {
    let (gaussians, view) = scene(14);
    let clean = to_f32(&gaussians);
    let cotangents = cotangents_to_f32(&random_cotangents(&mut rng(15), &view));
    let poisons = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        1e38,
        -1e38,
        1e-40,
        0.0,
        1e9,
        -1e9,
        80.0,
        20.0,
    ];
    for poison in poisons {
        for component in 0..15 {
            let mut damaged = clean.clone();
            for i in (0..damaged.len()).step_by(2) {
                match component {
                    0..3 => damaged.means[i][component] = poison,
                    3..7 => damaged.quats[i][component - 3] = poison,
                    7..10 => damaged.log_scales[i][component - 7] = poison,
                    10 => damaged.opacity_logits[i] = poison,
                    11..14 => damaged.sh[i][component - 11] = poison,
                    _ => damaged.quats[i] = [poison; 4],
                }
            }
            let rendered = render(&damaged, &view);
            let mut images = rendered.color.data().concat();
            images.extend(rendered.depth_m.data());
            images.extend(rendered.alpha.data());
            assert!(images.iter().all(|x| x.is_finite()), "{poison} {component}");
            let rows = gradient_rows(&vjp(&damaged, &view, &cotangents), damaged.len());
            assert!(
                rows.iter().flatten().all(|x| x.is_finite()),
                "gradient {poison} {component}"
            );
            if !poison.is_finite() {
                let odd: Vec<usize> = (1..clean.len()).step_by(2).collect();
                let rest = to_f32(&permute(&gaussians, &odd));
                assert_eq!(rendered, render(&rest, &view), "{poison} {component}");
            }
        }
    }
}

#[test]
fn an_empty_map_is_black() {
    let (_, view) = scene(16);
    let empty = Gaussians::<f32>::default();
    let rendered = render(&empty, &view);
    assert!(rendered.alpha.data().iter().all(|&alpha| alpha == 0.0));
    let cotangents = cotangents_to_f32(&random_cotangents(&mut rng(17), &view));
    assert_eq!(
        vjp(&empty, &view, &cotangents),
        GaussianGradients::default()
    );
}
