//! What the poses that come with a recording are worth.

use std::fmt;

/// Where the poses of a recording come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseOrigin {
    /// Measured from outside, or what a rendering was made with: errors against them are errors.
    GroundTruth,
    /// Estimated by the device or by a program from the same images: they drift and jump too, and what
    /// differs from them need not be wrong.
    Device,
}

impl fmt::Display for PoseOrigin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::GroundTruth => "ground truth",
            Self::Device => "the device's poses",
        })
    }
}
