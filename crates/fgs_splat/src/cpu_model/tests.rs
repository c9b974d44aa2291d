//! The model's bookkeeping: views, covisibility, pruning, the sparse map, and that steps help.

use fgs_geom::{Camera, Image, Intrinsics, Se3};
use nalgebra::Vector6;

use super::*;
use crate::Gaussian;

const W: usize = 33;
const H: usize = 24;

/// A camera at the origin, turned about y by the angle.
fn view(angle_rad: f64) -> View {
    let intrinsics = Intrinsics {
        fx: 30.0,
        fy: 31.0,
        cx: 17.5,
        cy: 10.0,
    };
    View {
        camera: Camera::new(W, H, intrinsics).unwrap(),
        world_from_camera: Se3::exp(&Vector6::new(0.0, angle_rad, 0.0, 0.0, 0.0, 0.0)),
    }
}

/// A grey wall two metres ahead, every second gaussian of the sparse map.
fn wall() -> Seeds {
    let mut seeds = Seeds::default();
    for (i, (x, y)) in (-6..=6)
        .flat_map(|x| (-5..=5).map(move |y| (x, y)))
        .enumerate()
    {
        seeds.gaussians.push(&Gaussian {
            mean: [0.15 * x as f32, 0.15 * y as f32, 2.0],
            quat: [1.0, 0.0, 0.0, 0.0],
            scales: [0.08, 0.08, 1e-4],
            opacity: 0.9,
            rgb: [0.5; 3],
        });
        seeds
            .sparse_ids
            .push((i % 2 == 0).then_some(SparseId(i as u32)));
    }
    seeds
}

fn target() -> Target {
    let color = Image::from_fn(
        W,
        H,
        |u, _| if u < 16 { [200, 60, 30] } else { [20, 90, 220] },
    );
    Target::new(color, Image::filled(W, H, 2.0)).unwrap()
}

fn model() -> CpuModel {
    let mut model = CpuModel::default();
    model.insert(&wall()).unwrap();
    model
}

/// Colour and depth stretch the disks one way or another; the regulariser keeps them round by its
/// weight.
#[test]
fn the_regularizer_counts_by_its_weight() {
    let unevenness = |scale_weight: f32| {
        let mut settings = ModelSettings::default();
        settings.loss.scale_weight = scale_weight;
        let mut model = CpuModel::new(settings);
        model.insert(&wall()).unwrap();
        let id = model.add_view(view(0.0), target()).unwrap();
        for _ in 0..30 {
            model.step(id).unwrap();
        }
        let log_scales = model.gaussians().unwrap().log_scales;
        let uneven = log_scales.iter().map(|[x, y, _]| (x - y).abs());
        uneven.sum::<f32>() / log_scales.len() as f32
    };
    let [without, little, much] = [0.0, 1.0, 1e3].map(unevenness);
    assert!(without > 0.02 && much < 0.5 * without, "{without} {much}");
    assert!(much < little && little < without, "{little}");
}

#[test]
fn steps_lower_the_loss() {
    let mut model = model();
    let id = model.add_view(view(0.0), target()).unwrap();
    // A colour moves by 0.28 of the learning rate 1e-2 a step, and has up to 0.45 to go.
    for _ in 0..100 {
        model.step(id).unwrap();
    }
    let stats = model.take_stats();
    assert_eq!(stats.len(), 100);
    assert!(stats[99].loss <= 0.5 * stats[0].loss, "{stats:?}");
    assert!(stats.iter().all(|s| s.view == id && s.visible > 50));
    assert!(model.take_stats().is_empty());
}

#[test]
fn covisible_is_what_both_views_show() {
    let mut model = model();
    let ahead = model.add_view(view(0.0), target()).unwrap();
    let again = model.add_view(view(0.0), target()).unwrap();
    let aside = model.add_view(view(0.4), target()).unwrap();
    let behind = model.add_view(view(3.1), target()).unwrap();
    let shares = model.covisibility(ahead).unwrap();
    let ids: Vec<ViewId> = shares.iter().map(|(id, _)| *id).collect();
    assert_eq!(ids, [again, aside, behind]);
    assert_eq!(shares[0].1, 1.0);
    assert!((0.3..0.9).contains(&shares[1].1), "{shares:?}");
    assert_eq!(shares[2].1, 0.0);
    model.drop_view(again).unwrap();
    assert_eq!(model.covisibility(ahead).unwrap().len(), 2);
}

