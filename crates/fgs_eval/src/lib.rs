//! How good a trajectory and a map's pictures are (Sec. IV).
//!
//! In: poses, images and depth in the types of `fgs_geom`. Out: plain numbers with their units in
//! their names, never NaN. Trajectory errors agree with `evo`, image errors with scikit-image.

mod alignment;
mod association;
mod depth;
mod error;
mod image_quality;
mod ssim;
mod statistics;
mod trajectory;

pub use alignment::align_positions;
pub use association::associate;
pub use depth::{DepthError, depth_error};
pub use error::EvalError;
pub use image_quality::{ImageQuality, MAX_PSNR_DB, image_quality};
pub use ssim::ssim;
pub use statistics::Statistics;
pub use trajectory::{Ate, Rpe, ate, rpe};
