//! Whether the ground-truth poses are on the frames' clock: compares the motions between frames found by
//! registration with those of the poses at shifted times.

use fgs_data::Trajectory;
use fgs_geom::Se3;

use super::motion_fit::{Motion, MotionFit, fit};
use super::report::Check;

const NAME: &str = "pose times";

/// Shifts searched, seconds: up to half a second, in steps of a third of a frame's time.
const STEP_SECS: f64 = 0.01;
const STEPS: i32 = 50;

/// Poses further apart do not say where the camera was between them.
const MAX_GAP_SECS: f64 = 0.2;

/// A smaller shift is within what motions show.
const MIN_SHIFT_SECS: f64 = 0.05;

/// The shift has to leave this share of what is unexplained without it ...
const MAX_SHARE: f64 = 0.6;

/// ... if that is worth explaining: errors of measured poses leave as much.
const MIN_MISFIT: f64 = 0.05;

/// A motion and the times of the frames that it is between.
pub struct TimedMotion {
    /// The motion.
    pub motion: Motion,
    /// Seconds, of the first and the second frame.
    pub times_secs: [f64; 2],
}

/// The verdict, and how the motions fit at the shift that is right.
pub fn check(timed: Vec<TimedMotion>, truth: &Trajectory) -> (Check, Option<MotionFit>) {
    let furthest = STEP_SECS * f64::from(STEPS);
    let pose = |secs: f64| truth.interpolate(secs, MAX_GAP_SECS);
    // The same motions at every shift, or those at one could not be compared with those at another.
    let known = timed.into_iter().filter(|timed| {
        let [first, second] = timed.times_secs;
        pose(first - furthest).is_some() && pose(second + furthest).is_some()
    });
    let (motions, times): (Vec<Motion>, Vec<[f64; 2]>) =
        known.map(|timed| (timed.motion, timed.times_secs)).unzip();
    let fit_at = |shift_secs: f64| {
        let given: Option<Vec<Se3>> = times
            .iter()
            .map(|[first, second]| {
                let first = pose(first + shift_secs)?;
                Some(first.inverse() * pose(second + shift_secs)?)
            })
            .collect();
        fit(&motions, &given?)
    };
    let fits = (-STEPS..=STEPS).filter_map(|step| {
        let shift_secs = STEP_SECS * f64::from(step);
        Some((shift_secs, fit_at(shift_secs)?))
    });
    let best = fits.min_by(|a, b| a.1.misfit.total_cmp(&b.1.misfit));
    let (Some((shift_secs, best)), Some(still)) = (best, fit_at(0.0)) else {
        return (
            Check::unknown(NAME, "the recording is too short to tell".into()),
            None,
        );
    };
    let is_off = shift_secs.abs() >= MIN_SHIFT_SECS
        && still.misfit >= MIN_MISFIT
        && best.misfit <= MAX_SHARE * still.misfit;
    if !is_off {
        return (
            Check::ok(NAME, "poses and frames move at the same time".into()),
            None,
        );
    }
    let way = if shift_secs > 0.0 { "late" } else { "early" };
    let seen = format!(
        "the poses are {:.2} s {way}: they leave {:.0} % of the motion unexplained, {:.0} % if moved",
        shift_secs.abs(),
        100.0 * still.misfit,
        100.0 * best.misfit
    );
    let advice = format!(
        "{} {:.2} s {} every time stamp in the file of poses",
        if shift_secs > 0.0 { "take" } else { "add" },
        shift_secs.abs(),
        if shift_secs > 0.0 { "from" } else { "to" },
    );
    (Check::problem(NAME, seen, advice), Some(best))
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::doctor::report::Verdict;
    use crate::doctor::test_room::world_from_camera_at;

    /// Exact motions over so many seconds, and poses that are late.
    fn check_late(late_secs: f64, seconds: usize) -> Check {
        let motion = |i: usize| {
            let times_secs = [i, i + 12].map(|i| i as f64 / 30.0);
            let [first, second] = times_secs.map(world_from_camera_at);
            TimedMotion {
                motion: Motion {
                    first_from_second: first.inverse() * second,
                    points: vec![Vector3::new(0.8, 0.5, 2.0), 2.0 * Vector3::z()],
                },
                times_secs,
            }
        };
        let timed = (0..30 * seconds - 12).step_by(12).map(motion).collect();
        let times = (0..30 * seconds).map(|i| i as f64 / 30.0);
        let poses = times.map(|secs| (secs, world_from_camera_at(secs - late_secs)));
        check(timed, &Trajectory::new(poses).unwrap()).0
    }

    #[test]
    fn late_and_early_poses_are_found() {
        assert_eq!(check_late(0.0, 5).verdict, Verdict::Ok);
        assert_eq!(check_late(0.02, 5).verdict, Verdict::Ok);
        let late = check_late(0.2, 5);
        assert_eq!(late.verdict, Verdict::Problem);
        assert!(
            late.seen.starts_with("the poses are 0.20 s late"),
            "{}",
            late.seen
        );
        assert!(late.advice.unwrap().starts_with("take 0.20 s from"));
        let early = check_late(-0.3, 5);
        assert!(
            early.seen.starts_with("the poses are 0.30 s early"),
            "{}",
            early.seen
        );
        assert_eq!(check_late(0.2, 1).verdict, Verdict::Unknown);
    }
}
