//! The whole model against the CPU's: steps, insertion, pruning, the sparse map, covisibility; and
//! what happens when tile lists overflow or the device is lost.

use fgs_geom::{KeyframeId, Se3, View};
use nalgebra::Vector6;

use super::device::{device, open};
use super::scenes::{Scene, model_of, random_target, scenes, seeds};
use crate::cpu::tests::scenes::{random_gaussians, random_view, rng, to_f32};
use crate::gpu::gpu_model::GpuModel;
use crate::gpu::layout::Count;
use crate::gpu::readback::{WAITS, read};
use crate::gpu::stage::StageOptions;
use crate::{
    CpuModel, Gaussian, GaussianModel, Gaussians, GpuError, LossError, LossSettings, ModelError,
    ModelSettings, PruneRule, Target,
};

const RULE: PruneRule = PruneRule {
    min_opacity: 0.3,
    max_scale_m: 0.2,
    max_aspect: 4.0,
};

/// Gaussians, and three views with random targets.
struct World {
    gaussians: Gaussians,
    views: Vec<(View, Target)>,
}

fn world(count: usize) -> World {
    let mut rng = rng(77);
    let first = random_view(&mut rng, 60, 44);
    let gaussians = to_f32(&random_gaussians(&mut rng, &first, count));
    let views = (0..3)
        .map(|i| {
            let step =
                Se3::exp(&Vector6::new(0.1, 0.05, 0.0, 0.02, -0.1, 0.05).scale(f64::from(i)));
            let view = View {
                world_from_camera: first.world_from_camera * step,
                ..first
            };
            let target = random_target(&mut rng, &view);
            (view, target)
        })
        .collect();
    World { gaussians, views }
}

/// Keyframes of the world's views. All its gaussians are anchored to the first.
const IDS: [KeyframeId; 3] = [KeyframeId(0), KeyframeId(1), KeyframeId(2)];

fn fill(model: &mut impl GaussianModel, world: &World) {
    model.insert(&seeds(&world.gaussians), IDS[0]).unwrap();
    for (id, (view, target)) in IDS.iter().zip(&world.views) {
        model.add_view(*id, *view, target.clone()).unwrap();
    }
}

/// Interleaved steps, insertions and a pruning, directly followed by an insertion.
fn work(model: &mut impl GaussianModel, world: &World) {
    for round in 0..12 {
        model.step(IDS[round % IDS.len()]).unwrap();
        if round == 7 {
            model.prune(&RULE).unwrap();
        }
        if round == 4 || round == 7 {
            model.insert(&seeds(&world.gaussians), IDS[1]).unwrap();
        }
    }
}

/// A correction of a keyframe's pose.
fn motion() -> Se3 {
    Se3::exp(&Vector6::new(0.02, -0.05, 0.03, 0.05, -0.02, 0.01))
}

fn models(count: usize, settings: &ModelSettings) -> Option<(World, GpuModel, CpuModel)> {
    let gpu = GpuModel::new(device()?, settings).unwrap();
    Some((world(count), gpu, CpuModel::new(settings.clone())))
}

/// Differences of the parameters, ascending, in the order of the fields.
fn differences(a: &Gaussians, b: &Gaussians) -> [Vec<f32>; 5] {
    let sorted = |a: &[f32], b: &[f32]| {
        assert_eq!(a.len(), b.len());
        let mut errors: Vec<f32> = a.iter().zip(b).map(|(a, b)| (a - b).abs()).collect();
        errors.sort_by(f32::total_cmp);
        errors
    };
    [
        sorted(a.means.as_flattened(), b.means.as_flattened()),
        sorted(a.quats.as_flattened(), b.quats.as_flattened()),
        sorted(a.log_scales.as_flattened(), b.log_scales.as_flattened()),
        sorted(&a.opacity_logits, &b.opacity_logits),
        sorted(a.sh.as_flattened(), b.sh.as_flattened()),
    ]
}

