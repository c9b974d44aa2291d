//! The interface between SLAM and the device that optimises the map. Parameters, gradients, Adam's
//! state and the training views stay behind [`GaussianModel`]; nothing is read back within a step.
//!
//! Every gaussian is anchored to the keyframe that it was seeded from. When a keyframe's pose is
//! corrected, [`GaussianModel::move_anchored`] moves its gaussians and its view with it.

use fgs_geom::{Image, KeyframeId, Se3, View};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{
    AdamError, Gaussians, GpuError, LearningRates, LossError, LossSettings, Rendered, SavedModel,
    Target,
};

/// The caller's identifier of a gaussian of the sparse map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct SparseId(pub u32);

/// N new gaussians.
#[derive(Clone, Debug, Default)]
pub struct Seeds {
    /// Their parameters.
    pub gaussians: Gaussians,
    /// Ids of those that are part of the sparse map, `[N]`. Their depth is measured, not inferred.
    pub sparse_ids: Vec<Option<SparseId>>,
}

/// Which gaussians [`GaussianModel::prune`] removes: those that violate any of the limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PruneRule {
    /// Minimum opacity, 0 to 1.
    pub min_opacity: f32,
    /// Maximum standard deviation along the longest axis, metres.
    pub max_scale_m: f32,
    /// Maximum ratio of the longest axis to the middle one.
    pub max_aspect: f32,
}

impl PruneRule {
    /// Removes only what has a NaN among opacity and scales.
    pub(crate) const NOT_A_NUMBER: Self = Self {
        min_opacity: 0.0,
        max_scale_m: f32::MAX,
        max_aspect: f32::MAX,
    };
}

/// Statistics of a finished step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepStats {
    /// The view that was optimised.
    pub view: KeyframeId,
    /// The loss before the step, scale regulariser included.
    pub loss: f32,
    /// How many gaussians contributed to a pixel.
    pub visible: usize,
    /// How many of these Adam left alone because their gradient or its square was not finite.
    pub skipped_gradients: usize,
}

/// Settings of the optimisation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelSettings {
    /// The loss.
    pub loss: LossSettings,
    /// Adam's learning rates.
    pub learning_rates: LearningRates,
}

