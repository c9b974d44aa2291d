//! Direct image alignment: what the brightness of pixels with known depth says about motion.
//!
//! A pixel with depth is a point in space. Seen from another pose it should be as bright as before;
//! the differences of brightness, and the image's gradients, say how the pose must change. Usable
//! alone, beside any source of depth.

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
