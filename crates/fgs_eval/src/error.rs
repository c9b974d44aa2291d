//! Everything that can be wrong with the input of an evaluation.

use thiserror::Error;

/// Why something cannot be evaluated.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum EvalError {
    /// Estimated and reference poses do not pair up.
    #[error("{estimated} estimated poses cannot be compared with {reference} reference poses")]
    UnequalLengths {
        /// Number of estimated poses.
        estimated: usize,
        /// Number of reference poses.
        reference: usize,
    },
    /// The error is not defined for so few poses.
    #[error("{poses} poses are too few, at least {minimum} are needed")]
    TooFewPoses {
        /// Number of poses given.
        poses: usize,
        /// Number of poses needed.
        minimum: usize,
    },
    /// A relative error over no frames.
    #[error("the frame delta of a relative error must be at least 1")]
    ZeroDelta,
    /// A position is not finite or further from the origin than any recording reaches.
    #[error("pose {index} of the {trajectory} trajectory is not finite or out of range")]
    PoseOutOfRange {
        /// "estimated" or "reference".
        trajectory: &'static str,
        /// Which pose, from 0.
        index: usize,
    },
    /// Two images to be compared differ in size.
    #[error("an image of {}x{} cannot be compared with one of {}x{}", a.0, a.1, b.0, b.1)]
    UnequalSizes {
        /// Width and height of the first image.
        a: (usize, usize),
        /// Width and height of the second image.
        b: (usize, usize),
    },
    /// The image is smaller than the window of the measure.
    #[error(
        "an image of {width}x{height} is too small, at least {minimum} pixels a side are needed"
    )]
    TooSmall {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Columns and rows needed.
        minimum: usize,
    },
    /// A rendered value is NaN.
    #[error("pixel ({u}, {v}) of the rendered image is not a number")]
    NotANumber {
        /// Column of the first such pixel.
        u: usize,
        /// Row of the first such pixel.
        v: usize,
    },
}
