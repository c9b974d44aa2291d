//! Whether focal lengths and principal point are right: compares the given camera with the one that
//! fits the recording best ([`super::self_calibration`]).
//!
//! A problem is reported only if the change is large, far larger than its standard error, and makes
//! both depth and colours of different frames agree better. Real depth sensors distort space
//! slightly, which looks like wrong intrinsics in depth, but not in colour.

use fgs_geom::Camera;

use super::color_misfit::color_misfit;
use super::frame_pairs::FramePair;
use super::report::Check;
use super::self_calibration::{Calibration, calibrate};

const NAME: &str = "intrinsics";

/// Smaller changes cannot be told from the distortion of a structured-light sensor (up to 5 % of the
/// focal length and 4 % of the width have been observed).
const MIN_CHANGE: [f64; 4] = [0.08, 0.08, 0.06, 0.06];

/// In standard errors, which are themselves estimated from only a few pairs.
const MIN_SIGNIFICANCE: f64 = 5.0;

/// A focal length whose logarithm has a larger standard error counts as unobservable.
const MAX_STANDARD_ERROR: f64 = 0.03;

/// The product of depth and colour misfit has to fall to this share. On good recordings it changes by
/// a few per cent only; correcting a focal length that is off by a quarter halves it.
const MAX_MISFIT_SHARE: f64 = 0.88;

/// Compares the given camera with the best fitting one, and returns the latter's calibration if they
/// differ. Depth that is not registered to colour follows the depth camera's intrinsics; a difference
/// then does not mean that the camera file is wrong.
pub fn check(
    pairs: &[FramePair],
    given: &Camera,
    is_registered: bool,
) -> (Check, Option<Calibration>) {
    let Some(calibration) = calibrate(pairs, given) else {
        let seen = "too few frames with surfaces in common".to_owned();
        return (Check::unknown(NAME, seen), None);
    };
    let misfit_share = misfit_share(pairs, given, &calibration);
    let is_changed = (0..4).any(|i| {
        let change = calibration.change[i].abs();
        change >= MIN_CHANGE[i] && change >= MIN_SIGNIFICANCE * calibration.standard_error[i]
    });
    if is_changed && misfit_share.is_some_and(|share| share <= MAX_MISFIT_SHARE) {
        if !is_registered {
            let seen = "cannot be told before depth is registered to colour".to_owned();
            return (Check::unknown(NAME, seen), Some(calibration));
        }
        let k = calibration.camera.intrinsics;
        let seen = format!(
            "frames seen from different directions do not fit; they fit best with about \
             fx {:.0} fy {:.0} cx {:.0} cy {:.0}",
            k.fx, k.fy, k.cx, k.cy
        );
        let advice = "correct fx, fy, cx, cy in the camera file: they belong to the colour \
                      camera at this image size (half the size: half the values)";
        return (Check::problem(NAME, seen, advice.into()), Some(calibration));
    }
    let focal_error = calibration.standard_error[0].max(calibration.standard_error[1]);
    let check = if focal_error > MAX_STANDARD_ERROR {
        Check::unknown(NAME, "the camera turns too little to tell".into())
    } else {
        Check::ok(NAME, "views from different directions agree".into())
    };
    (check, None)
}

/// Product of depth and colour misfit with the best fitting camera, relative to that with the given.
fn misfit_share(pairs: &[FramePair], given: &Camera, fitting: &Calibration) -> Option<f64> {
    let motions: Vec<_> = pairs.iter().map(|pair| pair.first_from_second).collect();
    let color_before = color_misfit(pairs, &motions, given, given)?;
    let color_after = color_misfit(pairs, &fitting.first_from_second, given, &fitting.camera)?;
    let [depth_before, depth_after] = fitting.residual;
    // One step of 255: a scene without any texture has no colour misfit at all.
    let color = (color_after + 1.0) / (color_before + 1.0);
    Some(color * depth_after.max(1e-5) / depth_before.max(1e-5))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::frame_pairs::PairBuilder;
    use crate::doctor::report::Verdict;
    use crate::doctor::test_room;

    fn check_with(fx_factor: f64, frames: impl Iterator<Item = usize>) -> Check {
        let mut camera = test_room::camera();
        camera.intrinsics.fx *= fx_factor;
        camera.intrinsics.fy *= fx_factor;
        let mut builder = PairBuilder::new(camera);
        frames.for_each(|i| builder.add(&test_room::frame(i)));
        builder.interrupt();
        check(&builder.pairs, &camera, true).0
    }

    #[test]
    fn only_wrong_intrinsics_are_a_problem() {
        assert_eq!(check_with(1.0, 0..60).verdict, Verdict::Ok);
        for factor in [0.8, 1.25] {
            let problem = check_with(factor, 0..60);
            assert_eq!(problem.verdict, Verdict::Problem);
            assert!(
                problem.seen.contains("fx 180 fy 184 cx 101 cy 85"),
                "{}",
                problem.seen
            );
        }
    }

    #[test]
    fn a_camera_that_stands_still_tells_nothing() {
        assert_eq!(
            check_with(1.25, [0; 60].into_iter()).verdict,
            Verdict::Unknown
        );
        assert_eq!(check_with(1.0, 0..1).verdict, Verdict::Unknown);
    }
}
