//! Images that come again. A recorder that asks a camera for its newest images faster than the camera
//! takes them gets some twice, of one sensor or of both. Such an image is not of the time of its stamp:
//! a pose or a velocity that believes so is wrong by a frame's motion.

use std::sync::Arc;

use fgs_geom::{Image, RgbdFrame, Se3, has_depth};
use serde::{Deserialize, Serialize};

use crate::frame_result::TrackingQuality;
use crate::verdict::Verdict;

/// Newer intervals count this much in the mean interval between images, and stamps in their times.
const RATE: f64 = 0.1;

/// A camera that gave no image twice for so long keeps the pace of the recorder.
const FORGOTTEN_SECS: f64 = 1.0;

/// When images were really taken, seconds on the recording's clock. A slow camera takes them at even
/// intervals; the recorder's stamps of those that come once are too early or too late by up to a period.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Clock {
    /// Of the newest image: its stamp, and when it was taken.
    stamp_secs: f64,
    taken_secs: f64,
    mean_interval_secs: Option<f64>,
    repeated_secs: f64,
}

impl Default for Clock {
    fn default() -> Self {
        Self {
            stamp_secs: f64::NAN,
            taken_secs: f64::NAN,
            mean_interval_secs: None,
            repeated_secs: f64::NEG_INFINITY,
        }
    }
}

impl Clock {
    /// An image came again at a time.
    pub fn repeat(&mut self, stamp_secs: f64) {
        self.repeated_secs = stamp_secs;
    }

    /// A new image came with a stamp.
    pub fn take(&mut self, stamp_secs: f64) {
        let interval = stamp_secs - self.stamp_secs;
        let taken_secs = match self.mean_interval_secs {
            Some(mean) if stamp_secs - self.repeated_secs < FORGOTTEN_SECS => {
                let expected = self.taken_secs + mean;
                expected + RATE * (stamp_secs - expected)
            }
            _ => stamp_secs,
        };
        if interval.is_finite() {
            let mean = self.mean_interval_secs.unwrap_or(interval);
            self.mean_interval_secs = Some(mean + RATE * (interval - mean));
        }
        (self.stamp_secs, self.taken_secs) = (stamp_secs, taken_secs);
    }

    /// When the newest image was taken.
    pub fn now_secs(&self) -> f64 {
        self.taken_secs
    }
}

/// Which images of a frame came with the frame before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repeat {
    /// The colour image: the camera is where it was.
    Color,
    /// The depth image alone: it tells nothing of this frame.
    Depth,
}

/// The last frame that was not a repetition, or its name, and what became of it.
#[derive(Clone, Serialize, Deserialize)]
pub struct LatestFrame<F = Arc<RgbdFrame>> {
    pub frame: F,
    pub verdict: Verdict,
    pub world_from_camera: Option<Se3>,
    pub quality: TrackingQuality,
}

impl<F> LatestFrame<F> {
    /// The same of a frame that is named otherwise.
    pub fn with_frame<G>(&self, frame: G) -> LatestFrame<G> {
        LatestFrame {
            frame,
            verdict: self.verdict,
            world_from_camera: self.world_from_camera,
            quality: self.quality,
        }
    }
}

impl LatestFrame {
    /// What a frame repeats of this one.
    pub fn repeated_by(&self, frame: &RgbdFrame) -> Option<Repeat> {
        // What never changes is a sensor that is off or missing.
        if self.frame.color == frame.color && !is_blank(&frame.color) {
            Some(Repeat::Color)
        } else if self.frame.depth_m == frame.depth_m
            && frame.depth_m.data().iter().any(|depth| has_depth(*depth))
        {
            Some(Repeat::Depth)
        } else {
            None
        }
    }
}

/// Whether an image shows nothing.
fn is_blank(color: &Image<[u8; 3]>) -> bool {
    let mut pixels = color.data().iter();
    let first = pixels.next();
    pixels.all(|pixel| Some(pixel) == first)
}

#[cfg(test)]
mod tests {
    use fgs_geom::{Camera, FrameIndex, Intrinsics};

    use super::*;

    fn latest(color: u8, depth_m: f32) -> LatestFrame {
        LatestFrame {
            frame: Arc::new(frame(color, depth_m)),
            verdict: Verdict::Tracked,
            world_from_camera: None,
            quality: TrackingQuality::default(),
        }
    }

    /// A frame whose images are told apart by these values; 0 for sensors that give nothing.
    fn frame(color: u8, depth_m: f32) -> RgbdFrame {
        let intrinsics = Intrinsics {
            fx: 8.0,
            fy: 8.0,
            cx: 3.5,
            cy: 3.5,
        };
        let camera = Camera::new(8, 8, intrinsics).unwrap();
        let color = Image::from_fn(8, 8, |u, _| [color * u as u8; 3]);
        let depth_m = Image::filled(8, 8, depth_m);
        RgbdFrame::new(FrameIndex(0), 0.0, color, depth_m, camera).unwrap()
    }

    #[test]
    fn images_that_come_again_are_told_from_sensors_that_are_off() {
        let repeat = |color, depth_m| latest(2, 1.5).repeated_by(&frame(color, depth_m));
        assert_eq!(repeat(3, 1.6), None);
        assert_eq!(repeat(2, 1.5), Some(Repeat::Color));
        assert_eq!(repeat(2, 1.6), Some(Repeat::Color));
        assert_eq!(repeat(3, 1.5), Some(Repeat::Depth));
        assert_eq!(latest(0, 1.5).repeated_by(&frame(0, 1.6)), None);
        assert_eq!(latest(2, 0.0).repeated_by(&frame(3, 0.0)), None);
    }

    /// A camera of 24 images a second, asked for its newest 30 times a second.
    #[test]
    fn images_of_a_slow_camera_are_evenly_spaced() {
        let mut clock = Clock::default();
        let mut taken = Vec::new();
        let newest = |i: usize| (i * 24) / 30;
        for i in 0..300 {
            let stamp_secs = i as f64 / 30.0;
            if i > 0 && newest(i) == newest(i - 1) {
                clock.repeat(stamp_secs);
            } else {
                clock.take(stamp_secs);
                taken.push(clock.now_secs());
            }
        }
        // Stamps say 33 or 67 ms.
        for pair in taken[30..].windows(2) {
            let interval_secs = pair[1] - pair[0];
            assert!(
                (interval_secs - 1.0 / 24.0).abs() < 0.005,
                "{interval_secs}"
            );
        }
        assert!((taken[200] - (200.0 / 24.0)).abs() < 0.05);
    }

    #[test]
    fn without_repetitions_stamps_are_believed_whatever_they_are() {
        let mut clock = Clock::default();
        for stamp_secs in [0.0, 0.03, 0.2, 0.25, 0.25, 3.0] {
            clock.take(stamp_secs);
            assert_eq!(clock.now_secs(), stamp_secs);
        }
    }
}
