//! The keyframes' training views: camera, target, and the index of a visibility set. The sets are on
//! the device: one bit per gaussian, set if it contributed to a pixel when the view was last
//! rendered.

use std::collections::{BTreeMap, BTreeSet};

use fgs_geom::{KeyframeId, Se3, View};

use super::buffers::Buffers;
use super::device::GpuDevice;
use super::resident_targets::ResidentTargets;
use crate::GpuError;
use crate::Target;
use crate::model::ModelError;
use crate::rigid_motion::moved;

/// A keyframe's view.
pub struct TrainingView {
    pub view: View,
    pub target: Target,
    /// Index of its visibility set.
    pub set: u32,
}

/// Views by keyframe.
pub struct TrainingViews {
    views: BTreeMap<KeyframeId, TrainingView>,
    free_sets: BTreeSet<u32>,
    targets: ResidentTargets,
}

impl TrainingViews {
    /// No views. Up to `target_bytes` of targets are kept on the device.
    pub fn new(buffers: &Buffers, target_bytes: u64) -> Self {
        Self {
            views: BTreeMap::new(),
            free_sets: (0..buffers.sets() as u32).collect(),
            targets: ResidentTargets::new(target_bytes),
        }
    }

    /// Adds a view of a keyframe that has none.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn add(
        &mut self,
        buffers: &mut Buffers,
        id: KeyframeId,
        view: View,
        target: Target,
    ) -> Result<(), GpuError> {
        let set = match self.free_sets.pop_first() {
            Some(set) => set,
            None => {
                let set = buffers.sets() as u32;
                buffers.double_sets()?;
                self.free_sets.extend(set + 1..buffers.sets() as u32);
                set
            }
        };
        self.views.insert(id, TrainingView { view, target, set });
        Ok(())
    }

    /// Drops a view.
    ///
    /// # Errors
    /// If there is none.
    pub fn remove(&mut self, buffers: &mut Buffers, id: KeyframeId) -> Result<(), ModelError> {
        let dropped = self.views.remove(&id).ok_or(ModelError::NoSuchView(id))?;
        self.free_sets.insert(dropped.set);
        self.targets.remove(buffers, dropped.set);
        Ok(())
    }

    /// Replaces the images measured at a view by others of the same size.
    ///
    /// # Errors
    /// If there is no such view.
    pub fn replace_target(
        &mut self,
        buffers: &mut Buffers,
        id: KeyframeId,
        target: Target,
    ) -> Result<(), ModelError> {
        let training = self.views.get_mut(&id).ok_or(ModelError::NoSuchView(id))?;
        training.target = target;
        self.targets.remove(buffers, training.set);
        Ok(())
    }

    /// Whether the keyframe has a view.
    pub fn contains(&self, id: KeyframeId) -> bool {
        self.views.contains_key(&id)
    }

    /// A keyframe's view.
    ///
    /// # Errors
    /// If there is none.
    pub fn get(&self, id: KeyframeId) -> Result<&TrainingView, ModelError> {
        self.views.get(&id).ok_or(ModelError::NoSuchView(id))
    }

    /// All views by ascending id.
    pub fn iter(&self) -> impl Iterator<Item = (KeyframeId, &TrainingView)> {
        self.views.iter().map(|(id, view)| (*id, view))
    }

    /// Moves the cameras of some keyframes.
    pub fn move_cameras(&mut self, motions: &BTreeMap<KeyframeId, Se3>) {
        for (id, training) in &mut self.views {
            if let Some(motion) = motions.get(id) {
                training.view = moved(&training.view, motion);
            }
        }
    }

    /// A keyframe's view, whose target is uploaded if it is not on the device.
    ///
    /// # Errors
    /// If there is none, or the device is out of memory.
    pub fn require(
        &mut self,
        device: &GpuDevice,
        buffers: &mut Buffers,
        id: KeyframeId,
    ) -> Result<&TrainingView, ModelError> {
        let training = self.views.get(&id).ok_or(ModelError::NoSuchView(id))?;
        self.targets
            .require(device, buffers, training.set, &training.target)?;
        Ok(training)
    }
}
