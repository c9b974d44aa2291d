//! What every backend promises about anchors, transparency and inferred gaussians, checked on each available one.

use std::cell::RefCell;

use fgs_geom::{Image, KeyframeId, Se3, View};
use nalgebra::{UnitQuaternion, Vector3, Vector6};
use rand::RngExt;

use super::*;
use crate::cpu::tests::scenes::{random_gaussians, random_view, rng, to_f32};
#[cfg(feature = "gpu")]
use crate::gpu::{GpuModel, tests::device};
use crate::rigid_motion::{RigidMotion, moved, transformed};
use crate::{CpuModel, Gaussian};

/// The first keyframe has a view and gaussians, the second only gaussians.
const FIRST: KeyframeId = KeyframeId(3);
const SECOND: KeyframeId = KeyframeId(8);
/// Gaussians of each keyframe.
const COUNT: usize = 150;

const RULE: PruneRule = PruneRule {
    min_opacity: 0.3,
    max_scale_m: 10.0,
    max_aspect: 100.0,
};

/// Calls `check` with a constructor of empty models for each backend.
fn on_each_backend(check: impl Fn(&dyn Fn(&ModelSettings) -> Box<dyn GaussianModel>)) {
    check(&|settings| Box::new(CpuModel::new(settings.clone())));
    #[cfg(feature = "gpu")]
    if let Some(device) = device() {
        check(&|settings| Box::new(GpuModel::new(device.clone(), settings).unwrap()));
    }
}

/// Gaussians of both keyframes in front of the first one's view, and what was measured there.
struct World {
    view: View,
    seeds: [Seeds; 2],
    target: Target,
}

fn world() -> World {
    let mut rng = rng(31);
    let view = random_view(&mut rng, 60, 44);
    let seeds = [0, 1].map(|keyframe| Seeds {
        gaussians: to_f32(&random_gaussians(&mut rng, &view, COUNT)),
        sparse_ids: (0..COUNT as u32)
            .map(|i| Some(SparseId(COUNT as u32 * keyframe + i)))
            .collect(),
    });
    let color = Image::from_fn(60, 44, |_, _| std::array::from_fn(|_| rng.random()));
    let depth_m = Image::from_fn(60, 44, |_, _| rng.random_range(0.5..4.0));
    let target = Target::new(color, depth_m).unwrap();
    World {
        view,
        seeds,
        target,
    }
}

impl World {
    fn fill(&self, mut model: Box<dyn GaussianModel>) -> Box<dyn GaussianModel> {
        model.insert(&self.seeds[0], FIRST).unwrap();
        let target = self.target.clone();
        model.add_view(FIRST, self.view, target).unwrap();
        model.insert(&self.seeds[1], SECOND).unwrap();
        model
    }
}

/// A correction as after a loop closure.
fn correction() -> Se3 {
    Se3::exp(&Vector6::new(0.1, -0.2, 0.15, 0.3, -0.5, 0.2))
}

