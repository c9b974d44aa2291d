//! A model between two calls, as plain data: what a map's file holds. The same on every device, so that a
//! map may go on elsewhere than where it was made.

use std::collections::BTreeSet;

use fgs_geom::{KeyframeId, View};
use serde::{Deserialize, Serialize};

use crate::model::{ModelError, check_image};
use crate::{Adam, Gaussians, SparseId, Target};

/// N gaussians with all their state, and the views.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SavedModel {
    /// The parameters.
    pub gaussians: Gaussians,
    /// Ids of those that are part of the sparse map, `[N]`.
    pub sparse_ids: Vec<Option<SparseId>>,
    /// The keyframes that they are anchored to, `[N]`.
    pub anchors: Vec<KeyframeId>,
    /// Adam's moments, and how many steps each gaussian has taken, `[N]`.
    pub adam: Adam,
    /// Pruned gaussians of the sparse map that have not been reported yet.
    pub removed: Vec<SparseId>,
    /// The views, by ascending id.
    pub views: Vec<SavedView>,
}

/// A view without the images measured there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedView {
    /// Its keyframe.
    pub id: KeyframeId,
    /// Camera and pose.
    pub view: View,
    /// Which gaussians contributed to a pixel when it was last rendered: gaussian i is bit `i % 32` of
    /// word `i / 32`, `[N / 32]`, rounded up.
    pub visible: Vec<u32>,
}

impl SavedModel {
    /// Rejects what no model can have saved.
    pub(crate) fn check(&self, targets: &[Target]) -> Result<(), ModelError> {
        let count = self.sparse_ids.len();
        let refuse = |what| Err(ModelError::Saved(what));
        if !(self.gaussians.has_len(count)
            && self.anchors.len() == count
            && self.adam.has_len(count))
        {
            return refuse("its arrays have different lengths");
        }
        let mut both = self.sparse_ids.iter().zip(&self.gaussians.inferred);
        if both.any(|(id, inferred)| id.is_some() && *inferred) {
            return Err(ModelError::InferredSparseSeed);
        }
        let ids: BTreeSet<KeyframeId> = self.views.iter().map(|view| view.id).collect();
        if ids.len() < self.views.len() {
            return refuse("two views of one keyframe");
        }
        if targets.len() != self.views.len() {
            return refuse("not every view has its images");
        }
        for (saved, target) in self.views.iter().zip(targets) {
            check_image(&saved.view, target.color())?;
            if saved.visible.len() != count.div_ceil(32) {
                return refuse("a view's set of gaussians has another size");
            }
            let beyond = saved.visible.last().filter(|_| !count.is_multiple_of(32));
            if beyond.is_some_and(|word| word >> (count % 32) != 0) {
                return refuse("a view shows gaussians that do not exist");
            }
        }
        Ok(())
    }
}
