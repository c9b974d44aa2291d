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

/// A set of numbers as bits, each number raised, in so many words.
fn moved_up(bits: &[u32], by: usize, words: usize) -> Vec<u32> {
    let (whole, rest) = (by / 32, by % 32);
    let word = |at: usize| u64::from(bits.get(at).copied().unwrap_or(0));
    let moved = |at: usize| {
        let low = at.checked_sub(1).map_or(0, word);
        (((word(at) << 32 | low) << rest) >> 32) as u32
    };
    let all = (0..words).map(|at| at.checked_sub(whole).map_or(0, moved));
    all.collect()
}

impl SavedModel {
    /// Takes in another model, whose keyframes and sparse points get other names. Views that both have are not
    /// told apart.
    pub fn append(
        &mut self,
        other: Self,
        keyframe: impl Fn(KeyframeId) -> KeyframeId,
        sparse: impl Fn(SparseId) -> SparseId,
    ) {
        let before = self.gaussians.len();
        self.gaussians.extend(&other.gaussians);
        let ids = other.sparse_ids.into_iter();
        self.sparse_ids.extend(ids.map(|id| id.map(&sparse)));
        self.anchors
            .extend(other.anchors.into_iter().map(&keyframe));
        self.adam.append(other.adam);
        self.removed.extend(other.removed.into_iter().map(&sparse));
        let words = self.gaussians.len().div_ceil(32);
        for saved in &mut self.views {
            saved.visible.resize(words, 0);
        }
        self.views
            .extend(other.views.into_iter().map(|saved| SavedView {
                id: keyframe(saved.id),
                visible: moved_up(&saved.visible, before, words),
                ..saved
            }));
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    fn members(bits: &[u32]) -> Vec<usize> {
        let numbers = 0..32 * bits.len();
        let is_member = |i: &usize| bits[i / 32] >> (i % 32) & 1 == 1;
        numbers.filter(is_member).collect()
    }

    #[test]
    fn members_of_a_set_are_raised() {
        let bits = [0x8000_0001, 0xf000_0000, 0x1];
        for by in [0, 1, 31, 32, 33, 64, 95] {
            let words = (65_usize + by).div_ceil(32);
            let moved = moved_up(&bits, by, words);
            let expected: Vec<usize> = members(&bits).iter().map(|i| i + by).collect();
            assert_eq!((members(&moved), moved.len()), (expected, words), "{by}");
        }
    }
}
