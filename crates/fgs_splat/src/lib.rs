//! Gaussian splatting: gaussians, a differentiable rasteriser of colour, depth and alpha, losses,
//! Adam, the [`GaussianModel`] that ties them together, and PLY files. Knows nothing of SLAM.

mod adam;
mod cpu;
mod cpu_model;
mod gaussians;
mod gpu;
mod kernel;
mod losses;
mod model;
mod ply;
#[cfg(test)]
mod reference;
mod rendering;
mod rigid_motion;
mod setting;
mod visibility;

pub use adam::{Adam, AdamError, LearningRates};
pub use cpu::{Rasterizer, Real, RenderPass};
pub use cpu_model::CpuModel;
pub use gaussians::{Gaussian, Gaussians, SH0_FACTOR};
pub use gpu::{GpuDevice, GpuError, GpuModel, Rates, TimedStep};
pub use losses::{ImageLoss, LossError, LossSettings, Target, photometric_loss, scale_regularizer};
pub use model::{GaussianModel, ModelError, ModelSettings, PruneRule, Seeds, SparseId, StepStats};
pub use ply::{PlyError, read_ply, write_ply};
pub use rendering::{Cotangents, GaussianGradient, GaussianGradients, Rendered};
pub use setting::SettingError;
