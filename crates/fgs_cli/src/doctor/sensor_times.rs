//! Whether the camera file says when the rows of both images are measured: compares the delay of the
//! depth sensor and the readouts of both sensors with those that explain best how the sensors move and
//! what they see.

use fgs_data::CameraFile;
use fgs_direct::{color_readout, depth_delay, depth_readout};

use super::report::Check;
use super::sensor_motions::SensorWatch;
use super::statistics::median;
use super::time_check::TimeCheck;

/// Compares with the given camera.
pub fn checks(watch: SensorWatch, given: &CameraFile) -> [Check; 3] {
    let speed_px = median(watch.speeds_px);
    let sensor = given.depth_sensor();
    let delay = TimeCheck {
        name: "depth delay",
        what: "depth is later than colour by",
        key: "depth_delay_secs",
        harm: "shifts colours",
        share: 1.0,
    };
    let of_color = TimeCheck {
        name: "color readout",
        what: "the colour camera reads its rows in",
        key: "color_readout_secs",
        harm: "shifts the first and last rows",
        share: 0.5,
    };
    let of_depth = TimeCheck {
        name: "depth readout",
        what: "the depth camera reads its rows in",
        key: "depth_readout_secs",
        ..of_color
    };
    let (color_secs, depth_secs) = (given.color_readout_secs(), sensor.readout_secs);
    [
        delay.judge(
            depth_delay(&watch.motions, sensor),
            speed_px,
            sensor.delay_secs,
        ),
        of_color.judge(
            color_readout(watch.color_pairs, color_secs),
            speed_px,
            color_secs,
        ),
        of_depth.judge(
            depth_readout(watch.depth_pairs, depth_secs),
            speed_px,
            depth_secs,
        ),
    ]
}
