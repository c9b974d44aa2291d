//! The model on the CPU: runs everywhere and is the reference for every other backend.
//!
//! Invariant: results are bit-identical for any number of threads.

use std::collections::BTreeMap;

use fgs_geom::{Image, KeyframeId, Se3, View};

use crate::contradicted::fade_contradicted;
use crate::gaussians::retain;
use crate::least_useful::least_useful;
use crate::model::{
    GaussianModel, ModelError, ModelSettings, PruneRule, Seeds, SparseId, StepStats, check_image,
    check_seeds, check_view,
};
use crate::rigid_motion::{RigidMotion, by_keyframe, moved, transformed};
use crate::visibility::VisibleSet;
use crate::{
    Adam, Cotangents, GaussianGradients, Gaussians, Rasterizer, Rendered, SavedModel, SavedView,
    Target, photometric_loss, scale_regularizer,
};

/// A [`GaussianModel`] on the CPU.
#[derive(Default)]
pub struct CpuModel {
    settings: ModelSettings,
    gaussians: Gaussians,
    sparse_ids: Vec<Option<SparseId>>,
    anchors: Vec<KeyframeId>,
    /// Pruned gaussians of the sparse map, not yet reported to the caller.
    removed: Vec<SparseId>,
    adam: Adam,
    rasterizer: Rasterizer,
    cotangents: Cotangents,
    gradients: GaussianGradients,
    views: BTreeMap<KeyframeId, TrainingView>,
    stats: Vec<StepStats>,
}

/// A registered view.
struct TrainingView {
    view: View,
    target: Target,
    /// The gaussians that contributed to a pixel when the view was last rendered.
    visible: VisibleSet,
}

impl CpuModel {
    /// An empty map.
    pub fn new(settings: ModelSettings) -> Self {
        Self {
            settings,
            ..Self::default()
        }
    }
}

impl GaussianModel for CpuModel {
    fn len(&self) -> usize {
        self.gaussians.len()
    }

    fn add_view(&mut self, id: KeyframeId, view: View, target: Target) -> Result<(), ModelError> {
        check_view(self.views.contains_key(&id), id, &view, &target)?;
        let pass = self.rasterizer.render(&self.gaussians, &view);
        let visible = VisibleSet::from_indices(&pass.visible());
        let view = TrainingView {
            view,
            target,
            visible,
        };
        self.views.insert(id, view);
        Ok(())
    }

    fn drop_view(&mut self, id: KeyframeId) -> Result<(), ModelError> {
        let dropped = self.views.remove(&id);
        dropped.map(|_| ()).ok_or(ModelError::NoSuchView(id))
    }

    fn insert(&mut self, seeds: &Seeds, anchor: KeyframeId) -> Result<(), ModelError> {
        check_seeds(seeds)?;
        let count = seeds.sparse_ids.len();
        self.gaussians.extend(&seeds.gaussians);
        self.sparse_ids.extend(&seeds.sparse_ids);
        self.anchors.extend(std::iter::repeat_n(anchor, count));
        self.adam.extend(count);
        Ok(())
    }

    fn move_anchored(&mut self, moves: &[(KeyframeId, Se3)]) -> Result<(), ModelError> {
        let motions = by_keyframe(moves)?;
        for (id, training) in &mut self.views {
            if let Some(motion) = motions.get(id) {
                training.view = moved(&training.view, motion);
            }
        }
        let motions: BTreeMap<KeyframeId, RigidMotion> = motions
            .iter()
            .map(|(id, motion)| (*id, motion.into()))
            .collect();
        for (i, anchor) in self.anchors.iter().enumerate() {
            if let Some(motion) = motions.get(anchor) {
                let (mean, quat) = (&mut self.gaussians.means[i], &mut self.gaussians.quats[i]);
                *mean = motion.apply(mean);
                *quat = transformed(&motion.left, quat);
                self.adam.turn(i, motion);
            }
        }
        Ok(())
    }

    fn prune(&mut self, rule: &PruneRule) -> Result<(), ModelError> {
        let keep: Vec<bool> = (0..self.len())
            .map(|i| survives(&self.gaussians, i, rule))
            .collect();
        if keep.iter().all(|keep| *keep) {
            return Ok(());
        }
        let mut kept = 0;
        let new_from_old: Vec<Option<u32>> = keep
            .iter()
            .map(|&keep| {
                kept += u32::from(keep);
                keep.then(|| kept - 1)
            })
            .collect();
        for (id, keep) in self.sparse_ids.iter().zip(&keep) {
            if let (Some(id), false) = (id, keep) {
                self.removed.push(*id);
            }
        }
        self.gaussians.retain(&keep);
        self.adam.retain(&keep);
        retain(&mut self.sparse_ids, &keep);
        retain(&mut self.anchors, &keep);
        for view in self.views.values_mut() {
            view.visible = view.visible.compacted(&new_from_old);
        }
        Ok(())
    }

    fn remove(&mut self, indices: &[usize]) -> Result<(), ModelError> {
        if indices.is_empty() {
            return Ok(());
        }
        for i in indices {
            if let Some(logit) = self.gaussians.opacity_logits.get_mut(*i) {
                *logit = f32::NAN;
            }
        }
        self.prune(&PruneRule::NOT_A_NUMBER)
    }

    fn make_room(&mut self, added: usize, max: usize) -> Result<(), ModelError> {
        let (count, logits) = (self.len(), &self.gaussians.opacity_logits);
        let views = self.views.values();
        let views = views.map(|view| Ok::<_, ModelError>(view.visible.words(count)));
        let least = least_useful(logits, views, added, max)?;
        self.remove(&least)
    }

