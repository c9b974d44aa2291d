//! The model on the CPU: always works and is the reference for every other backend.

use std::collections::BTreeMap;

use fgs_geom::View;

use crate::model::{
    GaussianModel, ModelError, ModelSettings, PruneRule, Seeds, SparseChanges, SparseGaussian,
    SparseId, StepStats, ViewId,
};
use crate::visibility::VisibleSet;
use crate::{Adam, Gaussians, Rasterizer, Rendered, Target, image_loss, regularizer};

/// A registered view.
struct TrainingView {
    view: View,
    target: Target,
    /// The gaussians that contributed to a pixel when the view was last rendered.
    visible: VisibleSet,
}

/// A [`GaussianModel`] on the CPU. Results are the same bits for any number of threads.
pub struct CpuModel {
    settings: ModelSettings,
    gaussians: Gaussians,
    sparse_ids: Vec<Option<SparseId>>,
    /// Sparse gaussians changed since they were last asked for, [N].
    moved: VisibleSet,
    removed: Vec<SparseId>,
    adam: Adam,
    rasterizer: Rasterizer,
    views: BTreeMap<ViewId, TrainingView>,
    next_view: ViewId,
    stats: Vec<StepStats>,
}
