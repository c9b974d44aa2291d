//! Accuracy of a trajectory and quality of a map's renders (Sec. IV).
//!
//! In: poses, images and depth in the types of `fgs_geom`. Out: plain numbers, never NaN, units in
//! their names. Trajectory errors agree with `evo`, image metrics with scikit-image. A pixel whose
//! colour the camera did not see counts as outside the image.

mod alignment;
mod association;
mod depth;
mod error;
mod exposure;
mod image_quality;
mod pixels;
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
