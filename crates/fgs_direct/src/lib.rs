//! Direct image alignment: what the brightness of pixels with known depth says about motion.
//!
//! A pixel with depth is a point in space. Seen from another pose it should be as bright as before;
//! the differences of brightness, and the image's gradients, say how the pose must change. Usable
//! alone, beside any source of depth.

mod align;
mod intensity;
mod reference;
mod residual;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod test_scene;

pub use align::{PhotometricAlignment, PosePrior, PosedReference, align};
pub use intensity::{IntensityImage, IntensityPyramid};
pub use reference::{Reference, ReferencePoint};
