//! The same calls give the same bits when repeated, and with or without subgroup operations. Without
//! bounds checks the compiled code differs, and results agree up to rounding.

use fgs_geom::KeyframeId;

use super::device::{device, open};
use super::scenes::{random_target, seeds};
use crate::cpu::tests::scenes::{random_gaussians, random_view, rng, to_f32};
use crate::gpu::gpu_model::GpuModel;
use crate::gpu::stage::StageOptions;
use crate::{GaussianModel, Gaussians, GpuDevice, ModelSettings, PruneRule, StepStats};

/// A short run: insertion, three views, steps and prunings.
fn live(device: GpuDevice) -> (Gaussians, Vec<StepStats>) {
    let mut rng = rng(5);
    let mut model = GpuModel::with_room(device, &ModelSettings::default(), 1, 1 << 16).unwrap();
    let views = [(90, 60), (33, 70)].map(|(width, height)| random_view(&mut rng, width, height));
    for round in 0..3 {
        let view = views[round % 2];
        let new = to_f32(&random_gaussians(&mut rng, &view, 1500));
        let id = KeyframeId(round as u32);
        model.insert(&seeds(&new), id).unwrap();
        let target = random_target(&mut rng, &view);
        model.add_view(id, view, target).unwrap();
        for _ in 0..4 {
            model.step(id).unwrap();
        }
        model
            .prune(&PruneRule {
                min_opacity: 0.1,
                max_scale_m: 1.0,
                max_aspect: 10.0,
            })
            .unwrap();
    }
    let gaussians = model.gaussians().unwrap();
    (gaussians, model.take_stats())
}

#[test]
fn the_same_bits_every_time() {
    let Some(device) = device() else {
        return;
    };
    // Its subgroup operations passed the check, or it has none.
    let left_out = |caveat: &&str| caveat.contains("subgroup operations disabled");
    assert!(!device.caveats().iter().any(left_out));
    let first = live(device.clone());
    assert_eq!(first.1.len(), 12);
    for _ in 0..3 {
        assert!(live(device.clone()) == first);
    }
}

#[test]
fn the_same_bits_by_other_scans_and_nearly_the_same_unchecked() {
    let Some(device) = device() else {
        return;
    };
    let (gaussians, stats) = live(device);
    let by_other_scans = open(|_| StageOptions {
        by_subgroups: false,
        checked: true,
    });
    assert!(live(by_other_scans.unwrap()) == (gaussians.clone(), stats.clone()));
    // A compiler may fuse other multiply-adds in unchecked code; but an access that the checks have
    // prevented would change more than rounding.
    for by_subgroups in [false, true] {
        let unchecked = open(|features| StageOptions {
            by_subgroups: by_subgroups && features.contains(wgpu::Features::SUBGROUP),
            checked: false,
        });
        let (unchecked, unchecked_stats) = live(unchecked.unwrap());
        for (a, b) in unchecked_stats.iter().zip(&stats) {
            assert!((a.loss / b.loss - 1.0).abs() <= 1e-5, "{a:?} {b:?}");
            assert!(a.visible.abs_diff(b.visible) <= 1, "{a:?} {b:?}");
        }
        let means = |gaussians: &Gaussians| gaussians.means.as_flattened().to_vec();
        let pairs = means(&unchecked).into_iter().zip(means(&gaussians));
        let furthest = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(furthest <= 1e-3, "{furthest}");
    }
}