/// The largest difference between two lists of vectors, per component.
fn difference<const N: usize>(a: &[[f32; N]], b: &[[f32; N]]) -> f32 {
    assert_eq!(a.len(), b.len());
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn a_world_moved_as_a_whole_looks_the_same_to_its_camera() {
    let world = world();
    on_each_backend(|new_model| {
        let mut model = world.fill(new_model(&ModelSettings::default()));
        let before = model.render(&world.view).unwrap();
        let all = [(FIRST, correction()), (SECOND, correction())];
        model.move_anchored(&all).unwrap();
        let after = model.render(&moved(&world.view, &correction())).unwrap();
        assert!(difference(before.color.data(), after.color.data()) <= 1e-4);
        let one = |image: &Image<f32>| image.map(|x| [*x]);
        let [depths, alphas] = [
            (&before.depth_m, &after.depth_m),
            (&before.alpha, &after.alpha),
        ]
        .map(|(a, b)| difference(one(a).data(), one(b).data()));
        assert!(depths <= 5e-4 && alphas <= 1e-4, "{depths} {alphas}");
        // From the old pose the render has changed.
        let elsewhere = model.render(&world.view).unwrap();
        assert!(difference(before.color.data(), elsewhere.color.data()) > 0.1);
    });
}

#[test]
fn exactly_the_gaussians_of_a_moved_keyframe_move() {
    let world = world();
    on_each_backend(|new_model| {
        let mut model = world.fill(new_model(&ModelSettings::default()));
        // Pruning must compact the anchors along with the gaussians.
        model.prune(&RULE).unwrap();
        let before = model.gaussians().unwrap();
        let faint = |seeds: &Seeds| {
            let opacities = (0..COUNT).map(|i| seeds.gaussians.opacity(i));
            opacities
                .filter(|opacity| *opacity < RULE.min_opacity)
                .count()
        };
        let firsts = COUNT - faint(&world.seeds[0]);
        assert!(firsts < COUNT && before.len() < COUNT + firsts);
        model.drop_view(FIRST).unwrap();

        let motion = RigidMotion::from(&correction());
        let moves = [(SECOND, correction()), (KeyframeId(99), correction())];
        model.move_anchored(&moves).unwrap();
        let after = model.gaussians().unwrap();
        assert!(after.means[..firsts] == before.means[..firsts]);
        assert!(after.quats[..firsts] == before.quats[..firsts]);
        let means: Vec<_> = before.means[firsts..]
            .iter()
            .map(|p| motion.apply(p))
            .collect();
        let quats: Vec<_> = before.quats[firsts..]
            .iter()
            .map(|q| transformed(&motion.left, q))
            .collect();
        assert!(difference(&after.means[firsts..], &means) <= 2e-6);
        assert!(difference(&after.quats[firsts..], &quats) <= 2e-6);
        let rest = Gaussians {
            means: before.means.clone(),
            quats: before.quats.clone(),
            ..after.clone()
        };
        assert!(rest == before);

        model
            .move_anchored(&[(SECOND, correction().inverse())])
            .unwrap();
        let back = model.gaussians().unwrap();
        assert!(difference(&back.means, &before.means) <= 4e-6);
        assert!(difference(&back.quats, &before.quats) <= 4e-6);
        // There and back in one call.
        let there_and_back = [(FIRST, correction()), (FIRST, correction().inverse())];
        model.move_anchored(&there_and_back).unwrap();
        let back = model.gaussians().unwrap();
        assert!(difference(&back.means, &before.means) <= 4e-6);
    });
}

/// The losses of 20 steps, with a motion of everything after the first five.
fn losses(mut model: Box<dyn GaussianModel>, motion: Option<Se3>) -> Vec<f32> {
    for _ in 0..5 {
        model.step(FIRST).unwrap();
    }
    if let Some(motion) = motion {
        model
            .move_anchored(&[(FIRST, motion), (SECOND, motion)])
            .unwrap();
    }
    for _ in 0..15 {
        model.step(FIRST).unwrap();
    }
    model.gaussians().unwrap();
    model.take_stats().iter().map(|step| step.loss).collect()
}

/// Adam treats coordinates independently. After a rotation that permutes or flips axes it must go on
/// as if nothing had happened; after one that mixes them, nearly so.
#[test]
fn optimisation_goes_on_through_a_motion_of_everything() {
    let world = world();
    let turn = |axis: [f64; 3], angle: f64| {
        let axis = nalgebra::Unit::new_normalize(Vector3::from(axis));
        let rotation = UnitQuaternion::from_axis_angle(&axis, angle);
        Se3::new(rotation, Vector3::new(0.2, -0.1, 0.3))
    };
    // Half a turn permutes the quaternion's components, a third of a turn the axes of the means.
    let third = 2.0 * std::f64::consts::FRAC_PI_3;
    let still = LearningRates {
        quats: 0.0,
        ..LearningRates::default()
    };
    for (motion, learning_rates, tolerance) in [
        (
            turn([0.0, 1.0, 0.0], 1.5 * third),
            LearningRates::default(),
            2e-4,
        ),
        (turn([1.0, 1.0, 1.0], third), still, 2e-4),
        (correction(), LearningRates::default(), 2e-2),
    ] {
        let settings = ModelSettings {
            learning_rates,
            ..ModelSettings::default()
        };
        on_each_backend(|new_model| {
            let without = losses(world.fill(new_model(&settings)), None);
            let with = losses(world.fill(new_model(&settings)), Some(motion));
            assert!(without[19] < 0.9 * without[0]);
            for (a, b) in without.iter().zip(&with) {
                assert!((a / b - 1.0).abs() <= tolerance, "{without:?} {with:?}");
            }
        });
    }
}

#[test]
fn motions_that_are_not_finite_move_nothing() {
    let world = world();
    on_each_backend(|new_model| {
        let mut model = world.fill(new_model(&ModelSettings::default()));
        for value in [f64::NAN, f64::INFINITY, 1e300] {
            let mut motion = correction();
            motion.translation.y = value;
            let refused = model.move_anchored(&[(FIRST, correction()), (SECOND, motion)]);
            assert_eq!(refused, Err(ModelError::NotFinite(SECOND)));
        }
        let means = model.gaussians().unwrap().means;
        assert!(means[..COUNT] == world.seeds[0].gaussians.means);
    });
}

#[test]
fn one_sees_through_where_alpha_is_below_the_limit() {
    let world = world();
    let on_cpu = CpuModel::new(ModelSettings::default());
    let alpha = world
        .fill(Box::new(on_cpu))
        .render(&world.view)
        .unwrap()
        .alpha;
    on_each_backend(|new_model| {
        let mut model = world.fill(new_model(&ModelSettings::default()));
        for min_alpha in [0.3, 0.7, 0.99] {
            let through = model.see_through(&world.view, min_alpha).unwrap();
            assert_eq!((through.width(), through.height()), (60, 44));
            let mut counts = [0, 0];
            for (through, alpha) in through.data().iter().zip(alpha.data()) {
                // Close to the limit rounding may decide either way.
                if (alpha - min_alpha).abs() > 1e-3 {
                    assert_eq!(*through, *alpha < min_alpha, "{alpha}");
                    counts[usize::from(*through)] += 1;
                }
            }
            assert!(counts.iter().all(|count| *count > 50), "{counts:?}");
        }
    });
}

#[test]
fn gaussians_yield_to_what_is_measured_behind_them() {
    let view = random_view(&mut rng(5), 60, 44);
    // A wall at two metres; nothing measured on the right, in one way or another.
    let depth_m = Image::from_fn(60, 44, |u, v| match u {
        0..30 => 2.0,
        _ => [0.0, f32::NAN, f32::INFINITY, -1.0][v % 4],
    });
    // Pixel, depth, whether it is inferred, and whether it is hidden.
    let cases = [
        (10.4, 20.0, 0.8, true, true),
        (29.4, 0.6, 1.88, true, true),
        (-0.4, 43.4, 1.88, true, true),
        (10.4, 20.0, 1.92, true, false),
        (10.4, 20.0, 0.8, false, false),
        (10.4, 20.0, 1.7, false, false),
        (10.4, 20.0, 2.2, true, false),
        (29.6, 20.0, 0.8, true, false),
        (40.0, 20.0, 0.8, true, false),
        (40.0, 21.0, 0.8, true, false),
        (40.0, 22.0, 0.8, true, false),
        (40.0, 23.0, 0.8, true, false),
        (-0.6, 20.0, 0.8, true, false),
        (10.0, 43.6, 0.8, true, false),
        (10.0, -0.6, 0.8, true, false),
        (10.4, 20.0, -0.8, true, false),
        (f64::NAN, 20.0, 0.8, true, false),
    ];
    let mut seeds = Seeds::default();
    for (u, v, z, inferred, _) in cases {
        let point = view.camera.unproject(u, v, z);
        seeds.gaussians.push(&Gaussian {
            mean: view.world_from_camera.transform(&point).cast().into(),
            quat: [1.0, 0.0, 0.0, 0.0],
            scales: [0.01; 3],
            opacity: 0.9,
            rgb: [0.5; 3],
        });
        let last = seeds.gaussians.len() - 1;
        seeds.gaussians.inferred[last] = inferred;
        let id = SparseId(last as u32);
        seeds.sparse_ids.push((!inferred).then_some(id));
    }
    on_each_backend(|new_model| {
        let mut model = new_model(&ModelSettings::default());
        model.insert(&seeds, FIRST).unwrap();
        model.fade_contradicted(&view, &depth_m).unwrap();
        let after = model.gaussians().unwrap();
        assert_eq!(after.inferred, cases.map(|case| case.3));
        let hidden = |i: usize| after.opacity(i) < 1e-6;
        assert_eq!(std::array::from_fn(hidden), cases.map(|case| case.4));
        for (i, (_, _, z, inferred, hidden)) in cases.iter().enumerate() {
            let fades = !inferred && *z < 1.6;
            let expected = seeds.gaussians.opacity_logits[i] - if fades { 2.0 } else { 0.0 };
            assert!(*hidden || after.opacity_logits[i] == expected, "{i}");
        }
        model.prune(&RULE).unwrap();
        let kept = model.gaussians().unwrap();
        assert_eq!(kept.opacity_logits, after.opacity_logits[3..]);
        assert_eq!(kept.inferred, seeds.gaussians.inferred[3..]);
        assert_eq!(model.take_removed(), Ok(vec![]));

        let small = model.fade_contradicted(&view, &Image::filled(44, 60, 2.0));
        assert!(matches!(small, Err(ModelError::ImageSize { .. })));
        let mut both = seeds.clone();
        both.sparse_ids[0] = Some(SparseId(1));
        assert_eq!(
            model.insert(&both, FIRST),
            Err(ModelError::InferredSparseSeed)
        );
    });
}

#[test]
fn a_guess_that_the_camera_has_come_near_yields_to_what_all_of_it_hides() {
    let view = random_view(&mut rng(5), 60, 44);
    // A wall at two metres, with nothing measured right of column 30.
    let depth_m = Image::from_fn(60, 44, |u, _| if u < 30 { 2.0 } else { 0.0 });
    // Column, depth, width in pixels, and whether it is hidden.
    let cases = [
        (33.0, 0.3, 10.0, true),
        (-6.0, 0.3, 10.0, true),
        // It looks as small as a seed.
        (33.0, 0.3, 4.0, false),
        // It hides nothing that was measured, or is not before it.
        (45.0, 0.3, 10.0, false),
        (33.0, 1.95, 10.0, false),
    ];
    let mut seeds = Seeds::default();
    for (u, z, width_px, _) in cases {
        let point = view.camera.unproject(u, 20.0, z);
        let scale = (width_px * z / view.camera.intrinsics.fx) as f32;
        seeds.gaussians.push(&Gaussian {
            mean: view.world_from_camera.transform(&point).cast().into(),
            quat: [1.0, 0.0, 0.0, 0.0],
            scales: [0.001, scale, 0.001],
            opacity: 0.9,
            rgb: [0.5; 3],
        });
        seeds.sparse_ids.push(None);
    }
    seeds.gaussians.inferred.fill(true);
    on_each_backend(|new_model| {
        let mut model = new_model(&ModelSettings::default());
        model.insert(&seeds, FIRST).unwrap();
        model.fade_contradicted(&view, &depth_m).unwrap();
        let after = model.gaussians().unwrap();
        let hidden = |i: usize| after.opacity(i) < 1e-6;
        assert_eq!(std::array::from_fn(hidden), cases.map(|case| case.3));
    });
}

#[test]
fn a_keyframe_of_another_exposure_is_brought_to_the_maps() {
    let World { view, .. } = world();
    // A wall of many colours before the camera.
    let mut wall = Gaussians::default();
    for v in 0..48_u32 {
        for u in 0..64_u32 {
            let in_camera = (view.camera).unproject(f64::from(u), f64::from(v), 2.0);
            let tone = 0.25 + 0.4 * ((u / 16 + 3 * (v / 16)) % 5) as f32 / 5.0;
            let mean = view.world_from_camera.transform(&in_camera);
            wall.push(&Gaussian {
                mean: mean.cast::<f32>().into(),
                quat: [1.0, 0.0, 0.0, 0.0],
                scales: [0.03; 3],
                opacity: 0.95,
                rgb: [tone, 0.8 * tone, 1.0 - tone],
            });
        }
    }
    let seeds = Seeds {
        sparse_ids: vec![None; wall.len()],
        gaussians: wall,
    };
    let colour_alone = ModelSettings {
        loss: LossSettings {
            scale_weight: 0.0,
            ssim_weight: 0.0,
            depth_weight: 0.0,
            ..LossSettings::default()
        },
        ..ModelSettings::default()
    };
    on_each_backend(|new| {
        let first_loss = |is_matched: bool| {
            let mut model = new(&colour_alone);
            model.insert(&seeds, SECOND).unwrap();
            let shown = model.render(&view).unwrap();
            let other = |value: f32| (255.0 * (0.7 * value + 0.05)) as u8;
            let color = shown.color.map(|pixel| pixel.map(other));
            let depth_m = Image::from_fn(60, 44, |u, v| shown.surface_depth_m(u, v));
            let target = Target::new(color, depth_m).unwrap();
            model.add_view(FIRST, view, target).unwrap();
            if is_matched {
                model.match_exposure(FIRST).unwrap();
            }
            model.step(FIRST).unwrap();
            // A device tells of a step when it is asked for something that waits for it.
            model.gaussians().unwrap();
            assert_eq!(
                model.match_exposure(SECOND),
                Err(ModelError::NoSuchView(SECOND))
            );
            model.take_stats()[0].loss
        };
        let (before, after) = (first_loss(false), first_loss(true));
        assert!(after <= 0.3 * before, "{before}, {after}");
    });
}

#[test]
fn what_is_removed_is_gone_with_all_of_its_state() {
    let world = world();
    on_each_backend(|new_model| {
        let mut model = world.fill(new_model(&ModelSettings::default()));
        model.step(FIRST).unwrap();
        let before = model.save().unwrap();
        model.remove(&[2 * COUNT, usize::MAX]).unwrap();
        assert!(model.save().unwrap() == before);

        let is_gone = |i: usize| i % 3 == 1;
        let gone: Vec<usize> = (0..2 * COUNT).filter(|i| is_gone(*i)).collect();
        model.remove(&gone).unwrap();
        let ids = |i: &usize| SparseId(*i as u32);
        assert!(
            model
                .take_removed()
                .unwrap()
                .iter()
                .copied()
                .eq(gone.iter().map(ids))
        );
        let after = model.save().unwrap();
        let kept: Vec<usize> = (0..2 * COUNT).filter(|i| !is_gone(*i)).collect();
        for (now, i) in kept.iter().enumerate() {
            assert_eq!(after.gaussians.means[now], before.gaussians.means[*i]);
            assert_eq!(after.anchors[now], before.anchors[*i]);
            for (after, before) in after.views.iter().zip(&before.views) {
                let bit = |words: &[u32], i: usize| words[i / 32] >> (i % 32) & 1;
                assert_eq!(bit(&after.visible, now), bit(&before.visible, *i));
            }
        }
        model.step(FIRST).unwrap();
    });
}

#[test]
fn a_full_map_lets_go_of_what_is_seen_least_and_reports_it() {
    let world = world();
    let left = RefCell::new(Vec::new());
    on_each_backend(|new_model| {
        let mut model = world.fill(new_model(&ModelSettings::default()));
        let before = model.gaussians().unwrap();
        model.make_room(100, 2 * COUNT + 100).unwrap();
        assert!(model.gaussians().unwrap() == before);
        assert!(model.take_removed().unwrap().is_empty());

        // 100 more, and a sixteenth of 300.
        model.make_room(100, 2 * COUNT).unwrap();
        assert_eq!(model.len(), 2 * COUNT - 118);
        let removed = model.take_removed().unwrap();
        assert_eq!(removed.len(), 118);
        let after = model.gaussians().unwrap();
        let kept = (0..2 * COUNT).filter(|i| !removed.contains(&SparseId(*i as u32)));
        assert!(
            kept.map(|i| before.means[i])
                .eq(after.means.iter().copied())
        );
        // No view shows the second keyframe's: of them the more transparent are gone.
        let opacities = |is_removed: bool| {
            let before = &before;
            let second = COUNT..2 * COUNT;
            let is_gone = |i: &usize| removed.contains(&SparseId(*i as u32));
            second
                .filter(move |i| is_gone(i) == is_removed)
                .map(move |i| before.opacity(i))
        };
        let most = opacities(true).fold(0.0, f32::max);
        assert!(opacities(true).count() > 60 && opacities(false).all(|o| o >= most));
        left.borrow_mut().push(removed);

        // The rest goes on as before.
        model.step(FIRST).unwrap();
        model.make_room(0, 1).unwrap();
        assert_eq!(model.len(), 1);
    });
    let left = left.borrow();
    assert!(left.iter().all(|removed| *removed == left[0]));
}