#[test]
fn a_step_moves_every_scene_as_on_the_cpu() {
    for settings in [
        ModelSettings::default(),
        ModelSettings {
            loss: LossSettings {
                mask_color_by_depth: true,
                normalize_depth: false,
                ..LossSettings::default()
            },
            ..ModelSettings::default()
        },
    ] {
        for (seed, scene) in (0..).zip(scenes()) {
            let Some(mut gpu) = model_of(&scene, &settings) else {
                return;
            };
            let mut cpu = CpuModel::new(settings.clone());
            let id = IDS[0];
            cpu.insert(&seeds(&scene.gaussians), id).unwrap();
            let target = random_target(&mut rng(seed), &scene.view);
            gpu.add_view(id, scene.view, target.clone()).unwrap();
            cpu.add_view(id, scene.view, target).unwrap();
            gpu.step(id).unwrap();
            cpu.step(id).unwrap();
            compare_after_a_step(&scene, &settings, &mut gpu, &mut cpu);
        }
    }
}

fn compare_after_a_step(
    scene: &Scene,
    settings: &ModelSettings,
    gpu: &mut GpuModel,
    cpu: &mut CpuModel,
) {
    let (on_gpu, on_cpu) = (gpu.gaussians().unwrap(), cpu.gaussians().unwrap());
    let (gpu_stats, cpu_stats) = (gpu.take_stats(), cpu.take_stats());
    let [gpu_stats, cpu_stats] = [gpu_stats[0], cpu_stats[0]];
    let error = (gpu_stats.loss - cpu_stats.loss).abs() / (1e-3 + cpu_stats.loss);
    assert!(
        error <= 1e-3,
        "{}: {gpu_stats:?}, {cpu_stats:?}",
        scene.name
    );
    assert!(
        gpu_stats.visible.abs_diff(cpu_stats.visible) <= 2,
        "{}",
        scene.name
    );
    assert_eq!(gpu_stats.skipped_gradients, cpu_stats.skipped_gradients);

    // Adam's first step is one learning rate up or down, and the sign of a derivative close to zero
    // depends on rounding. So nearly all agree, and none is off by more than twice the rate.
    let rates = &settings.learning_rates;
    let steps = [
        rates.means,
        rates.quats,
        rates.log_scales,
        rates.opacity_logits,
        rates.sh,
    ];
    let fields = |gaussians: &Gaussians| {
        [
            gaussians.means.as_flattened().to_vec(),
            gaussians.quats.as_flattened().to_vec(),
            gaussians.log_scales.as_flattened().to_vec(),
            gaussians.opacity_logits.clone(),
            gaussians.sh.as_flattened().to_vec(),
        ]
    };
    let before = fields(&scene.gaussians);
    let pairs = fields(&on_gpu).into_iter().zip(fields(&on_cpu));
    let (mut moved, mut differing) = (0, 0);
    for ((rate, before), (on_gpu, on_cpu)) in steps.iter().zip(before).zip(pairs) {
        for ((a, b), start) in on_gpu.iter().zip(&on_cpu).zip(before) {
            if start.is_nan() {
                assert!(a.is_nan() && b.is_nan(), "{}", scene.name);
                continue;
            }
            if a.to_bits() == b.to_bits() {
                moved += usize::from(*a != start);
                continue;
            }
            let slack = 1e-6 * start.abs();
            let error = (a - b).abs();
            assert!(error <= 2.01 * rate + slack, "{}: {a}, {b}", scene.name);
            moved += 1;
            differing += usize::from(error > 0.02 * rate + slack);
        }
    }
    assert!(
        differing <= 2 + moved / 50,
        "{}: {differing} of {moved} moved otherwise",
        scene.name
    );
}

