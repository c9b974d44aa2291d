//! Whether the camera file says when the depth image is measured: compares its delay with the one
//! that explains the motions of depth sensor and colour camera best ([`fgs_direct::depth_delay`]).

use fgs_direct::{DepthDelay, depth_delay};
use fgs_geom::DepthSensor;

use super::report::Check;
use super::sensor_motions::SensorWatch;
use super::statistics::median;

const NAME: &str = "depth delay";

/// A smaller shift of the colours on the surfaces is not worth a setting, pixels of the recording.
const MIN_SHIFT_PX: f64 = 0.5;

/// In standard errors.
const MIN_SIGNIFICANCE: f64 = 4.0;

/// If a standard error shifts the colours by more, pixels, the recording does not show the delay.
const MAX_ERROR_PX: f64 = 1.0;

/// Where the image moves by less in a second, what looks like motion may be its measurement's error.
const MIN_SPEED_PX: f64 = 20.0;

/// Compares with the given sensor.
pub fn check(watch: &SensorWatch, given: &DepthSensor) -> Check {
    let found = depth_delay(&watch.motions, given);
    let speed_px = median(watch.speeds_px.clone());
    match found.zip(speed_px) {
        Some((found, speed_px)) => judge(&found, speed_px, given.delay_secs),
        None => Check::unknown(NAME, "too little motion to tell".into()),
    }
}

fn judge(found: &DepthDelay, speed_px: f64, given_secs: f64) -> Check {
    let (delay_secs, error_secs) = (found.delay_secs, found.standard_error_secs);
    let change_secs = (delay_secs - given_secs).abs();
    let is_wrong = change_secs * speed_px >= MIN_SHIFT_PX
        && change_secs >= MIN_SIGNIFICANCE * error_secs
        && speed_px >= MIN_SPEED_PX;
    let thirds = found.thirds_secs.map_or(String::new(), |thirds| {
        let [a, b, c] = thirds.map(|delay| 1e3 * delay);
        format!(" (thirds of the recording: {a:.1}, {b:.1}, {c:.1})")
    });
    let measured = format!(
        "depth is taken {:.1} +- {:.1} ms after colour{thirds}",
        1e3 * delay_secs,
        1e3 * error_secs
    );
    if is_wrong {
        let seen = format!(
            "{measured}; the camera file says {:.1} ms, which shifts colours by {:.1} px at the usual \
             {speed_px:.0} px/s",
            1e3 * given_secs,
            change_secs * speed_px
        );
        let advice = format!("set depth_delay_secs = {delay_secs:.4} in the camera file");
        Check::warn(NAME, seen, advice)
    } else if error_secs * speed_px > MAX_ERROR_PX || speed_px < MIN_SPEED_PX {
        let seen = format!("the motion does not show it ({measured}, {speed_px:.0} px/s)");
        Check::unknown(NAME, seen)
    } else {
        Check::ok(NAME, measured)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::report::Verdict;

    #[test]
    fn only_visible_and_certain_delays_are_reported() {
        let judge = |delay_secs, standard_error_secs, speed_px| {
            let found = DepthDelay {
                delay_secs,
                standard_error_secs,
                thirds_secs: Some([-0.011, -0.012, -0.013]),
            };
            judge(&found, speed_px, 0.002)
        };
        let late = judge(-0.0124, 0.001, 300.0);
        assert_eq!(late.verdict, Verdict::Warn);
        assert!(late.seen.contains("by 4.3 px"), "{}", late.seen);
        let advice = late.advice.unwrap();
        assert_eq!(advice, "set depth_delay_secs = -0.0124 in the camera file");
        // Not visible, not certain, hardly any motion.
        assert_eq!(judge(0.003, 0.0001, 300.0).verdict, Verdict::Ok);
        assert_eq!(judge(-0.0124, 0.005, 300.0).verdict, Verdict::Unknown);
        assert_eq!(judge(-0.5, 0.001, 10.0).verdict, Verdict::Unknown);
    }
}
