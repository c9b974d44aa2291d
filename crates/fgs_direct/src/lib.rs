//! Direct image alignment: what the brightness of pixels with known depth says about motion.
//!
//! A pixel with depth is a point in space. Seen from another pose it should be as bright as before;
//! the differences of brightness, and the image's gradients, say how the pose must change. Usable
//! alone, beside any source of depth.

mod image_alignment;
mod intensity;
mod sensor_calibration;

pub use image_alignment::{ImageAlignment, align_images};
pub use intensity::{IntensityImage, IntensityPyramid};
pub use sensor_calibration::{SensorCalibration, SensorMotion, calibrate};
