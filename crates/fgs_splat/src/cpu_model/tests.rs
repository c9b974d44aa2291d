//! The model's bookkeeping: views, covisibility, pruning, the sparse map, and that steps help.

use fgs_geom::{Camera, Image, Intrinsics, KeyframeId, Se3};
use nalgebra::Vector6;

use super::*;
use crate::{Gaussian, SavedModel};

const W: usize = 33;
const H: usize = 24;

/// The keyframe of most tests.
const KEYFRAME: KeyframeId = KeyframeId(7);

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
    model.insert(&wall(), KEYFRAME).unwrap();
    model
}

/// Colour and depth losses stretch the disks; the regulariser keeps them round, more so with a larger
/// weight.
#[test]
fn the_regularizer_counts_by_its_weight() {
    let unevenness = |scale_weight: f32| {
        let mut settings = ModelSettings::default();
        settings.loss.scale_weight = scale_weight;
        let mut model = CpuModel::new(settings);
        model.insert(&wall(), KEYFRAME).unwrap();
        model.add_view(KEYFRAME, view(0.0), target()).unwrap();
        for _ in 0..30 {
            model.step(KEYFRAME).unwrap();
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
    model.add_view(KEYFRAME, view(0.0), target()).unwrap();
    // A step moves a colour by about 0.28 of the decaying learning rate 2e-2; up to 0.45 is needed.
    for _ in 0..100 {
        model.step(KEYFRAME).unwrap();
    }
    let stats = model.take_stats();
    assert_eq!(stats.len(), 100);
    assert!(stats[99].loss <= 0.5 * stats[0].loss, "{stats:?}");
    assert!(stats.iter().all(|s| s.view == KEYFRAME && s.visible > 50));
    assert!(model.take_stats().is_empty());
}

#[test]
fn covisible_is_what_both_views_show() {
    let mut model = model();
    let [behind, again, ahead, aside] = [0, 2, 3, 5].map(KeyframeId);
    for (id, angle) in [(ahead, 0.0), (again, 0.0), (aside, 0.4), (behind, 3.1)] {
        model.add_view(id, view(angle), target()).unwrap();
    }
    let shares = model.covisibility(ahead).unwrap();
    let ids: Vec<KeyframeId> = shares.iter().map(|(id, _)| *id).collect();
    assert_eq!(ids, [behind, again, aside]);
    assert_eq!(shares[0].1, 0.0);
    assert_eq!(shares[1].1, 1.0);
    assert!((0.3..0.9).contains(&shares[2].1), "{shares:?}");
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
    // Of either sign.
    seeds.gaussians.log_scales[40][0] = f32::NAN;
    seeds.gaussians.log_scales[45][1] = -f32::NAN;
    model.insert(&seeds, KEYFRAME).unwrap();
    let [ahead, aside, fresh] = [0, 1, 2].map(KeyframeId);
    model.add_view(ahead, view(0.0), target()).unwrap();
    model.add_view(aside, view(0.4), target()).unwrap();
    let rule = PruneRule {
        min_opacity: 0.005,
        max_scale_m: 0.25,
        max_aspect: 10.0,
    };
    let count = seeds.gaussians.len();
    model.prune(&rule).unwrap();
    assert_eq!(model.len(), count - 5);
    let kept: Vec<[f32; 3]> = (0..count)
        .filter(|i| ![10, 20, 31, 40, 45].contains(i))
        .map(|i| seeds.gaussians.means[i])
        .collect();
    assert_eq!(model.gaussians().unwrap().means, kept);
    let removed = model.take_removed().unwrap();
    assert_eq!(removed, [10, 20, 40].map(SparseId));
    assert_eq!(model.take_removed().unwrap(), []);
    model.prune(&rule).unwrap();
    assert_eq!(model.len(), count - 5);
    // Visibility sets have been compacted along with the gaussians.
    let before = model.covisibility(ahead).unwrap();
    model.drop_view(aside).unwrap();
    model.add_view(fresh, view(0.4), target()).unwrap();
    let after = model.covisibility(ahead).unwrap();
    assert_eq!(before, [(aside, after[0].1)]);
    assert_eq!(after[0].0, fresh);
    model.step(ahead).unwrap();
}

#[test]
fn wrong_calls_are_refused() {
    let (mut model, id) = (model(), KEYFRAME);
    model.add_view(id, view(0.0), target()).unwrap();
    let again = model.add_view(id, view(0.0), target());
    assert_eq!(again, Err(ModelError::ViewExists(id)));
    model.drop_view(id).unwrap();
    assert_eq!(model.step(id), Err(ModelError::NoSuchView(id)));
    assert_eq!(model.drop_view(id), Err(ModelError::NoSuchView(id)));
    assert_eq!(model.covisibility(id), Err(ModelError::NoSuchView(id)));
    let small = Target::new(Image::filled(3, 2, [0; 3]), Image::filled(3, 2, 1.0)).unwrap();
    let refused = model.add_view(id, view(0.0), small);
    assert!(matches!(
        refused,
        Err(ModelError::ImageSize { actual: (3, 2), .. })
    ));
    // A dropped view may be added again.
    model.add_view(id, view(0.0), target()).unwrap();
    let mut ragged = wall();
    ragged.gaussians.sh.pop();
    assert_eq!(model.insert(&ragged, id), Err(ModelError::RaggedSeeds));
}

#[test]
fn an_empty_map_is_black_and_can_be_stepped() {
    let mut model = CpuModel::default();
    model.add_view(KEYFRAME, view(0.0), target()).unwrap();
    model.step(KEYFRAME).unwrap();
    let rendered = model.render(&view(0.0)).unwrap();
    assert!(rendered.color.data().iter().all(|rgb| *rgb == [0.0; 3]));
    assert!(model.is_empty());
}

#[test]
fn a_saved_model_goes_on_to_the_last_bit() {
    let mut model = model();
    let other = KeyframeId(9);
    model.add_view(KEYFRAME, view(0.0), target()).unwrap();
    model.add_view(other, view(0.3), target()).unwrap();
    let rule = PruneRule {
        min_opacity: 0.85,
        max_scale_m: 1.0,
        max_aspect: 10.0,
    };
    for _ in 0..20 {
        model.step(KEYFRAME).unwrap();
    }
    model.prune(&rule).unwrap();
    let saved = model.save().unwrap();
    assert!(
        !saved.removed.is_empty(),
        "the rule prunes some of the sparse map"
    );
    let mut again = CpuModel::default();
    again
        .restore(saved.clone(), vec![target(), target()])
        .unwrap();
    assert_eq!(again.save().unwrap(), saved);
    for model in [&mut model, &mut again] {
        model.step(other).unwrap();
        let motion = Se3::exp(&Vector6::new(0.1, 0.2, 0.0, 0.0, 0.3, 0.1));
        model.move_anchored(&[(KEYFRAME, motion)]).unwrap();
        model.step(KEYFRAME).unwrap();
    }
    assert_eq!(again.covisibility(other), model.covisibility(other));
    assert_eq!(again.take_removed(), model.take_removed());
    assert_eq!(again.save(), model.save());
}

#[test]
fn what_no_model_saved_is_refused() {
    let mut model = model();
    model.add_view(KEYFRAME, view(0.0), target()).unwrap();
    let whole = model.save().unwrap();
    let refused = |change: fn(&mut SavedModel), targets: usize| {
        let mut saved = whole.clone();
        change(&mut saved);
        let restored = CpuModel::default().restore(saved, vec![target(); targets]);
        restored.is_err()
    };
    assert!(!refused(|_| (), 1));
    assert!(refused(|_| (), 0));
    assert!(refused(|saved| saved.gaussians.sh.truncate(1), 1));
    assert!(refused(|saved| saved.anchors.truncate(1), 1));
    assert!(refused(|saved| saved.adam.extend(1), 1));
    assert!(refused(|saved| saved.views[0].visible.truncate(1), 1));
    assert!(refused(
        |saved| *saved.views[0].visible.last_mut().unwrap() = u32::MAX,
        1
    ));
    assert!(refused(|saved| saved.views[0].view.camera.width += 1, 1));
    assert!(refused(|saved| saved.views.push(saved.views[0].clone()), 2));
    assert!(refused(|saved| saved.gaussians.inferred[0] = true, 1));
    let full = model.restore(whole.clone(), vec![target()]);
    assert!(matches!(full, Err(ModelError::Saved(_))));
}