    fn fade_contradicted(&mut self, view: &View, depth_m: &Image<f32>) -> Result<(), ModelError> {
        check_image(view, depth_m)?;
        fade_contradicted(&mut self.gaussians, view, depth_m);
        Ok(())
    }

    fn render(&mut self, view: &View) -> Result<Rendered, ModelError> {
        let pass = self.rasterizer.render(&self.gaussians, view);
        Ok(pass.rendered().clone())
    }

    fn see_through(&mut self, view: &View, min_alpha: f32) -> Result<Image<bool>, ModelError> {
        let pass = self.rasterizer.render(&self.gaussians, view);
        Ok(pass.rendered().alpha.map(|alpha| *alpha < min_alpha))
    }

    fn match_exposure(&mut self, id: KeyframeId) -> Result<(), ModelError> {
        let training = self.views.get_mut(&id).ok_or(ModelError::NoSuchView(id))?;
        let pass = self.rasterizer.render(&self.gaussians, &training.view);
        training.target = training.target.exposed_like(pass.rendered());
        Ok(())
    }

    fn step(&mut self, id: KeyframeId) -> Result<(), ModelError> {
        let training = self.views.get_mut(&id).ok_or(ModelError::NoSuchView(id))?;
        let mut pass = self.rasterizer.render(&self.gaussians, &training.view);
        let loss = photometric_loss(
            pass.rendered(),
            &training.target,
            &self.settings.loss,
            &mut self.cotangents,
        )?;
        pass.vjp(&self.cotangents, &mut self.gradients);
        let touched = &self.gradients.touched;
        training.visible = VisibleSet::from_indices(touched);
        let visible = touched.len();
        let regularizer = self.add_regularizer();
        let skipped_gradients = self.adam.step(
            &mut self.gaussians,
            &self.gradients,
            &self.settings.learning_rates,
        )?;
        self.stats.push(StepStats {
            view: id,
            loss: (loss.total + regularizer) as f32,
            visible,
            skipped_gradients,
        });
        Ok(())
    }

    fn take_stats(&mut self) -> Vec<StepStats> {
        std::mem::take(&mut self.stats)
    }

    fn covisibility(&mut self, id: KeyframeId) -> Result<Vec<(KeyframeId, f32)>, ModelError> {
        let own = &self
            .views
            .get(&id)
            .ok_or(ModelError::NoSuchView(id))?
            .visible;
        let count = own.count().max(1) as f32;
        let others = self.views.iter().filter(|(other, _)| **other != id);
        Ok(others
            .map(|(other, view)| (*other, own.count_common(&view.visible) as f32 / count))
            .collect())
    }

    fn take_removed(&mut self) -> Result<Vec<SparseId>, ModelError> {
        let mut removed = std::mem::take(&mut self.removed);
        removed.sort_unstable();
        Ok(removed)
    }

    fn gaussians(&mut self) -> Result<Gaussians, ModelError> {
        Ok(self.gaussians.clone())
    }

    fn save(&mut self) -> Result<SavedModel, ModelError> {
        let count = self.len();
        let view = |(id, training): (&KeyframeId, &TrainingView)| SavedView {
            id: *id,
            view: training.view,
            visible: training.visible.words(count),
        };
        Ok(SavedModel {
            gaussians: self.gaussians.clone(),
            sparse_ids: self.sparse_ids.clone(),
            anchors: self.anchors.clone(),
            adam: self.adam.clone(),
            removed: self.removed.clone(),
            views: self.views.iter().map(view).collect(),
        })
    }

    fn restore(&mut self, saved: SavedModel, targets: Vec<Target>) -> Result<(), ModelError> {
        saved.check(&targets)?;
        if !(self.is_empty() && self.views.is_empty()) {
            return Err(ModelError::Saved("the model is not empty"));
        }
        self.views = (saved.views.iter().zip(targets))
            .map(|(saved, target)| {
                let view = TrainingView {
                    view: saved.view,
                    target,
                    visible: VisibleSet::from_words(&saved.visible),
                };
                (saved.id, view)
            })
            .collect();
        self.gaussians = saved.gaussians;
        self.sparse_ids = saved.sparse_ids;
        self.anchors = saved.anchors;
        self.adam = saved.adam;
        self.removed = saved.removed;
        Ok(())
    }

    fn into_gaussians(self: Box<Self>) -> Gaussians {
        self.gaussians
    }
}

impl CpuModel {
    /// Adds the scale regulariser's gradient of the touched gaussians; returns its weighted value.
    fn add_regularizer(&mut self) -> f64 {
        let weight = self.settings.loss.scale_weight;
        let GaussianGradients { touched, gradients } = &mut self.gradients;
        let (value, d_log_scales) = scale_regularizer(&self.gaussians, touched);
        for (gradient, d_log_scales) in gradients.iter_mut().zip(d_log_scales) {
            for (sum, d) in gradient.d_log_scales.iter_mut().zip(d_log_scales) {
                *sum += weight * d;
            }
        }
        f64::from(weight) * value
    }
}

/// Comparisons with NaN are false: such a gaussian does not survive.
fn survives(gaussians: &Gaussians, i: usize, rule: &PruneRule) -> bool {
    let mut scales = gaussians.scales(i);
    scales.sort_by(f32::total_cmp);
    let [shortest, middle, longest] = scales;
    // A NaN sorts first or last, by its sign.
    !shortest.is_nan()
        && gaussians.opacity(i) >= rule.min_opacity
        && longest <= rule.max_scale_m
        && longest <= rule.max_aspect * middle
}

#[cfg(test)]
mod tests;