#[test]
fn many_steps_with_insertion_and_pruning_stay_with_the_cpu() {
    let Some((world, mut gpu, mut cpu)) = models(400, &ModelSettings::default()) else {
        return;
    };
    fill(&mut gpu, &world);
    fill(&mut cpu, &world);
    work(&mut gpu, &world);
    work(&mut cpu, &world);
    let lens = (gpu.len(), cpu.len());
    assert_eq!(lens.0, lens.1);
    assert!(lens.0 < 3 * world.gaussians.len());
    let (on_gpu, on_cpu) = (gpu.gaussians().unwrap(), cpu.gaussians().unwrap());
    // Twelve steps of at most a learning rate, few of them with a sign that depends on rounding.
    let rates = ModelSettings::default().learning_rates;
    let rates = [
        rates.means,
        rates.quats,
        rates.log_scales,
        rates.opacity_logits,
        rates.sh,
    ];
    for (differences, rate) in differences(&on_gpu, &on_cpu).into_iter().zip(rates) {
        let (most, largest) = (differences.len() * 98 / 100, differences.len() - 1);
        let [most, largest] = [most, largest].map(|i| differences[i] / rate);
        assert!(most <= 0.05 && largest <= 12.0, "{most} {largest}");
    }
    let losses = |stats: Vec<crate::StepStats>| -> Vec<f32> {
        stats.into_iter().map(|step| step.loss).collect()
    };
    let (gpu_losses, cpu_losses) = (losses(gpu.take_stats()), losses(cpu.take_stats()));
    assert_eq!(gpu_losses.len(), 12);
    for (a, b) in gpu_losses.iter().zip(&cpu_losses) {
        assert!((a / b - 1.0).abs() <= 2e-3, "{gpu_losses:?} {cpu_losses:?}");
    }

    let removed = gpu.take_removed().unwrap();
    assert_eq!(removed, cpu.take_removed().unwrap());
    assert!(!removed.is_empty() && gpu.take_removed().unwrap().is_empty());
}

#[test]
fn covisibility_is_the_cpus_through_pruning_and_growing() {
    let Some((world, mut gpu, mut cpu)) = models(500, &ModelSettings::default()) else {
        return;
    };
    fill(&mut gpu, &world);
    fill(&mut cpu, &world);
    // More views and gaussians than the initial capacity.
    let extra: Vec<KeyframeId> = (10..30).map(KeyframeId).collect();
    for (i, id) in extra.iter().enumerate() {
        let (view, target) = &world.views[i % 3];
        gpu.add_view(*id, *view, target.clone()).unwrap();
        cpu.add_view(*id, *view, target.clone()).unwrap();
    }
    let mut many = Gaussians::default();
    for _ in 0..40 {
        many.extend(&world.gaussians);
    }
    gpu.insert(&seeds(&many), IDS[0]).unwrap();
    cpu.insert(&seeds(&many), IDS[0]).unwrap();
    gpu.prune(&RULE).unwrap();
    cpu.prune(&RULE).unwrap();
    gpu.finish_steps().unwrap();
    assert_eq!(gpu.len(), cpu.len());
    for id in extra.iter().step_by(2) {
        gpu.drop_view(*id).unwrap();
        cpu.drop_view(*id).unwrap();
    }
    assert!(matches!(
        gpu.drop_view(extra[0]),
        Err(ModelError::NoSuchView(_))
    ));
    let ((view, target), new) = (&world.views[1], extra[0]);
    gpu.add_view(new, *view, target.clone()).unwrap();
    cpu.add_view(new, *view, target.clone()).unwrap();
    for id in [IDS[0], IDS[2], extra[1], new] {
        let (on_gpu, on_cpu) = (gpu.covisibility(id).unwrap(), cpu.covisibility(id).unwrap());
        assert_eq!(on_gpu.len(), on_cpu.len());
        for ((a_id, a), (b_id, b)) in on_gpu.iter().zip(&on_cpu) {
            assert_eq!(a_id, b_id);
            assert!((a - b).abs() <= 0.02, "{a} {b}");
        }
        assert!(on_cpu.iter().any(|(_, share)| (0.02..1.0).contains(share)));
    }
    // A set has the most in common with itself: all of it.
    let counts = gpu.work.find_visible(new).unwrap();
    gpu.covisibility(new).unwrap();
    let overlaps = gpu.work.map.buffers.get("overlaps").unwrap();
    let overlaps: Vec<u32> = read(
        gpu.work.map.device(),
        overlaps,
        0,
        gpu.work.map.buffers.sets(),
    )
    .unwrap();
    assert_eq!(
        overlaps.iter().max(),
        Some(&counts[Count::TOUCHED as usize])
    );
}

