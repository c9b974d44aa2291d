//! One colour and depth image pair with its camera.

use serde::{Deserialize, Serialize};

use crate::{Camera, Image};

/// The position of a frame in its recording, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct FrameIndex(pub usize);

/// Names a keyframe, in the order in which they were made. Never reused within a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct KeyframeId(pub u32);

/// A colour image and the depth image registered to it, both of the camera's size and free of
/// lens distortion.
#[derive(Clone, Debug)]
pub struct RgbdFrame {
    /// Where the frame stands in its recording.
    pub index: FrameIndex,
    /// Time of the colour image, seconds on the recording's own clock.
    pub timestamp_secs: f64,
    /// sRGB colour as in the file.
    pub color: Image<[u8; 3]>,
    /// Depth along z, metres; 0 or non-finite: none.
    pub depth_m: Image<f32>,
    /// The pinhole camera of both images.
    pub camera: Camera,
}

/// Whether a depth value is a measurement.
#[inline]
pub fn has_depth(depth_m: f32) -> bool {
    depth_m.is_finite() && depth_m > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_counts_as_depth() {
        assert!(has_depth(0.5));
        for none in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(!has_depth(none));
        }
    }
}
