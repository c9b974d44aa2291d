//! Gaussian splatting: gaussians, a differentiable rasteriser of colour, depth and alpha, losses,
//! Adam, and PLY files. Knows nothing of SLAM.

mod gaussians;

pub use gaussians::{Gaussians, SH0_FACTOR};
