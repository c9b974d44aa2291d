//! Gaussian splatting: gaussians, a differentiable rasteriser of colour, depth and alpha, losses,
//! Adam, and PLY files. Knows nothing of SLAM.

mod cpu;
mod gaussians;
mod rendering;

#[cfg(test)]
mod reference;

pub use cpu::{Rasterizer, Real, RenderPass};
pub use gaussians::{Gaussians, SH0_FACTOR};
pub use rendering::{Cotangents, GaussianGradients, Rendered};