#[test]
fn what_was_seen_stays_known_when_buffers_grow() {
    let Some((world, mut gpu, _)) = models(45, &ModelSettings::default()) else {
        return;
    };
    fill(&mut gpu, &world);
    gpu.step(IDS[1]).unwrap();
    let before = IDS.map(|id| gpu.covisibility(id));
    gpu.insert(&seeds(&Gaussians::zeros(20_000)), IDS[0])
        .unwrap();
    assert_eq!(before, IDS.map(|id| gpu.covisibility(id)));
}

#[test]
fn a_render_stays_as_it_is_when_buffers_grow() {
    let Some((world, mut gpu, _)) = models(60, &ModelSettings::default()) else {
        return;
    };
    let mut large = world.gaussians;
    for log_scales in &mut large.log_scales {
        *log_scales = [1.0; 3];
    }
    gpu.insert(&seeds(&large), IDS[0]).unwrap();
    let view = View {
        camera: random_view(&mut rng(6), 256, 256).camera,
        ..world.views[0].0
    };
    let before = gpu.render(&view).unwrap();
    // There are more list entries than gaussians.
    gpu.insert(&seeds(&Gaussians::zeros(20_000)), IDS[0])
        .unwrap();
    assert!(gpu.render(&view).unwrap() == before);
}

#[test]
fn a_render_is_the_cpus() {
    let Some((world, mut gpu, mut cpu)) = models(600, &ModelSettings::default()) else {
        return;
    };
    fill(&mut gpu, &world);
    fill(&mut cpu, &world);
    let view = &world.views[2].0;
    let (on_gpu, on_cpu) = (gpu.render(view).unwrap(), cpu.render(view).unwrap());
    let pairs = on_gpu.color.data().iter().zip(on_cpu.color.data());
    let error = pairs.map(|(a, b)| (a[1] - b[1]).abs()).sum::<f32>();
    assert!(error <= 1e-3 * on_cpu.color.data().len() as f32, "{error}");
}

#[test]
fn without_room_steps_are_repeated_and_nothing_is_lost() {
    let Some(device) = device() else {
        return;
    };
    let world = world(400);
    let run = |entries| {
        let settings = ModelSettings::default();
        let mut model = GpuModel::with_room(device.clone(), &settings, 1, entries).unwrap();
        fill(&mut model, &world);
        model.work.map.buffers.shrink_entries(entries);
        for id in [IDS[0], IDS[1]] {
            model.step(id).unwrap();
            model.move_anchored(&[(IDS[0], motion())]).unwrap();
        }
        model.gaussians().unwrap();
        model.work.map.buffers.shrink_entries(entries);
        work(&mut model, &world);
        let gaussians = model.gaussians().unwrap();
        let stats = model.take_stats();
        (gaussians, stats, model.repeated_steps())
    };
    let (roomy, roomy_stats, repeated) = run(1 << 16);
    assert_eq!(repeated, 0);
    let (tight, tight_stats, repeated) = run(300);
    assert!(repeated >= 4);
    assert_eq!(tight_stats, roomy_stats);
    assert!(tight == roomy);
}

/// How many times `something` waits for the device.
fn waits(something: impl FnOnce()) -> usize {
    let before = WAITS.get();
    something();
    WAITS.get() - before
}

#[test]
fn an_ordinary_frame_does_not_wait_for_the_device() {
    let Some((world, mut gpu, _)) = models(200, &ModelSettings::default()) else {
        return;
    };
    fill(&mut gpu, &world);
    let frame = |gpu: &mut GpuModel| {
        gpu.step(IDS[0]).unwrap();
        gpu.step(IDS[1]).unwrap();
        gpu.take_stats();
        gpu.take_removed().unwrap();
        gpu.prune(&RULE).unwrap();
        gpu.move_anchored(&[(IDS[0], motion())]).unwrap();
    };
    assert_eq!(waits(|| frame(&mut gpu)), 0);
    // Later calls wait only if the queue is full, and then only for its oldest entry, so the device
    // stays busy. A pruning has two readbacks.
    for _ in 0..5 {
        assert!(waits(|| frame(&mut gpu)) <= 4);
        assert_eq!(gpu.work.in_flight(), 4);
    }
    assert!(waits(|| gpu.finish_steps().unwrap()) > 0);
}

