//! Whether depth is in metres: by comparison with the lengths of the ground truth's translations, or
//! without ground truth by what is plausible for rooms and sensors.

use super::motion_fit::MotionFit;
use super::report::Check;

const NAME: &str = "depth scale";

/// Common scales: millimetres (most sensors), TUM RGB-D, Replica, tenths of a millimetre.
const USUAL_SCALES: [f64; 4] = [1000.0, 5000.0, 6553.5, 10000.0];

/// Poses and depth of real recordings disagree by up to 4 %.
const MAX_ERROR: f64 = 0.08;

/// In standard errors, which are themselves estimated from only a few pairs.
const MIN_SIGNIFICANCE: f64 = 5.0;

/// A scale this close to a common one is taken to be that one.
const SNAP: f64 = 0.06;

/// Plausible median depths of a hand-held recording, metres: from a desk to a hall. A room read as
/// five times smaller (a scale of 5000 where it should be 1000) comes out at 0.4 to 0.65 m.
const USUAL_MEDIAN_M: [f64; 2] = [0.7, 6.0];

/// Wrong focal lengths change the lengths of motions too, but not by more than this factor.
const MAX_FACTOR_OF_FOCAL_LENGTHS: f64 = 2.0;

/// `fit` says how the registered motions fit the ground truth; `is_camera_known`, that focal lengths were
/// found to be right: otherwise they may be to blame.
pub fn check(
    depth_scale: f64,
    median_depth_m: Option<f64>,
    fit: Option<&MotionFit>,
    is_camera_known: bool,
) -> Check {
    let Some(median) = median_depth_m else {
        return Check::unknown(NAME, "there is no depth".into());
    };
    if let Some(fit) = fit
        && fit.scale > 0.0
        && fit.scale_error <= 0.3 * MAX_ERROR * fit.scale
    {
        let off = fit.scale.ln().abs();
        if off > (1.0 + MAX_ERROR).ln() && off >= MIN_SIGNIFICANCE * fit.scale_error / fit.scale {
            let right = snapped(depth_scale * fit.scale);
            let seen = format!("depth is {:.2} times what the poses imply", fit.scale);
            if !is_camera_known && off < MAX_FACTOR_OF_FOCAL_LENGTHS.ln() {
                let advice = "depth_scale or the focal lengths are wrong, and this recording does not \
                              show which: record one that turns more";
                return Check::problem(NAME, seen, advice.into());
            }
            let advice = format!("set depth_scale = {right} (it is {depth_scale})");
            return Check::problem(NAME, seen, advice);
        }
        let seen = format!("depth and poses agree in scale to {:.1} %", 100.0 * off);
        return Check::ok(NAME, seen);
    }
    let [low, high] = USUAL_MEDIAN_M;
    let seen = format!("the median depth is {median:.2} m");
    if (low..=high).contains(&median) {
        return Check::ok(NAME, seen);
    }
    let raw = median * depth_scale;
    let fitting: Vec<String> = USUAL_SCALES
        .iter()
        .filter(|scale| (low..=high).contains(&(raw / **scale)))
        .map(|scale| format!("{scale} ({:.2} m)", raw / scale))
        .collect();
    let advice = if fitting.is_empty() {
        "check depth_scale, the value in a depth image that stands for 1 m".to_owned()
    } else {
        let usual = fitting.join(", ");
        format!(
            "if that is implausible, depth_scale = {depth_scale} is wrong; common values: {usual}"
        )
    };
    Check::warn(NAME, seen, advice)
}

/// The common scale nearby, else the scale to three digits.
fn snapped(scale: f64) -> f64 {
    let usual = USUAL_SCALES
        .into_iter()
        .find(|usual| (scale / usual).ln().abs() <= SNAP);
    usual.unwrap_or_else(|| {
        let digit = 10f64.powf(scale.log10().floor() - 2.0);
        (scale / digit).round() * digit
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::report::Verdict;

    fn with_poses(scale: f64, scale_error: f64) -> Check {
        let fit = MotionFit {
            misfit: 0.1,
            scale,
            scale_error,
        };
        check(5000.0, Some(2.0), Some(&fit), true)
    }

    #[test]
    fn poses_give_the_scale() {
        assert_eq!(with_poses(1.03, 0.001).verdict, Verdict::Ok);
        assert_eq!(with_poses(0.97, 0.001).verdict, Verdict::Ok);
        let odd = with_poses(1.15, 0.01);
        assert_eq!(odd.verdict, Verdict::Problem);
        assert_eq!(odd.advice.unwrap(), "set depth_scale = 5750 (it is 5000)");
        let millimetres = with_poses(0.196, 0.001);
        assert_eq!(
            millimetres.advice.unwrap(),
            "set depth_scale = 1000 (it is 5000)"
        );
        // Too uncertain to say: falls back on the median depth.
        assert_eq!(with_poses(1.25, 0.1).seen, "the median depth is 2.00 m");
    }

    /// Ten per cent of focal length look like 19 % of depth.
    #[test]
    fn focal_lengths_may_be_to_blame() {
        let unsure = |scale| {
            let fit = MotionFit {
                misfit: 0.1,
                scale,
                scale_error: 0.001,
            };
            let check = check(5000.0, Some(2.0), Some(&fit), false);
            assert_eq!(check.verdict, Verdict::Problem);
            check.advice.unwrap()
        };
        assert!(unsure(1.19).contains("depth_scale or the focal lengths"));
        assert_eq!(unsure(0.2), "set depth_scale = 1000 (it is 5000)");
    }

    #[test]
    fn without_poses_the_median_depth_must_be_usual() {
        assert_eq!(check(5000.0, Some(2.0), None, true).verdict, Verdict::Ok);
        let far = check(1000.0, Some(10.0), None, true);
        assert_eq!(far.verdict, Verdict::Warn);
        assert!(far.advice.unwrap().contains("5000 (2.00 m)"));
        let near = check(5000.0, Some(0.4), None, true);
        assert!(near.advice.unwrap().contains("1000 (2.00 m)"));
        assert_eq!(check(5000.0, None, None, true).verdict, Verdict::Unknown);
        assert_eq!(check(5000.0, Some(1e4), None, true).verdict, Verdict::Warn);
    }
}
