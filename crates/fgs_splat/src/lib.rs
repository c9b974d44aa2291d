//! Gaussian splatting: gaussians, a differentiable rasteriser of colour, depth and alpha, losses,
//! Adam, the [`GaussianModel`] that ties them together, and PLY files. Knows nothing of SLAM.

// Some constants and functions are shared with the shaders only.
#![cfg_attr(not(feature = "gpu"), allow(dead_code, unused_imports))]

mod adam;
mod contradicted;
mod cpu;
mod cpu_model;
mod exposure;
mod gaussians;
#[cfg(feature = "gpu")]
mod gpu;
mod gpu_error;
mod kernel;
mod least_useful;
mod losses;
mod model;
mod ply;
#[cfg(test)]
mod reference;
mod rendering;
mod rigid_motion;
mod saved_model;
mod setting;
mod visibility;

pub use adam::{Adam, AdamError, LearningRates};
pub use cpu::{Rasterizer, Real, RenderPass};
pub use cpu_model::CpuModel;
pub use gaussians::{Gaussian, Gaussians, SH0_FACTOR};
#[cfg(feature = "gpu")]
pub use gpu::{DispatchCosts, GpuDevice, GpuModel, Rates, TimedStep};
pub use gpu_error::GpuError;
pub use losses::{ImageLoss, LossError, LossSettings, Target, photometric_loss, scale_regularizer};
pub use model::{GaussianModel, ModelError, ModelSettings, PruneRule, Seeds, SparseId, StepStats};
pub use ply::{PlyError, encode_ply, read_ply, write_ply};
pub use rendering::{Cotangents, GaussianGradient, GaussianGradients, Rendered};
pub use saved_model::{SavedModel, SavedView};
pub use setting::SettingError;