#[test]
fn prunings_that_overtake_their_reports_remove_each_gaussian_once() {
    let Some((mut world, mut gpu, mut cpu)) = models(300, &ModelSettings::default()) else {
        return;
    };
    for (i, opacity) in world.gaussians.opacity_logits.iter_mut().enumerate() {
        *opacity = [-3.0, -1.0, 1.0][i % 3];
    }
    fill(&mut gpu, &world);
    fill(&mut cpu, &world);
    let rule = |min_opacity| PruneRule {
        min_opacity,
        ..RULE
    };
    for model in [&mut gpu as &mut dyn GaussianModel, &mut cpu] {
        model.prune(&rule(0.1)).unwrap();
        model.move_anchored(&[(IDS[0], motion())]).unwrap();
        model.prune(&rule(0.4)).unwrap();
        model.step(IDS[0]).unwrap();
    }
    // The host does not know yet how many were removed.
    assert!(gpu.len() == 300 && cpu.len() <= 100);
    assert!(gpu.take_removed().unwrap().is_empty());
    gpu.finish_steps().unwrap();
    assert_eq!(gpu.len(), cpu.len());
    let removed = gpu.take_removed().unwrap();
    assert_eq!(removed, cpu.take_removed().unwrap());
    let (on_gpu, on_cpu) = (gpu.gaussians().unwrap(), cpu.gaussians().unwrap());
    assert!(gpu.work.last_known.len() == on_gpu.len());
    let [means, ..] = differences(&on_gpu, &on_cpu);
    assert!(means[means.len() - 1] <= 2e-3, "{means:?}");
    let (on_gpu, on_cpu) = (gpu.take_stats()[0], cpu.take_stats()[0]);
    assert!((on_gpu.loss / on_cpu.loss - 1.0).abs() <= 1e-4);
}

#[test]
fn the_same_gaussians_yield_as_on_the_cpu() {
    let Some((mut world, mut gpu, mut cpu)) = models(3000, &ModelSettings::default()) else {
        return;
    };
    let inferred = &mut world.gaussians.inferred;
    (0..inferred.len()).for_each(|i| inferred[i] = i % 3 == 1);
    let view = world.views[1].0;
    let models: [&mut dyn GaussianModel; 2] = [&mut gpu, &mut cpu];
    let [on_gpu, on_cpu] = models.map(|model| {
        model.insert(&seeds(&world.gaussians), IDS[0]).unwrap();
        let target = world.views[0].1.clone();
        model.add_view(IDS[0], world.views[0].0, target).unwrap();
        model.prune(&RULE).unwrap();
        // The device learns of the survivors later.
        let depth_m = random_target(&mut rng(8), &view).depth_m().clone();
        model.fade_contradicted(&view, &depth_m).unwrap();
        let hidden = model.gaussians().unwrap();
        model.step(IDS[0]).unwrap();
        model.prune(&RULE).unwrap();
        (hidden, model.gaussians().unwrap())
    });
    assert!(on_gpu.0 == on_cpu.0);
    let is_hidden = |logit: &&f32| **logit < -70.0;
    let hidden = on_cpu.0.opacity_logits.iter().filter(is_hidden).count();
    assert!((50..500).contains(&hidden), "{hidden}");
    assert_eq!(on_gpu.1.inferred, on_cpu.1.inferred);
    let left = on_cpu.1.inferred.iter().filter(|inferred| **inferred);
    assert!(left.count() > 100);
}

