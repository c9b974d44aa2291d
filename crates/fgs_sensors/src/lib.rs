//! When the two sensors of an RGB-D camera take their images, measured from a recording.
//!
//! Depth is often measured some milliseconds before or after the colour image with the same time stamp,
//! and both sensors read their rows one after the other. While the camera turns, that shifts colours on
//! surfaces and bends both. [`SensorWatch`] takes frames in order and tells the three times;
//! [`measure`] does so for a recording on disk.

mod measure;
mod motions;
mod stretches;
mod times;

pub use measure::{frames_to_measure, measure};
pub use motions::SensorWatch;
pub use stretches::{frames_in, is_gap, stretches, usual_interval};
pub use times::{MeasuredTime, MeasuredTimes};

/// The median; `None` without values.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
