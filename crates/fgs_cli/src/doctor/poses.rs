//! Whether the ground-truth poses follow the expected convention: compares the motions between frames
//! found by registration with those of the poses, interpreted in every commonly mistaken way.

use fgs_geom::Se3;

use super::motion_fit::{Motion, MotionFit, fit};
use super::pose_convention::Convention;
use super::report::Check;

const NAME: &str = "poses";

/// Errors of measured poses and sensor distortion leave up to a fifth of the motion unexplained.
const MAX_MISFIT: f64 = 0.35;

/// Another convention has to explain more: among a hundred, some explain half by chance.
const MAX_MISTAKE_MISFIT: f64 = 0.15;

/// The simplest convention within this factor (plus 0.01) of the best is taken.
const EQUALLY_GOOD: f64 = 1.2;

/// Compares poses, two for each motion, with the motions. Also returns how well the motions fit, if
/// the poses' convention is known.
pub fn check(motions: &[Motion], poses: &[[Se3; 2]]) -> (Check, Option<MotionFit>) {
    let fit_as = |convention: &Convention| {
        let given: Option<Vec<Se3>> = poses
            .iter()
            .map(|[first, second]| convention.motion(first, second))
            .collect();
        fit(motions, &given?)
    };
    let Some(expected) = fit_as(&Convention::expected()) else {
        return (
            Check::unknown(NAME, "too little motion to compare poses with".into()),
            None,
        );
    };
    let percent = |fit: &MotionFit| format!("{:.0} %", 100.0 * fit.misfit);
    let unexplained = format!(
        "the poses leave {} of the motion unexplained",
        percent(&expected)
    );
    if expected.misfit <= MAX_MISFIT {
        return (Check::ok(NAME, unexplained), Some(expected));
    }
    let fits: Vec<(Convention, MotionFit)> = Convention::mistakes()
        .into_iter()
        .filter_map(|convention| Some((convention, fit_as(&convention)?)))
        .collect();
    let best = fits
        .iter()
        .map(|(_, fit)| fit.misfit)
        .fold(f64::INFINITY, f64::min);
    let simplest = fits
        .into_iter()
        .find(|(_, fit)| fit.misfit <= EQUALLY_GOOD * best + 0.01);
    match simplest {
        Some((convention, fit)) if best <= MAX_MISTAKE_MISFIT => {
            let seen = format!(
                "{unexplained}, but {} if they are {convention}",
                percent(&fit)
            );
            (Check::problem(NAME, seen, convention.advice()), Some(fit))
        }
        _ => {
            let advice = "the poses do not belong to these frames: check that their time stamps \
                          are on the frames' clock, their order is the frames', and position \
                          and rotation have the same axes";
            (Check::problem(NAME, unexplained, advice.into()), None)
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::doctor::report::Verdict;
    use crate::doctor::test_room::world_from_camera;

    fn check_with(write: impl Fn(&Se3) -> Se3) -> (Check, Option<MotionFit>) {
        let ends: Vec<[Se3; 2]> = (0..5)
            .map(|i| [10 * i, 10 * i + 12].map(world_from_camera))
            .collect();
        let motion = |[first, second]: &[Se3; 2]| Motion {
            first_from_second: first.inverse() * *second,
            points: vec![
                Vector3::new(0.8, 0.5, 2.0),
                Vector3::new(-0.9, -0.6, 2.0),
                2.0 * Vector3::z(),
            ],
        };
        let motions: Vec<Motion> = ends.iter().map(motion).collect();
        let written: Vec<[Se3; 2]> = ends
            .iter()
            .map(|ends| ends.map(|pose| write(&pose)))
            .collect();
        check(&motions, &written)
    }

    #[test]
    fn right_poses_give_the_scale() {
        let (right, fit) = check_with(|pose| Se3::new(pose.rotation, pose.translation / 5.0));
        assert_eq!(right.verdict, Verdict::Ok);
        assert!((fit.unwrap().scale - 5.0).abs() <= 1e-9);
    }

    #[test]
    fn mistakes_are_named_and_nonsense_is_not() {
        let (inverse, fit) = check_with(Se3::inverse);
        assert_eq!(inverse.verdict, Verdict::Problem);
        assert_eq!(inverse.advice.as_deref(), Some("invert every pose"));
        assert!((fit.unwrap().scale - 1.0).abs() <= 1e-9);
        let (nonsense, fit) =
            check_with(|pose| *pose * *pose * Se3::new(pose.rotation, 3.0 * Vector3::z()));
        assert_eq!(nonsense.verdict, Verdict::Problem);
        assert!(nonsense.advice.unwrap().contains("do not belong"));
        assert!(fit.is_none());
    }
}