#[test]
fn views_within_the_budget_stay_on_the_device_with_their_bindings() {
    let (Some(device), world) = (device(), world(50)) else {
        return;
    };
    let settings = ModelSettings::default();
    let target_bytes = 8 * 60 * 44;
    for (resident, budget) in [(5, 5 * target_bytes), (4, 5 * target_bytes - 1)] {
        let mut gpu = GpuModel::with_room(device.clone(), &settings, budget, 1 << 16).unwrap();
        gpu.insert(&seeds(&world.gaussians), IDS[0]).unwrap();
        let ids = [0, 1, 2, 3, 4].map(KeyframeId);
        for id in ids {
            let (view, target) = &world.views[id.0 as usize % 3];
            gpu.add_view(id, *view, target.clone()).unwrap();
        }
        let go_round = |gpu: &mut GpuModel| {
            ids.iter().for_each(|id| gpu.step(*id).unwrap());
            gpu.finish_steps().unwrap();
            gpu.work.map.buffers.resident()
        };
        let (before, after) = (go_round(&mut gpu), go_round(&mut gpu));
        assert_eq!(before.0.len(), resident);
        assert_eq!(before == after, resident == ids.len());
    }
}

#[test]
fn a_render_out_of_range_says_where() {
    let Some((mut world, mut gpu, mut cpu)) = models(50, &ModelSettings::default()) else {
        return;
    };
    for sh in &mut world.gaussians.sh {
        *sh = [1e6; 3];
    }
    fill(&mut gpu, &world);
    fill(&mut cpu, &world);
    // The visibility sets are valid nevertheless.
    let seen = gpu.covisibility(IDS[0]).unwrap();
    let share = cpu.covisibility(IDS[0]).unwrap()[0].1;
    assert!(share > 0.5 && (seen[0].1 - share).abs() <= 0.1);
    let wanted = cpu.step(IDS[0]);
    let Err(ModelError::Loss(LossError::OutOfRange { u, v, .. })) = wanted else {
        panic!("{wanted:?}");
    };
    let before = gpu.gaussians().unwrap();
    gpu.step(IDS[0]).unwrap();
    let found = gpu.finish_steps();
    assert!(
        matches!(found, Err(ModelError::Loss(LossError::OutOfRange { u: a, v: b, .. })) if (a, b) == (u, v)),
        "{found:?}"
    );
    assert!(gpu.gaussians().unwrap() == before);
    assert_eq!(gpu.covisibility(IDS[0]).unwrap(), seen);
}

#[test]
fn gradients_that_are_no_use_leave_everything_as_it_is() {
    let mut settings = ModelSettings::default();
    settings.loss.l1_weight = 1e30;
    let Some((world, mut gpu, mut cpu)) = models(100, &settings) else {
        return;
    };
    fill(&mut gpu, &world);
    fill(&mut cpu, &world);
    for id in [IDS[0], IDS[1]] {
        gpu.step(id).unwrap();
        cpu.step(id).unwrap();
    }
    assert!(gpu.gaussians().unwrap() == world.gaussians);
    let skipped = |model: &mut dyn FnMut() -> Vec<crate::StepStats>| -> Vec<usize> {
        let stats = model().into_iter();
        stats.map(|step| step.skipped_gradients).collect()
    };
    let on_gpu = skipped(&mut || gpu.take_stats());
    let on_cpu = skipped(&mut || cpu.take_stats());
    assert_eq!(on_gpu.len(), 2);
    for (a, b) in on_gpu.into_iter().zip(on_cpu) {
        assert!(b > 20 && a.abs_diff(b) <= 2, "{a} {b}");
    }
}

#[test]
fn a_step_sees_no_more_what_is_hidden_now() {
    let Some((world, mut gpu, mut cpu)) = models(300, &ModelSettings::default()) else {
        return;
    };
    fill(&mut gpu, &world);
    fill(&mut cpu, &world);
    let view = &world.views[0].0;
    let centre = view.camera.unproject(30.0, 22.0, 0.3);
    let mut wall = Gaussians::<f64>::default();
    for _ in 0..4 {
        wall.push(&Gaussian {
            mean: view.world_from_camera.transform(&centre).into(),
            quat: [1.0, 0.0, 0.0, 0.0],
            scales: [5.0; 3],
            opacity: 0.999,
            rgb: [0.5; 3],
        });
    }
    let wall = seeds(&to_f32(&wall));
    gpu.insert(&wall, IDS[0]).unwrap();
    cpu.insert(&wall, IDS[0]).unwrap();
    gpu.step(IDS[0]).unwrap();
    cpu.step(IDS[0]).unwrap();
    for id in IDS {
        let (on_gpu, on_cpu) = (gpu.covisibility(id).unwrap(), cpu.covisibility(id).unwrap());
        for ((_, a), (_, b)) in on_gpu.iter().zip(&on_cpu) {
            assert!((a - b).abs() <= 0.02, "{on_gpu:?} {on_cpu:?}");
        }
    }
    assert!(cpu.covisibility(IDS[0]).unwrap()[0].1 == 0.0);
}

