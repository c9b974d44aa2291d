//! The interface between SLAM and the device that optimises the map. Parameters, gradients, Adam's
//! state and the training views live behind [`GaussianModel`], and nothing is read back within a step.
//!
//! Every gaussian is anchored to the keyframe that it was seeded from. When a keyframe's pose is
//! corrected, [`GaussianModel::move_anchored`] moves its gaussians and its view with it.

use fgs_geom::{Image, KeyframeId, Se3, View};
use thiserror::Error;

use crate::{
    AdamError, Gaussians, GpuError, LearningRates, LossError, LossSettings, Rendered, Target,
};

/// The caller's name for a gaussian of the sparse map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SparseId(pub u32);

/// New gaussians.
#[derive(Clone, Debug, Default)]
pub struct Seeds {
    /// Their parameters, `[N]`.
    pub gaussians: Gaussians,
    /// The names of those that are part of the sparse map, `[N]`.
    pub sparse_ids: Vec<Option<SparseId>>,
}

/// Which gaussians [`GaussianModel::prune`] removes: any that one of the limits rejects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PruneRule {
    /// Minimum opacity, 0 to 1.
    pub min_opacity: f32,
    /// Maximum standard deviation along the longest axis, metres.
    pub max_scale_m: f32,
    /// Maximum ratio of the longest axis to the middle one.
    pub max_aspect: f32,
}

/// What a finished step reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepStats {
    /// The view that was optimised.
    pub view: KeyframeId,
    /// The loss before the step.
    pub loss: f32,
    /// How many gaussians contributed to a pixel.
    pub visible: usize,
    /// How many gaussians were skipped because their gradient was not finite.
    pub skipped_gradients: usize,
}

/// How a model optimises.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelSettings {
    /// The loss.
    pub loss: LossSettings,
    /// The optimiser's step sizes.
    pub learning_rates: LearningRates,
}

/// Why a model refuses a call.
#[derive(Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum ModelError {
    /// The keyframe has no view: none was ever added, or it was dropped.
    #[error("keyframe {} has no view", .0.0)]
    NoSuchView(KeyframeId),
    /// The keyframe already has a view.
    #[error("keyframe {} already has a view", .0.0)]
    ViewExists(KeyframeId),
    /// A keyframe's motion is not finite in single precision.
    #[error("the motion of keyframe {} is not finite", .0.0)]
    NotFinite(KeyframeId),
    /// The target's images are not of the view's size.
    #[error("the view is {expected:?} pixels, its target {actual:?}")]
    TargetSize {
        /// Width and height of the view's camera.
        expected: (usize, usize),
        /// Width and height of the target.
        actual: (usize, usize),
    },
    /// The seeds' arrays have different lengths.
    #[error("seeds whose arrays have different lengths")]
    RaggedSeeds,
    /// The view cannot be compared with its target.
    #[error(transparent)]
    Loss(#[from] LossError),
    /// The optimiser refused its input.
    #[error(transparent)]
    Adam(#[from] AdamError),
    /// The graphics device failed.
    #[error(transparent)]
    Device(#[from] GpuError),
}

/// A map of gaussians that can be rendered and optimised.
pub trait GaussianModel: Send {
    /// Number of gaussians. On a device, pruned ones may still be counted for a few steps.
    fn len(&self) -> usize;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Adds a keyframe's view, for [`GaussianModel::step`] to optimise. `target` is what was measured
    /// there. A keyframe whose view was dropped may get another.
    ///
    /// # Errors
    /// If the keyframe already has a view, the target's size is not the view's, or the device fails.
    fn add_view(&mut self, id: KeyframeId, view: View, target: Target) -> Result<(), ModelError>;

    /// Drops a keyframe's view. Its gaussians stay, anchored as they are.
    ///
    /// # Errors
    /// If there is no such view, or the device fails.
    fn drop_view(&mut self, id: KeyframeId) -> Result<(), ModelError>;

    /// Adds gaussians anchored to a keyframe, which need not have a view.
    ///
    /// # Errors
    /// If the seeds' arrays differ in length, or the device fails.
    fn insert(&mut self, seeds: &Seeds, anchor: KeyframeId) -> Result<(), ModelError>;

    /// Moves everything that belongs to some keyframes: the gaussians anchored to them and, where
    /// there is one, the keyframe's view. Each `Se3` is `new_world_from_old_world`; where a keyframe
    /// is named twice its motions are applied in turn. Keyframes without gaussians or a view are
    /// accepted.
    ///
    /// Adam's moments are rotated along. First moments transform like the parameters' derivatives, so
    /// this is exact. Second moments lack the off-diagonal terms and become
    /// `v_i = sum_j R_ij^2 v_j`, exact for uncorrelated derivatives; this keeps Adam's bound on the
    /// length of a step up to the square root of the number of axes.
    ///
    /// # Errors
    /// If a motion is not finite, in which case nothing moves, or the device fails.
    fn move_anchored(&mut self, moves: &[(KeyframeId, Se3)]) -> Result<(), ModelError>;

    /// Removes the gaussians that the rule rejects, and damaged ones.
    ///
    /// # Errors
    /// If the device fails.
    fn prune(&mut self, rule: &PruneRule) -> Result<(), ModelError>;

    /// Colour, depth and alpha as seen from a view.
    ///
    /// # Errors
    /// If the device fails.
    fn render(&mut self, view: &View) -> Result<Rendered, ModelError>;

    /// The pixels of a view where the map's accumulated alpha is below `min_alpha`.
    ///
    /// # Errors
    /// If the device fails.
    fn see_through(&mut self, view: &View, min_alpha: f32) -> Result<Image<bool>, ModelError>;

    /// One optimisation step on a keyframe's view: render, loss, backward, Adam.
    ///
    /// # Errors
    /// If there is no such view, or the device fails.
    fn step(&mut self, id: KeyframeId) -> Result<(), ModelError>;

    /// Statistics of the steps that finished since the last call, in their order.
    fn take_stats(&mut self) -> Vec<StepStats>;

    /// For each other view, ascending by id, the share of this view's visible gaussians that it
    /// shows too. Visible means contributing to a pixel when the view was last rendered.
    ///
    /// # Errors
    /// If there is no such view, or the device fails.
    fn covisibility(&mut self, id: KeyframeId) -> Result<Vec<(KeyframeId, f32)>, ModelError>;

    /// The gaussians of the sparse map that were pruned and not yet reported, by ascending id. Never
    /// waits for the device: what was pruned a few steps ago may be reported by a later call.
    ///
    /// # Errors
    /// If the device fails.
    fn take_removed(&mut self) -> Result<Vec<SparseId>, ModelError>;

    /// A copy of all gaussians.
    ///
    /// # Errors
    /// If the device fails.
    fn gaussians(&mut self) -> Result<Gaussians, ModelError>;

    /// Bytes that the model takes on a graphics device.
    fn device_bytes(&self) -> u64 {
        0
    }

    /// All gaussians, once they are final; after a failure of the device, as they were last known.
    fn into_gaussians(self: Box<Self>) -> Gaussians;
}

/// Refuses a view that the model already has, or whose target is of another size.
pub(crate) fn check_view(
    exists: bool,
    id: KeyframeId,
    view: &View,
    target: &Target,
) -> Result<(), ModelError> {
    let expected = (view.camera.width, view.camera.height);
    let actual = (target.color().width(), target.color().height());
    if exists {
        Err(ModelError::ViewExists(id))
    } else if expected != actual {
        Err(ModelError::TargetSize { expected, actual })
    } else {
        Ok(())
    }
}

#[cfg(test)]
mod tests;
