//! Direct image alignment: camera motion from the photometric residuals of pixels with known depth.
//!
//! A pixel with depth is a 3D point. Under brightness constancy it looks equally bright from
//! another pose; the photometric residuals and the image gradients tell how the pose must change.
//! Can be used on its own, with any source of depth.

mod agreement;
mod color_readout;
mod depth_delay;
mod depth_readout;
mod image_alignment;
mod intensity;
mod keyframe_alignment;
mod normal_equations;
mod readout;
mod reference;
mod residual;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod test_scene;
mod time_estimate;

pub use agreement::{Agreement, agreement, contrast};
pub use color_readout::{ColorPair, color_readout};
pub use depth_delay::{SensorMotion, depth_delay};
pub use depth_readout::{DepthPair, Patch, PatchGrid, depth_readout};
pub use image_alignment::{ImageAlignment, align_images};
pub use intensity::{IntensityImage, IntensityPyramid};
pub use keyframe_alignment::{
    PhotometricAlignment, PosePrior, PosedReference, align_with_keyframes,
};
pub use reference::{Reference, ReferencePoint};
pub use time_estimate::TimeEstimate;