#[test]
fn lists_are_repeated_only_if_they_do_not_fit() {
    let Some((world, mut gpu, _)) = models(200, &ModelSettings::default()) else {
        return;
    };
    fill(&mut gpu, &world);
    for missing in [0, 1] {
        let counts = gpu.work.find_visible(IDS[0]).unwrap();
        gpu.work
            .map
            .buffers
            .shrink_entries(counts[Count::ENTRIES as usize] as usize - missing);
        gpu.step(IDS[0]).unwrap();
        gpu.finish_steps().unwrap();
        assert_eq!(gpu.repeated_steps(), missing);
    }
}

#[test]
fn dropped_views_leave_their_sets_to_others() {
    let Some((world, mut gpu, _)) = models(10, &ModelSettings::default()) else {
        return;
    };
    fill(&mut gpu, &world);
    let sets = gpu.work.map.buffers.sets();
    let bytes = gpu.device_bytes();
    let (view, target) = &world.views[0];
    for _ in 0..2 * sets {
        gpu.add_view(KeyframeId(9), *view, target.clone()).unwrap();
        gpu.drop_view(KeyframeId(9)).unwrap();
    }
    assert_eq!(gpu.work.map.buffers.sets(), sets);
    assert!(gpu.device_bytes() <= bytes);
}

#[test]
fn half_a_million_gaussians_stay_in_order() {
    let Some(device) = device() else {
        return;
    };
    let mut gpu = GpuModel::new(device, &ModelSettings::default()).unwrap();
    // More blocks than one round of the scan covers.
    let count = (1 << 19) + 3000;
    let mut many = Gaussians::zeros(count);
    for i in 0..count {
        many.means[i] = [i as f32, 0.0, 0.0];
        many.log_scales[i] = [-3.0; 3];
        many.opacity_logits[i] = if i % 7 == 0 { -8.0 } else { 2.0 };
    }
    gpu.insert(&seeds(&many), IDS[0]).unwrap();
    let kept: Vec<f32> = (0..count)
        .filter(|i| i % 7 != 0)
        .map(|i| i as f32)
        .collect();
    gpu.prune(&RULE).unwrap();
    let means = gpu.gaussians().unwrap().means;
    assert!(means.iter().map(|mean| mean[0]).eq(kept));
}

#[test]
fn a_step_that_went_wrong_takes_nothing_from_the_others() {
    let Some((world, mut gpu, _)) = models(50, &ModelSettings::default()) else {
        return;
    };
    fill(&mut gpu, &world);
    gpu.step(IDS[0]).unwrap();
    let mut glaring = world.gaussians.clone();
    glaring.sh.fill([1e6; 3]);
    gpu.insert(&seeds(&glaring), IDS[0]).unwrap();
    let before = gpu.gaussians().unwrap();
    assert!(before.means[..50] != world.gaussians.means);
    gpu.step(IDS[0]).unwrap();
    assert!(Box::new(gpu).into_gaussians() == before);
}

#[test]
fn lists_longer_than_any_number_are_refused() {
    let Some(device) = device() else {
        return;
    };
    let mut gpu = GpuModel::new(device, &ModelSettings::default()).unwrap();
    let view = random_view(&mut rng(3), 1024, 1024);
    let mean = view
        .world_from_camera
        .transform(&view.camera.unproject(500.0, 500.0, 1.0));
    // 2^18 gaussians in each of 2^14 tiles: the number of touches wraps to zero in 32 bits.
    let mut everywhere = Gaussians::<f64>::default();
    everywhere.push(&Gaussian {
        mean: mean.into(),
        quat: [1.0, 0.0, 0.0, 0.0],
        scales: [5.0; 3],
        opacity: 0.9,
        rgb: [0.5; 3],
    });
    for _ in 0..18 {
        everywhere.extend(&everywhere.clone());
    }
    gpu.insert(&seeds(&to_f32(&everywhere)), IDS[0]).unwrap();
    let refused = gpu.render(&view);
    assert!(
        matches!(refused, Err(ModelError::Device(_))),
        "{:?}",
        refused.map(|_| ())
    );
    // The model is still usable.
    assert_eq!(gpu.gaussians().unwrap().len(), 1 << 18);
}

