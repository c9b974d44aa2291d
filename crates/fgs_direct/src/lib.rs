//! Direct image alignment: camera motion from the photometric residuals of pixels with known depth.
//!
//! A pixel with depth is a 3D point. Under brightness constancy it looks equally bright from
//! another pose; the photometric residuals and the image gradients tell how the pose must change.
//! Can be used on its own, with any source of depth.

mod depth_delay;
mod image_alignment;
mod intensity;
mod keyframe_alignment;
mod reference;
mod residual;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod test_scene;

pub use depth_delay::{DepthDelay, SensorMotion, depth_delay};
pub use image_alignment::{ImageAlignment, align_images};
pub use intensity::{IntensityImage, IntensityPyramid};
pub use keyframe_alignment::{
    PhotometricAlignment, PosePrior, PosedReference, align_with_keyframes,
};
pub use reference::{Reference, ReferencePoint};
