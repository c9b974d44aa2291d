//! The model on a graphics device. Not there yet: no device is ever found.

mod error;

use fgs_geom::View;

use crate::model::{
    GaussianModel, ModelError, ModelSettings, PruneRule, Seeds, SparseChanges, StepStats, ViewId,
};
use crate::{CpuModel, Gaussians, Rendered, Target};

pub use error::GpuError;

/// A graphics device that can hold a [`GpuModel`].
#[derive(Debug)]
pub struct GpuDevice {
    name: String,
}

impl GpuDevice {
    /// The fastest device there is; one in software only if it may be one.
    ///
    /// # Errors
    /// If there is none that can be used.
    pub fn find(_accept_software: bool) -> Result<Self, GpuError> {
        Err(GpuError::NoAdapter(String::new()))
    }

    /// Its name for people, such as "NVIDIA H200 (Vulkan)".
    pub fn name(&self) -> &str {
        &self.name
    }
}

/// A [`GaussianModel`] on a graphics device.
pub struct GpuModel {
    model: CpuModel,
}

impl GpuModel {
    /// An empty map. The images of at most `max_resident_views` views lie on the device, the rest
    /// waits in host memory.
    ///
    /// # Errors
    /// If the device fails.
    pub fn new(
        _device: GpuDevice,
        settings: ModelSettings,
        _max_resident_views: usize,
    ) -> Result<Self, GpuError> {
        Ok(Self {
            model: CpuModel::new(settings),
        })
    }
}

impl GaussianModel for GpuModel {
    fn len(&self) -> usize {
        self.model.len()
    }

    fn add_view(&mut self, view: View, target: Target) -> Result<ViewId, ModelError> {
        self.model.add_view(view, target)
    }

    fn drop_view(&mut self, id: ViewId) -> Result<(), ModelError> {
        self.model.drop_view(id)
    }

    fn insert(&mut self, seeds: &Seeds) -> Result<(), ModelError> {
        self.model.insert(seeds)
    }

    fn prune(&mut self, rule: &PruneRule) -> Result<usize, ModelError> {
        self.model.prune(rule)
    }

    fn render(&mut self, view: &View) -> Result<Rendered, ModelError> {
        self.model.render(view)
    }

    fn step(&mut self, id: ViewId) -> Result<(), ModelError> {
        self.model.step(id)
    }

    fn take_stats(&mut self) -> Vec<StepStats> {
        self.model.take_stats()
    }

    fn covisibility(&mut self, id: ViewId) -> Result<Vec<(ViewId, f32)>, ModelError> {
        self.model.covisibility(id)
    }

    fn take_sparse_changes(&mut self) -> Result<SparseChanges, ModelError> {
        self.model.take_sparse_changes()
    }

    fn gaussians(&mut self) -> Result<Gaussians, ModelError> {
        self.model.gaussians()
    }

    fn into_gaussians(self) -> Gaussians {
        self.model.into_gaussians()
    }
}