/// Why a call to a model failed.
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
    /// A measured image's size differs from the view's.
    #[error(
        "the view has {}x{} pixels, but the image measured there has {}x{}",
        .expected.0, .expected.1, .actual.0, .actual.1
    )]
    ImageSize {
        /// Width and height of the view's camera, pixels.
        expected: (usize, usize),
        /// Width and height of the image, pixels.
        actual: (usize, usize),
    },
    /// The seeds' arrays have different lengths.
    #[error("the seeds' arrays have different lengths")]
    RaggedSeeds,
    /// A seed of the sparse map has an inferred depth.
    #[error("a seed of the sparse map has an inferred depth")]
    InferredSparseSeed,
    /// A saved state contradicts itself, or the model that it is put into is not empty.
    #[error("a saved map cannot be taken over: {0}")]
    Saved(&'static str),
    /// The loss cannot be computed, for example because a rendered value is out of range.
    #[error(transparent)]
    Loss(#[from] LossError),
    /// Adam refused its input.
    #[error(transparent)]
    Adam(#[from] AdamError),
    /// The graphics device failed.
    #[error(transparent)]
    Device(#[from] GpuError),
}

/// A map of gaussians that can be rendered and optimised.
///
/// A graphics device works asynchronously: any call may return the error of an earlier step.
pub trait GaussianModel: Send {
    /// Number of gaussians. A graphics device may count pruned ones for a few more calls.
    fn len(&self) -> usize;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Adds a keyframe's view, for [`GaussianModel::step`] to optimise. `target` holds the images
    /// measured there. A keyframe whose view was dropped may get another.
    ///
    /// # Errors
    /// If the keyframe already has a view, the target's size is not the view's, or the device fails.
    fn add_view(&mut self, id: KeyframeId, view: View, target: Target) -> Result<(), ModelError>;

    /// Drops a keyframe's view. Gaussians anchored to the keyframe stay.
    ///
    /// # Errors
    /// If there is no such view, or the device fails.
    fn drop_view(&mut self, id: KeyframeId) -> Result<(), ModelError>;

    /// Adds gaussians anchored to a keyframe. The keyframe need not have a view.
    ///
    /// # Errors
    /// If the seeds' arrays differ in length, one of the sparse map is inferred, or the device fails.
    fn insert(&mut self, seeds: &Seeds, anchor: KeyframeId) -> Result<(), ModelError>;

    /// Moves some keyframes: the gaussians anchored to them and their views, if they have any. Each
    /// `Se3` is `new_world_from_old_world`; several motions of a keyframe are applied in turn.
    /// Keyframes with neither gaussians nor a view are accepted.
    ///
    /// Adam's moments rotate with the gaussians. First moments transform like the derivatives, which
    /// is exact. Second moments lack the off-diagonal terms and become `v_i = sum_j R_ij^2 v_j`, which
    /// is exact for uncorrelated derivatives and weakens Adam's bound on the step size by at most the
    /// square root of the number of axes.
    ///
    /// # Errors
    /// If a motion is not finite, in which case nothing moves, or the device fails.
    fn move_anchored(&mut self, moves: &[(KeyframeId, Se3)]) -> Result<(), ModelError>;

    /// Removes the gaussians that violate the rule or whose opacity or scales are NaN.
    ///
    /// # Errors
    /// If the device fails.
    fn prune(&mut self, rule: &PruneRule) -> Result<(), ModelError>;

    /// Removes gaussians by their index in [`save`](Self::save), and with them those whose opacity or scales
    /// are NaN; without an index, nothing. One beyond the last is ignored. Waits for the device.
    ///
    /// # Errors
    /// If the device fails.
    fn remove(&mut self, indices: &[usize]) -> Result<(), ModelError>;

    /// Makes room for `added` more gaussians if there would be more than `max`, and for a sixteenth of
    /// `max` beyond: those go first that the newest 16 views do not show, then those that the fewest
    /// views show, then the more transparent, then the older. Waits for the device.
    ///
    /// # Errors
    /// If the device fails.
    fn make_room(&mut self, added: usize, max: usize) -> Result<(), ModelError>;

    /// Makes gaussians yield that a measured depth image contradicts. Inferred ones whose depth is more
    /// than 5 % below the one measured at their centre's pixel are hidden: no view shows them, and
    /// pruning removes them. Others that are more than 20 % nearer fade: their opacity's logit falls by
    /// 2. `depth_m` has the view's size; metres.
    ///
    /// # Errors
    /// If the depth image's size is not the view's, or the device fails.
    fn fade_contradicted(&mut self, view: &View, depth_m: &Image<f32>) -> Result<(), ModelError>;

    /// Renders colour, depth and alpha.
    ///
    /// # Errors
    /// If the device fails.
    fn render(&mut self, view: &View) -> Result<Rendered, ModelError>;

    /// A mask of the view's size: true where the accumulated alpha is below `min_alpha` (0 to 1).
    ///
    /// # Errors
    /// If the device fails.
    fn see_through(&mut self, view: &View, min_alpha: f32) -> Result<Image<bool>, ModelError>;

    /// Brings the colours measured at a keyframe's view to the map's exposure: from now on they are
    /// compared after a gain and an offset for each channel, those that bring them nearest to what the
    /// map shows there now, tied to 1 and 0.
    ///
    /// # Errors
    /// If there is no such view, or the device fails.
    fn match_exposure(&mut self, id: KeyframeId) -> Result<(), ModelError>;

    /// One optimisation step on a keyframe's view: render, loss, backward, Adam.
    ///
    /// # Errors
    /// If there is no such view, a rendered value is out of range, or the device fails.
    fn step(&mut self, id: KeyframeId) -> Result<(), ModelError>;

    /// Statistics of the steps that finished since the last call, in order. On a graphics device a
    /// step may finish a few steps later.
    fn take_stats(&mut self) -> Vec<StepStats>;

    /// For each other view, by ascending id, the fraction of this view's visible gaussians that are
    /// visible there too. Visible means contributing to a pixel when the view was added or last
    /// optimised.
    ///
    /// # Errors
    /// If there is no such view, or the device fails.
    fn covisibility(&mut self, id: KeyframeId) -> Result<Vec<(KeyframeId, f32)>, ModelError>;

    /// Ids of the pruned gaussians of the sparse map that have not been reported yet, ascending. Never
    /// waits for the device: recent prunings may be reported by a later call.
    ///
    /// # Errors
    /// If the device fails.
    fn take_removed(&mut self) -> Result<Vec<SparseId>, ModelError>;

    /// A copy of all gaussians, after all submitted work.
    ///
    /// # Errors
    /// If the device fails.
    fn gaussians(&mut self) -> Result<Gaussians, ModelError>;

    /// All that the next calls depend on, after all submitted work, apart from the views' images.
    ///
    /// # Errors
    /// If the device fails.
    fn save(&mut self) -> Result<SavedModel, ModelError>;

    /// Takes over a saved state, also of a model on another device. `targets` are the images measured
    /// at its views, in the same order. The model must be empty.
    ///
    /// # Errors
    /// [`ModelError::Saved`] if the state contradicts itself or the targets; if an image has another
    /// size than its view; if the device fails.
    fn restore(&mut self, saved: SavedModel, targets: Vec<Target>) -> Result<(), ModelError>;

    /// Memory that the model takes on a graphics device, bytes.
    fn device_bytes(&self) -> u64 {
        0
    }

    /// All gaussians, after all submitted work; if the device has failed, the host's last copy.
    fn into_gaussians(self: Box<Self>) -> Gaussians;
}

/// Rejects a view that the model already has, or whose target differs in size.
pub(crate) fn check_view(
    exists: bool,
    id: KeyframeId,
    view: &View,
    target: &Target,
) -> Result<(), ModelError> {
    if exists {
        return Err(ModelError::ViewExists(id));
    }
    check_image(view, target.color())
}

/// Rejects an image of another size than the view's.
pub(crate) fn check_image<T>(view: &View, image: &Image<T>) -> Result<(), ModelError> {
    let expected = (view.camera.width, view.camera.height);
    let actual = (image.width(), image.height());
    if expected == actual {
        Ok(())
    } else {
        Err(ModelError::ImageSize { expected, actual })
    }
}

/// Rejects seeds whose arrays differ in length, and inferred ones of the sparse map.
pub(crate) fn check_seeds(seeds: &Seeds) -> Result<(), ModelError> {
    let Seeds {
        gaussians,
        sparse_ids,
    } = seeds;
    if !gaussians.has_len(sparse_ids.len()) {
        return Err(ModelError::RaggedSeeds);
    }
    let mut both = sparse_ids.iter().zip(&gaussians.inferred);
    if both.any(|(id, inferred)| id.is_some() && *inferred) {
        return Err(ModelError::InferredSparseSeed);
    }
    Ok(())
}

#[cfg(test)]
mod tests;
