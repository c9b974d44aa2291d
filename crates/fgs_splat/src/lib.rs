//! Gaussian splatting: gaussians, a differentiable rasteriser of colour, depth and alpha, losses,
//! Adam, and PLY files. Knows nothing of SLAM.

mod adam;
mod gaussians;
mod losses;
mod ply;

pub use adam::{Adam, AdamError, LearningRates};
pub use gaussians::{Gaussian, Gaussians, SH0_FACTOR};
pub use losses::{ImageLoss, LossError, LossSettings, Target, photometric_loss, scale_regularizer};
pub use ply::{PlyError, read_ply, write_ply};
