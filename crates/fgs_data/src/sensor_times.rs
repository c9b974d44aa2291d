//! When the two sensors of an RGB-D camera take their images.

use fgs_geom::CameraError;

use crate::camera_file::refuse;

/// When images are taken; `None` where nobody has said so.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensorTimes {
    /// How much later depth is measured than its time stamp says, which is that of its colour image,
    /// seconds.
    pub depth_delay_secs: Option<f64>,
    /// From the first to the last row of a colour image, seconds; 0 for a global shutter, negative from
    /// the last row to the first.
    pub color_readout_secs: Option<f64>,
    /// The same of a depth image.
    pub depth_readout_secs: Option<f64>,
}

impl SensorTimes {
    /// Whether there is nothing left to measure.
    pub fn are_known(&self) -> bool {
        let times = [
            self.depth_delay_secs,
            self.color_readout_secs,
            self.depth_readout_secs,
        ];
        times.iter().all(Option::is_some)
    }

    pub(crate) fn check(&self) -> Result<(), CameraError> {
        let limits = [
            ("depth_delay_secs", self.depth_delay_secs, 1.0, "-1 to 1 s"),
            (
                "color_readout_secs",
                self.color_readout_secs,
                0.2,
                "-0.2 to 0.2 s",
            ),
            (
                "depth_readout_secs",
                self.depth_readout_secs,
                0.2,
                "-0.2 to 0.2 s",
            ),
        ];
        for (key, secs, most, expected) in limits {
            if let Some(secs) = secs.filter(|secs| !(-most..=most).contains(secs)) {
                return refuse(key, secs, expected);
            }
        }
        Ok(())
    }
}
