//! Where a loop closes, or two sub-maps meet, surfaces that were mapped twice come to lie on one another.
//! What was mapped later goes where the earlier map alone shows the same surface: it would never have been
//! sown had the drift been known. The next optimisation steps go to the views that showed it.
//!
//! Differs from the paper, which has no loops.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use fgs_geom::{Camera, KeyframeId, View};
use fgs_graph::KeyframeGraph;
use fgs_splat::{Gaussians, Rasterizer, Rendered, SavedModel};
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::submaps::Submaps;

/// The earlier map shows a gaussian's surface if its depth differs by less than this share of it: what loops
/// leave of drift, and the noise of depth.
const MAX_DEPTH_DIFFERENCE: f32 = 0.05;

/// The earlier map is rendered smaller by this factor in both directions.
const REDUCTION: usize = 2;

/// Steps go to so many views of a seam.
const MAX_VIEWS: usize = 16;

/// The keyframes on both sides of a place where the map was closed.
#[derive(Clone, Debug, PartialEq)]
pub struct Seam {
    earlier: BTreeSet<KeyframeId>,
    later: BTreeSet<KeyframeId>,
}

impl Seam {
    /// Between two keyframes, before they become one sub-map. Of two sub-maps the newer is the later side,
    /// within one that half of the keyframes from the one to the other.
    pub fn between(
        graph: &KeyframeGraph,
        submaps: &Submaps,
        old: KeyframeId,
        new: KeyframeId,
    ) -> Self {
        let of_submap = |submap| {
            let ids = graph.poses().map(|(id, _)| id);
            ids.filter(move |id| submaps.of(*id) == submap)
        };
        let (a, b) = (submaps.of(old), submaps.of(new));
        if a != b {
            return Self {
                earlier: of_submap(a.min(b)).collect(),
                later: of_submap(a.max(b)).collect(),
            };
        }
        let middle = KeyframeId(old.0.midpoint(new.0));
        let (earlier, later) = of_submap(a).partition(|id| *id <= middle);
        Self { earlier, later }
    }

    /// The gaussians of the later side whose surface the earlier side shows to where they were sown from, with
    /// an opacity of at least `min_alpha`.
    pub fn repeated(&self, model: &SavedModel, min_alpha: f32) -> Vec<usize> {
        let earlier = self.earlier_map(model);
        let mut sown = BTreeMap::<KeyframeId, Vec<usize>>::new();
        for (i, anchor) in model.anchors.iter().enumerate() {
            if self.later.contains(anchor) {
                sown.entry(*anchor).or_default().push(i);
            }
        }
        let mut rasterizer = Rasterizer::default();
        let mut repeated = Vec::new();
        for saved in &model.views {
            let View {
                camera,
                world_from_camera,
            } = saved.view;
            let size = (camera.width / REDUCTION, camera.height / REDUCTION);
            let (Some(sown), Ok(camera)) = (sown.get(&saved.id), camera.resized(size.0, size.1))
            else {
                continue;
            };
            let view = View {
                camera,
                world_from_camera,
            };
            let pass = rasterizer.render(&earlier, &view);
            let shown = pass.rendered();
            let camera_from_world = world_from_camera.inverse();
            let is_repeated = |i: &&usize| {
                let mean = Vector3::from(model.gaussians.means[**i]).cast();
                shows(
                    shown,
                    &camera,
                    &camera_from_world.transform(&mean),
                    min_alpha,
                )
            };
            repeated.par_extend(sown.par_iter().filter(is_repeated).copied());
        }
        repeated.sort_unstable();
        repeated
    }

    /// What the earlier side has measured.
    fn earlier_map(&self, model: &SavedModel) -> Gaussians {
        let mut earlier = model.gaussians.clone();
        let both = model.anchors.iter().zip(&model.gaussians.inferred);
        let keep: Vec<bool> = both
            .map(|(anchor, inferred)| !inferred && self.earlier.contains(anchor))
            .collect();
        earlier.retain(&keep);
        earlier
    }
}

/// Whether a camera's render shows a surface where a point is, in the camera's axes.
fn shows(rendered: &Rendered, camera: &Camera, point: &Vector3<f64>, min_alpha: f32) -> bool {
    let Some(pixel) = camera.project(point) else {
        return false;
    };
    if !camera.contains(&pixel) {
        return false;
    }
    let (u, v) = (pixel.x.round() as usize, pixel.y.round() as usize);
    let depth_m = point.z as f32;
    let difference = (rendered.surface_depth_m(u, v) - depth_m).abs();
    rendered.alpha.at(u, v) >= min_alpha && difference <= MAX_DEPTH_DIFFERENCE * depth_m
}

/// The views that showed the most of some gaussians, the one with the most first.
pub fn views_of(model: &SavedModel, gaussians: &[usize]) -> Vec<KeyframeId> {
    let shown = |visible: &[u32]| {
        let is_shown = |i: &&usize| {
            visible
                .get(**i / 32)
                .is_some_and(|word| word >> (**i % 32) & 1 == 1)
        };
        gaussians.iter().filter(is_shown).count()
    };
    let mut views: Vec<(usize, KeyframeId)> = (model.views.iter())
        .map(|saved| (shown(&saved.visible), saved.id))
        .filter(|(count, _)| *count > 0)
        .collect();
    views.sort_unstable_by_key(|(count, id)| (Reverse(*count), *id));
    views
        .into_iter()
        .take(MAX_VIEWS)
        .map(|(_, id)| id)
        .collect()
}

