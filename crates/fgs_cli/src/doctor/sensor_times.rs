//! Whether the camera file says when the rows of both images are measured: compares the delay of the
//! depth sensor and the readouts of both sensors with those that explain best how the sensors move and
//! what they see.

use fgs_data::CameraFile;
use fgs_sensors::{MeasuredTimes, SensorWatch};

use super::report::Check;
use super::time_check::TimeCheck;

/// Compares with the given camera.
pub fn checks(watch: SensorWatch, given: &CameraFile) -> [Check; 3] {
    let measured = MeasuredTimes::of(watch, given);
    let times = given.sensor_times();
    let delay = TimeCheck {
        name: "depth delay",
        what: "depth is later than colour by",
        key: "depth_delay_secs",
        harm: "shifts colours",
    };
    let of_color = TimeCheck {
        name: "color readout",
        what: "the colour camera reads its rows in",
        key: "color_readout_secs",
        harm: "shifts the first and last rows",
    };
    let of_depth = TimeCheck {
        name: "depth readout",
        what: "the depth camera reads its rows in",
        key: "depth_readout_secs",
        ..of_color
    };
    [
        delay.judge(measured.depth_delay, times.depth_delay_secs),
        of_color.judge(measured.color_readout, times.color_readout_secs),
        of_depth.judge(measured.depth_readout, times.depth_readout_secs),
    ]
}