#[test]
fn pruning_removes_the_faint_the_long_and_the_narrow_and_nothing_else() {
    let mut model = CpuModel::default();
    let mut seeds = wall();
    let faint = -8.0;
    seeds.gaussians.opacity_logits[10] = faint;
    seeds.gaussians.log_scales[20] = [0.3f32.ln(), 0.2f32.ln(), -9.0];
    seeds.gaussians.log_scales[31] = [0.1f32.ln(), 0.009f32.ln(), -9.0];
    seeds.gaussians.means[40] = [f32::NAN; 3];
    seeds.gaussians.log_scales[40][0] = f32::NAN;
    model.insert(&seeds).unwrap();
    let ahead = model.add_view(view(0.0), target()).unwrap();
    let aside = model.add_view(view(0.4), target()).unwrap();
    let rule = PruneRule {
        min_opacity: 0.005,
        max_scale_m: 0.25,
        max_aspect: 10.0,
    };
    let count = seeds.gaussians.len();
    assert_eq!(model.prune(&rule).unwrap(), 4);
    assert_eq!(model.len(), count - 4);
    let kept: Vec<[f32; 3]> = (0..count)
        .filter(|i| ![10, 20, 31, 40].contains(i))
        .map(|i| seeds.gaussians.means[i])
        .collect();
    assert_eq!(model.gaussians().unwrap().means, kept);
    let changes = model.take_sparse_changes().unwrap();
    assert_eq!(changes.removed, [10, 20, 40].map(SparseId));
    assert_eq!(model.prune(&rule).unwrap(), 0);
    // What the views show has moved up with the gaussians.
    let before = model.covisibility(ahead).unwrap();
    model.drop_view(aside).unwrap();
    let fresh = model.add_view(view(0.4), target()).unwrap();
    let after = model.covisibility(ahead).unwrap();
    assert_eq!(before, [(aside, after[0].1)]);
    assert_eq!(after[0].0, fresh);
    model.step(ahead).unwrap();
}

#[test]
fn sparse_changes_are_those_of_the_gaussians_that_steps_touched() {
    let mut model = model();
    assert_eq!(
        model.take_sparse_changes().unwrap(),
        SparseChanges::default()
    );
    let id = model.add_view(view(0.4), target()).unwrap();
    model.step(id).unwrap();
    let moved = model.take_sparse_changes().unwrap().moved;
    let sparse = wall().sparse_ids.iter().flatten().count();
    assert!(moved.len() > 20 && moved.len() < sparse);
    let gaussians = model.gaussians().unwrap();
    for sparse in moved {
        assert_eq!(sparse.id.0 % 2, 0);
        assert_eq!(sparse.mean, gaussians.means[sparse.id.0 as usize]);
    }
    assert!(model.take_sparse_changes().unwrap().moved.is_empty());
}

#[test]
fn wrong_calls_are_refused() {
    let mut model = model();
    let id = model.add_view(view(0.0), target()).unwrap();
    model.drop_view(id).unwrap();
    assert_eq!(model.step(id), Err(ModelError::NoSuchView(id)));
    assert_eq!(model.drop_view(id), Err(ModelError::NoSuchView(id)));
    assert_eq!(model.covisibility(id), Err(ModelError::NoSuchView(id)));
    assert_ne!(model.add_view(view(0.0), target()).unwrap(), id);
    let small = Target::new(Image::filled(3, 2, [0; 3]), Image::filled(3, 2, 1.0)).unwrap();
    let refused = model.add_view(view(0.0), small);
    assert!(matches!(
        refused,
        Err(ModelError::TargetSize { actual: (3, 2), .. })
    ));
    let mut ragged = wall();
    ragged.gaussians.sh.pop();
    assert_eq!(model.insert(&ragged), Err(ModelError::RaggedSeeds));
}

#[test]
fn an_empty_map_is_black_and_can_be_stepped() {
    let mut model = CpuModel::default();
    let id = model.add_view(view(0.0), target()).unwrap();
    model.step(id).unwrap();
    let rendered = model.render(&view(0.0)).unwrap();
    assert!(rendered.color.data().iter().all(|rgb| *rgb == [0.0; 3]));
    assert!(model.is_empty());
}
