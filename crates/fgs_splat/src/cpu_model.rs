//! The model on the CPU: always works and is the reference for every other backend.
//!
//! Invariant: results are the same bits for any number of threads.

use std::collections::BTreeMap;

use fgs_geom::View;

use crate::model::{
    GaussianModel, ModelError, ModelSettings, PruneRule, Seeds, SparseChanges, SparseGaussian,
    SparseId, StepStats, ViewId,
};
use crate::visibility::VisibleSet;
use crate::{
    Adam, Cotangents, GaussianGradients, Gaussians, Rasterizer, Rendered, Target, photometric_loss,
    scale_regularizer,
};

/// A [`GaussianModel`] on the CPU.
#[derive(Default)]
pub struct CpuModel {
    settings: ModelSettings,
    gaussians: Gaussians,
    sparse_ids: Vec<Option<SparseId>>,
    /// Sparse gaussians that steps touched since they were last asked for.
    moved: VisibleSet,
    /// Sparse gaussians pruned since they were last asked for.
    removed: Vec<SparseId>,
    adam: Adam,
    rasterizer: Rasterizer,
    cotangents: Cotangents,
    gradients: GaussianGradients,
    views: BTreeMap<ViewId, TrainingView>,
    next_view: usize,
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

    fn add_view(&mut self, view: View, target: Target) -> Result<ViewId, ModelError> {
        let expected = (view.camera.width, view.camera.height);
        let actual = (target.color().width(), target.color().height());
        if expected != actual {
            return Err(ModelError::TargetSize { expected, actual });
        }
        let pass = self.rasterizer.render(&self.gaussians, &view);
        let visible = VisibleSet::from_indices(&pass.visible());
        let id = ViewId(self.next_view);
        self.next_view += 1;
        self.views.insert(
            id,
            TrainingView {
                view,
                target,
                visible,
            },
        );
        Ok(id)
    }

    fn drop_view(&mut self, id: ViewId) -> Result<(), ModelError> {
        let dropped = self.views.remove(&id);
        dropped.map(|_| ()).ok_or(ModelError::NoSuchView(id))
    }

    fn insert(&mut self, seeds: &Seeds) -> Result<(), ModelError> {
        let count = seeds.sparse_ids.len();
        if !seeds.gaussians.has_len(count) {
            return Err(ModelError::RaggedSeeds);
        }
        self.gaussians.extend(&seeds.gaussians);
        self.sparse_ids.extend(&seeds.sparse_ids);
        self.adam.extend(count);
        Ok(())
    }

    fn prune(&mut self, rule: &PruneRule) -> Result<usize, ModelError> {
        let keep: Vec<bool> = (0..self.len())
            .map(|i| survives(&self.gaussians, i, rule))
            .collect();
        let pruned = keep.iter().filter(|keep| !**keep).count();
        if pruned == 0 {
            return Ok(0);
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
        let mut flags = keep.iter();
        self.sparse_ids.retain(|_| flags.next() == Some(&true));
        self.moved = self.moved.compacted(&new_from_old);
        for view in self.views.values_mut() {
            view.visible = view.visible.compacted(&new_from_old);
        }
        Ok(pruned)
    }

    fn render(&mut self, view: &View) -> Result<Rendered, ModelError> {
        let pass = self.rasterizer.render(&self.gaussians, view);
        Ok(pass.rendered().clone())
    }

    fn step(&mut self, id: ViewId) -> Result<(), ModelError> {
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
        for &index in touched {
            if self.sparse_ids[index as usize].is_some() {
                self.moved.insert(index as usize);
            }
        }
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

    fn covisibility(&mut self, id: ViewId) -> Result<Vec<(ViewId, f32)>, ModelError> {
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

    fn take_sparse_changes(&mut self) -> Result<SparseChanges, ModelError> {
        let moved = std::mem::take(&mut self.moved);
        let mut moved: Vec<SparseGaussian> = moved
            .iter()
            .filter_map(|i| self.sparse_gaussian(i))
            .collect();
        moved.sort_by_key(|gaussian| gaussian.id);
        let mut removed = std::mem::take(&mut self.removed);
        removed.sort_unstable();
        Ok(SparseChanges { moved, removed })
    }

    fn gaussians(&mut self) -> Result<Gaussians, ModelError> {
        Ok(self.gaussians.clone())
    }

    fn into_gaussians(self) -> Gaussians {
        self.gaussians
    }
}

impl CpuModel {
    /// Adds the regulariser's gradient for the touched gaussians; returns its share of the loss.
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

    fn sparse_gaussian(&self, i: usize) -> Option<SparseGaussian> {
        Some(SparseGaussian {
            id: self.sparse_ids[i]?,
            mean: self.gaussians.means[i],
            quat: self.gaussians.quats[i],
            log_scales: self.gaussians.log_scales[i],
            opacity: self.gaussians.opacity(i),
        })
    }
}

/// Damaged gaussians do not survive.
fn survives(gaussians: &Gaussians, i: usize, rule: &PruneRule) -> bool {
    let mut scales = gaussians.scales(i);
    scales.sort_by(f32::total_cmp);
    let [_, middle, longest] = scales;
    gaussians.opacity(i) >= rule.min_opacity
        && longest <= rule.max_scale_m
        && longest <= rule.max_aspect * middle
}

#[cfg(test)]
mod tests;
