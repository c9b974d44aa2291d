//! The seam between SLAM and the device that optimises: parameters, gradients, Adam's state and the
//! registered views live behind [`GaussianModel`], and nothing is read back within a step.

use fgs_geom::View;
use thiserror::Error;

use crate::{
    AdamError, Gaussians, GpuError, LearningRates, LossError, LossSettings, Rendered, Target,
};

/// A registered view. Never reused, also not after [`GaussianModel::drop_view`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ViewId(pub usize);

/// The caller's name for a gaussian of the sparse map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SparseId(pub u32);

/// New gaussians.
#[derive(Clone, Debug, Default)]
pub struct Seeds {
    /// Their parameters, [N].
    pub gaussians: Gaussians,
    /// The names of those that are part of the sparse map, [N].
    pub sparse_ids: Vec<Option<SparseId>>,
}

/// Which gaussians [`GaussianModel::prune`] removes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PruneRule {
    /// Less opaque ones.
    pub min_opacity: f32,
    /// Ones with a longer axis, metres.
    pub max_scale_m: f32,
    /// Ones with a larger ratio of the two longer axes.
    pub max_aspect: f32,
}

/// What a finished step reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepStats {
    /// The view that was optimised.
    pub view: ViewId,
    /// The loss before the step.
    pub loss: f32,
    /// How many gaussians contributed to a pixel.
    pub visible: usize,
    /// How many gradients were not finite and left out.
    pub skipped_gradients: usize,
}

/// One gaussian of the sparse map as it is now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SparseGaussian {
    /// Its name.
    pub id: SparseId,
    /// Centre, world axes, metres.
    pub mean: [f32; 3],
    /// Rotation `world_from_gaussian`, wxyz, not normalised.
    pub quat: [f32; 4],
    /// Logarithms of the standard deviations in metres.
    pub log_scales: [f32; 3],
    /// Opacity, 0 to 1.
    pub opacity: f32,
}

/// What happened to the sparse map since it was last asked for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SparseChanges {
    /// Gaussians that steps may have changed, by ascending id.
    pub moved: Vec<SparseGaussian>,
    /// Gaussians that were pruned, by ascending id.
    pub removed: Vec<SparseId>,
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
    /// The view was never registered or has been dropped.
    #[error("there is no view {0:?}")]
    NoSuchView(ViewId),
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
pub trait GaussianModel {
    /// Number of gaussians.
    fn len(&self) -> usize;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Registers a view and what it should look like.
    ///
    /// # Errors
    /// If the target's size is not the view's, or the device fails.
    fn add_view(&mut self, view: View, target: Target) -> Result<ViewId, ModelError>;

    /// Forgets a view; its gaussians stay.
    ///
    /// # Errors
    /// If there is no such view, or the device fails.
    fn drop_view(&mut self, id: ViewId) -> Result<(), ModelError>;

    /// Adds gaussians.
    ///
    /// # Errors
    /// If the seeds' arrays differ in length, or the device fails.
    fn insert(&mut self, seeds: &Seeds) -> Result<(), ModelError>;

    /// Removes gaussians; returns how many.
    ///
    /// # Errors
    /// If the device fails.
    fn prune(&mut self, rule: &PruneRule) -> Result<usize, ModelError>;

    /// Colour, depth and alpha as seen from a view.
    ///
    /// # Errors
    /// If the device fails.
    fn render(&mut self, view: &View) -> Result<Rendered, ModelError>;

    /// One optimisation step on a registered view: render, loss, backward, Adam.
    ///
    /// # Errors
    /// If there is no such view, or the device fails.
    fn step(&mut self, id: ViewId) -> Result<(), ModelError>;

    /// Statistics of steps finished since the last call, in their order.
    fn take_stats(&mut self) -> Vec<StepStats>;

    /// For each other view, ascending by id, the share of this view's visible gaussians that it
    /// shows too. Visible means contributing to a pixel when the view was last rendered.
    ///
    /// # Errors
    /// If there is no such view, or the device fails.
    fn covisibility(&mut self, id: ViewId) -> Result<Vec<(ViewId, f32)>, ModelError>;

    /// What happened to the sparse map since the last call.
    ///
    /// # Errors
    /// If the device fails.
    fn take_sparse_changes(&mut self) -> Result<SparseChanges, ModelError>;

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
    fn into_gaussians(self) -> Gaussians
    where
        Self: Sized;
}