#[test]
fn a_lost_device_is_an_error_and_the_map_is_kept() {
    let lost = open(|_| StageOptions {
        by_subgroups: false,
        checked: true,
    });
    let Some(device) = lost else {
        return;
    };
    let world = world(100);
    let mut model = GpuModel::new(device.clone(), &ModelSettings::default()).unwrap();
    fill(&mut model, &world);
    model.step(IDS[0]).unwrap();
    device.raw().destroy();
    let failure = (0..20).find_map(|_| model.step(IDS[0]).err());
    assert!(
        matches!(failure, Some(ModelError::Device(GpuError::Lost(_)))),
        "{failure:?}"
    );
    assert!(model.render(&world.views[0].0).is_err());
    assert!(Box::new(model).into_gaussians() == world.gaussians);
}

#[test]
fn refusals_are_the_cpus() {
    let Some((world, mut gpu, _)) = models(10, &ModelSettings::default()) else {
        return;
    };
    fill(&mut gpu, &world);
    let nowhere = KeyframeId(99);
    assert_eq!(gpu.step(nowhere), Err(ModelError::NoSuchView(nowhere)));
    assert_eq!(
        gpu.covisibility(nowhere),
        Err(ModelError::NoSuchView(nowhere))
    );
    gpu.drop_view(IDS[0]).unwrap();
    assert_eq!(gpu.step(IDS[0]), Err(ModelError::NoSuchView(IDS[0])));
    let small = random_target(&mut rng(1), &random_view(&mut rng(2), 5, 4));
    let (view, target) = &world.views[0];
    let refused = gpu.add_view(IDS[0], *view, small);
    assert!(matches!(refused, Err(ModelError::ImageSize { .. })));
    let again = gpu.add_view(IDS[1], *view, target.clone());
    assert_eq!(again, Err(ModelError::ViewExists(IDS[1])));
    let mut ragged = seeds(&world.gaussians);
    ragged.sparse_ids.pop();
    assert_eq!(gpu.insert(&ragged, IDS[0]), Err(ModelError::RaggedSeeds));
}

/// Also with work in flight, and by way of the CPU.
#[test]
fn a_saved_model_goes_on_to_the_last_bit() {
    let Some((world, mut gpu, mut cpu)) = models(2000, &ModelSettings::default()) else {
        return;
    };
    fill(&mut gpu, &world);
    work(&mut gpu, &world);
    gpu.prune(&RULE).unwrap();
    gpu.step(IDS[0]).unwrap();
    let saved = gpu.save().unwrap();
    assert!(!saved.removed.is_empty() && !saved.sparse_ids.is_empty());
    assert!(saved.adam.steps.iter().any(|steps| *steps > 5));

    let targets = || {
        world
            .views
            .iter()
            .map(|(_, target)| target.clone())
            .collect()
    };
    cpu.restore(saved.clone(), targets()).unwrap();
    let saved_by_cpu = cpu.save().unwrap();
    assert!(saved_by_cpu == saved);
    let mut again = GpuModel::new(device().unwrap(), &ModelSettings::default()).unwrap();
    again.restore(saved_by_cpu, targets()).unwrap();
    assert!(again.save().unwrap() == saved);
    for model in [&mut gpu, &mut again] {
        model.move_anchored(&[(IDS[1], motion())]).unwrap();
        work(model, &world);
    }
    assert_eq!(again.covisibility(IDS[1]), gpu.covisibility(IDS[1]));
    assert_eq!(again.take_removed(), gpu.take_removed());
    assert!(again.save().unwrap() == gpu.save().unwrap());
}
