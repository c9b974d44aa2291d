//! Whether the camera file says where and when the depth image is measured: compares it with what
//! explains the motions of depth sensor and colour camera best (`fgs_direct::calibrate`).

use fgs_direct::{SensorCalibration, calibrate};
use fgs_geom::{Camera, DepthSensor};

use super::report::Check;
use super::sensor_motions::SensorWatch;
use super::statistics::median;

const NAME: &str = "depth sensor";

/// Smaller shifts of the colours on the surfaces are not worth a setting, pixels of the recording.
const MIN_SHIFT_PX: f64 = 0.5;

/// In standard errors.
const MIN_SIGNIFICANCE: f64 = 4.0;

/// A delay that may shift colours by more, one standard error, is not known to be right.
const MAX_ERROR_PX: f64 = 0.5;

/// Where the image moves by less in a second, what looks like motion may be the error of its
/// measurement.
const MIN_SPEED_PX: f64 = 20.0;

/// Judges the given sensor by the motions seen.
pub fn check(watch: &SensorWatch, given: &DepthSensor, camera: &Camera) -> Check {
    let Some(calibration) = calibrate(&watch.motions, given) else {
        let seen = "too few motions to tell when depth was measured";
        return Check::unknown(NAME, seen.into());
    };
    let speed_px = median(watch.speeds_px.clone()).unwrap_or(0.0);
    judge(&calibration, speed_px, given, camera)
}

fn judge(
    found: &SensorCalibration,
    speed_px: f64,
    given: &DepthSensor,
    camera: &Camera,
) -> Check {
    let error_secs = found.delay_error_secs;
    let delay_secs = found.sensor.delay_secs;
    let change_secs = delay_secs - given.delay_secs;
    let is_late = is_wrong(change_secs, error_secs, speed_px);
    let turn = given.color_from_depth.rotation.inverse() * found.sensor.color_from_depth.rotation;
    let focal_px = camera.intrinsics.fx;
    let is_turned = found.rotation_error.is_some_and(|error| {
        let parts = turn.scaled_axis();
        parts.iter().zip(&error).any(|(part, error)| is_wrong(*part, *error, focal_px))
    });
    let is_vague = error_secs * speed_px > MAX_ERROR_PX && !is_late;
    if speed_px < MIN_SPEED_PX || is_vague {
        let seen = format!(
            "the camera moves too little or too evenly to tell when depth was measured \
             ({speed_px:.0} px/s)"
        );
        return Check::unknown(NAME, seen);
    }
    let mut seen = format!(
        "depth is taken {:.1} +- {:.1} ms after colour",
        1e3 * delay_secs,
        1e3 * error_secs
    );
    if let Some(thirds) = found.delays_of_thirds_secs {
        let [a, b, c] = thirds.map(|delay| 1e3 * delay);
        seen += &format!(" (thirds of the recording: {a:.1}, {b:.1}, {c:.1})");
    }
    seen += &format!(
        ", {:.1} px off the camera file's {:.1} ms at {speed_px:.0} px/s",
        (change_secs * speed_px).abs(),
        1e3 * given.delay_secs
    );
    if is_turned {
        seen += &format!(", and turned by {:.1} px", turn.angle() * focal_px);
    }
    if !is_late && !is_turned {
        return Check::ok(NAME, seen);
    }
    let mut lines = Vec::new();
    if is_late {
        lines.push(format!("depth_delay_secs = {delay_secs:.4}"));
    }
    if is_turned {
        let pose = found.sensor.color_from_depth;
        let (t, q) = (pose.translation, pose.rotation.quaternion());
        let numbers = [t.x, t.y, t.z, q.i, q.j, q.k, q.w].map(|value| format!("{value:.6}"));
        lines.push(format!("color_from_depth = [{}]", numbers.join(", ")));
    }
    Check::warn(NAME, seen, format!("set {} in the camera file", lines.join(" and ")))
}

/// Whether a change shifts colours visibly, and is far beyond its standard error.
fn is_wrong(change: f64, error: f64, px: f64) -> bool {
    change.abs() * px >= MIN_SHIFT_PX && change.abs() >= MIN_SIGNIFICANCE * error
}
