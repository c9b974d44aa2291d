//! What a render can be compared with: a frame as one camera with a global shutter would have taken
//! it, given how the camera moved.

use std::borrow::Cow;

use fgs_data::Trajectory;
use fgs_geom::RgbdFrame;

/// Poses further apart in time do not say how the camera moved at a frame, seconds.
const MAX_GAP_SECS: f64 = 0.2;

/// The frame, its rows and its depth image brought to the moment of its time stamp, by the velocity of
/// the estimated trajectory.
pub fn synchronized<'a>(frame: &'a RgbdFrame, trajectory: &Trajectory) -> Cow<'a, RgbdFrame> {
    frame.synchronized(&trajectory.velocity(frame.timestamp_secs, MAX_GAP_SECS))
}
