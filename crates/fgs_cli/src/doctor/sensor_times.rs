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
pub fn checks(mut watch: SensorWatch, given: &CameraFile) -> [Check; 3] {
    let speed_px = median(watch.speeds_px.clone());
    let sensor = given.depth_sensor();
    let (color_secs, depth_secs) = (given.color_readout_secs(), sensor.readout_secs);
    let mut motions = watch.motions();
    let color_found = color_readout(&mut watch.color_pairs, color_secs);
    let depth_found = depth_readout(&mut watch.depth_pairs, depth_secs);
    if color_found.is_some() && depth_found.is_some() {
        // Those between the middle rows: without the distortion by the shutters, which differs between
        // the sensors.
        motions = watch.motions();
    }
    let delay_found = depth_delay(&motions, sensor);
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
    [
        delay.judge(delay_found, speed_px, sensor.delay_secs),
        of_color.judge(color_found, speed_px, color_secs),
        of_depth.judge(depth_found, speed_px, depth_secs),
    ]
}
