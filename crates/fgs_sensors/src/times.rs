//! What the motions of both sensors say about their times.

use fgs_data::CameraFile;
use fgs_direct::{TimeEstimate, color_readout, depth_delay, depth_readout};

use crate::{SensorWatch, median};

/// In standard errors.
const MIN_SIGNIFICANCE: f64 = 4.0;

/// Where the image moves by less in a second, what looks like motion may be its measurement's error.
const MIN_SPEED_PX: f64 = 20.0;

/// A smaller shift in the image is not worth a setting, pixels of the recording.
const MIN_SHIFT_PX: f64 = 0.5;

/// If a standard error shifts the image by more, pixels, the recording does not show the time.
const MAX_ERROR_PX: f64 = 1.0;

/// The sensors' times as a recording shows them; `None` where it has too little motion.
#[derive(Clone, Debug)]
pub struct MeasuredTimes {
    /// How much later depth is measured than colour.
    pub depth_delay: Option<MeasuredTime>,
    /// From the first to the last row of a colour image.
    pub color_readout: Option<MeasuredTime>,
    /// The same of a depth image.
    pub depth_readout: Option<MeasuredTime>,
}

/// A time as a recording shows it.
#[derive(Clone, Debug)]
pub struct MeasuredTime {
    /// The time and its error.
    pub estimate: TimeEstimate,
    /// How fast the image usually moves, pixels of the recording per second.
    pub speed_px: f64,
    /// By what share of the motion during that time the image is off at most.
    pub share: f64,
}

impl MeasuredTimes {
    /// Starts from what a camera file says, with which the frames have been read.
    pub fn of(mut watch: SensorWatch, given: &CameraFile) -> Self {
        let sensor = given.depth_sensor();
        let mut motions = watch.motions();
        let color_readout = color_readout(&mut watch.color_pairs, given.color_readout_secs());
        let depth_readout = depth_readout(&mut watch.depth_pairs, sensor.readout_secs);
        if color_readout.is_some() && depth_readout.is_some() {
            // Those between the middle rows: without the distortion by the shutters, which differs
            // between the sensors.
            motions = watch.motions();
        }
        let speed_px = median(watch.speeds_px);
        let measured = |estimate: Option<TimeEstimate>, share| {
            let (estimate, speed_px) = estimate.zip(speed_px)?;
            Some(MeasuredTime {
                estimate,
                speed_px,
                share,
            })
        };
        Self {
            depth_delay: measured(depth_delay(&motions, &sensor), 1.0),
            // The middle row is where it should be.
            color_readout: measured(color_readout, 0.5),
            depth_readout: measured(depth_readout, 0.5),
        }
    }
}

impl MeasuredTime {
    /// By how many pixels the image is off at most where this time is taken for the true one.
    pub fn shift_px(&self, secs: f64) -> f64 {
        (self.estimate.secs - secs).abs() * self.share * self.speed_px
    }

    /// Whether another time is certainly wrong, and visibly.
    pub fn refutes(&self, secs: f64) -> bool {
        let off_secs = (self.estimate.secs - secs).abs();
        self.shift_px(secs) >= MIN_SHIFT_PX
            && off_secs >= MIN_SIGNIFICANCE * self.estimate.standard_error_secs
            && self.speed_px >= MIN_SPEED_PX
    }

    /// Whether the recording shows this time at all.
    pub fn is_shown(&self) -> bool {
        let error_px = self.estimate.standard_error_secs * self.share * self.speed_px;
        error_px <= MAX_ERROR_PX && self.speed_px >= MIN_SPEED_PX
    }

    /// The time to go by where nothing else is known, seconds: this one if each third of the recording
    /// also refutes that there is none, else 0.
    pub fn or_zero(&self) -> f64 {
        let secs = self.estimate.secs;
        let agree = |thirds: [f64; 3]| thirds.iter().all(|third| third * secs > 0.0);
        let is_certain = self.refutes(0.0) && self.estimate.thirds_secs.is_some_and(agree);
        if is_certain { secs } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(secs: f64, standard_error_secs: f64, speed_px: f64) -> MeasuredTime {
        MeasuredTime {
            estimate: TimeEstimate {
                secs,
                standard_error_secs,
                thirds_secs: Some([-0.011, -0.012, -0.013]),
            },
            speed_px,
            share: 1.0,
        }
    }

    #[test]
    fn only_visible_and_certain_errors_count() {
        let late = measured(-0.0124, 0.001, 300.0);
        assert!(late.refutes(0.002) && late.is_shown());
        assert!((late.shift_px(0.002) - 4.32).abs() <= 1e-9);
        // Not visible, not certain, hardly any motion.
        assert!(!measured(0.003, 0.0001, 300.0).refutes(0.002));
        let vague = measured(-0.0124, 0.005, 300.0);
        assert!(!vague.refutes(0.002) && !vague.is_shown());
        let still = measured(-0.5, 0.001, 10.0);
        assert!(!still.refutes(0.002) && !still.is_shown());
    }

    #[test]
    fn a_recording_is_believed_if_its_parts_agree() {
        let late = measured(-0.0124, 0.001, 300.0);
        assert!((late.or_zero() + 0.0124).abs() <= 1e-12);
        for thirds_secs in [None, Some([-0.03, 0.001, -0.01])] {
            let mut doubtful = late.clone();
            doubtful.estimate.thirds_secs = thirds_secs;
            assert!(doubtful.or_zero().abs() <= 1e-12);
        }
        assert!(measured(-0.0124, 0.005, 300.0).or_zero().abs() <= 1e-12);
    }
}