#[cfg(test)]
mod tests {
    use fgs_geom::{Intrinsics, Se3};
    use fgs_splat::{Adam, Gaussian, SavedView, SparseId};

    use super::*;

    const EARLIER: KeyframeId = KeyframeId(3);
    const LATER: KeyframeId = KeyframeId(8);
    /// Pixels from one gaussian to the next.
    const STEP: usize = 4;

    fn view() -> View {
        let intrinsics = Intrinsics {
            fx: 60.0,
            fy: 60.0,
            cx: 39.5,
            cy: 29.5,
        };
        View {
            camera: Camera::new(80, 60, intrinsics).unwrap(),
            world_from_camera: Se3::identity(),
        }
    }

    /// Adds a wall in front of the camera from column `from` to the right, opaque, of one keyframe; returns
    /// which gaussians it is made of.
    fn wall(model: &mut SavedModel, anchor: KeyframeId, from: usize, z: f64) -> Vec<usize> {
        let View { camera, .. } = view();
        let first = model.anchors.len();
        for v in (0..camera.height).step_by(STEP) {
            for u in (from..camera.width).step_by(STEP) {
                let mean = camera.unproject(u as f64, v as f64, z);
                let scale = (z * STEP as f64 / camera.intrinsics.fx) as f32;
                model.gaussians.push(&Gaussian {
                    mean: mean.cast().into(),
                    quat: [1.0, 0.0, 0.0, 0.0],
                    scales: [scale, scale, 1e-3],
                    opacity: 0.98,
                    rgb: [0.5; 3],
                });
                model.anchors.push(anchor);
            }
        }
        (first..model.anchors.len()).collect()
    }

    fn completed(mut model: SavedModel) -> SavedModel {
        let count = model.anchors.len();
        model.sparse_ids = (0..count as u32).map(|i| Some(SparseId(i))).collect();
        model.adam = Adam::default();
        model.views = vec![SavedView {
            id: LATER,
            view: view(),
            visible: vec![u32::MAX; count.div_ceil(32)],
        }];
        model
    }

    fn seam() -> Seam {
        Seam {
            earlier: BTreeSet::from([EARLIER]),
            later: BTreeSet::from([LATER]),
        }
    }

    #[test]
    fn what_was_mapped_twice_goes_and_nothing_else() {
        let mut model = SavedModel::default();
        wall(&mut model, EARLIER, 40, 2.0);
        let twice = wall(&mut model, LATER, 48, 2.03);
        let beside = wall(&mut model, LATER, 0, 2.0);
        wall(&mut model, LATER, 40, 1.7);
        wall(&mut model, KeyframeId(5), 40, 2.0);
        let model = completed(model);
        let repeated = seam().repeated(&model, 0.9);
        assert!(twice.iter().all(|i| repeated.contains(i)));
        let is_left = |i: &&usize| {
            let u = view()
                .camera
                .project(&Vector3::from(model.gaussians.means[**i]).cast());
            u.is_some_and(|pixel| pixel.x < 30.0)
        };
        let left: Vec<&usize> = beside.iter().filter(is_left).collect();
        assert!(left.len() > 50 && left.iter().all(|i| !repeated.contains(i)));
        let is_far = |i: &usize| (model.gaussians.means[*i][2] - 2.0).abs() > 0.1;
        assert!(!repeated.iter().any(is_far));
        assert!(repeated.iter().all(|i| model.anchors[*i] == LATER));
        assert_eq!(views_of(&model, &repeated), [LATER]);
    }

    #[test]
    fn what_was_only_guessed_replaces_nothing() {
        let mut model = SavedModel::default();
        for i in wall(&mut model, EARLIER, 0, 2.0) {
            model.gaussians.inferred[i] = true;
        }
        wall(&mut model, LATER, 0, 2.0);
        assert!(seam().repeated(&completed(model), 0.9).is_empty());
    }

    #[test]
    fn of_two_submaps_the_newer_is_the_later_side_and_of_one_the_newer_half() {
        let mut graph = KeyframeGraph::new();
        let mut submaps = Submaps::default();
        for i in 0..20 {
            graph.add_keyframe(KeyframeId(i), Se3::identity());
            let previous = i.checked_sub(1).filter(|_| i != 12).map(KeyframeId);
            submaps.add(KeyframeId(i), previous, Vector3::zeros());
        }
        let ids = |range: std::ops::Range<u32>| range.map(KeyframeId).collect::<BTreeSet<_>>();
        let seam = |old, new| Seam::between(&graph, &submaps, KeyframeId(old), KeyframeId(new));
        for met in [seam(3, 15), seam(15, 3)] {
            assert_eq!((met.earlier, met.later), (ids(0..12), ids(12..20)));
        }
        let closed = seam(1, 11);
        assert_eq!((closed.earlier, closed.later), (ids(0..7), ids(7..12)));
    }
}
