//! Whether each frame can be registered to the one before, as tracking needs.

use fgs_geom::FrameIndex;

use super::report::Check;

const NAME: &str = "neighbouring frames";

/// With a larger share of lost frames, tracking will fail.
const MAX_LOST_SHARE: f64 = 0.05;

/// Judges the frames that could not be registered to the one before, out of `frames` tried.
pub fn check(lost: &[FrameIndex], frames: usize) -> Check {
    let Some(first) = lost.first() else {
        return match frames {
            0 | 1 => Check::unknown(NAME, "no two consecutive frames could be read".into()),
            _ => Check::ok(
                NAME,
                "each frame can be registered to the one before".into(),
            ),
        };
    };
    let seen = format!(
        "{} of {frames} frames cannot be registered to the one before, first frame {}",
        lost.len(),
        first.0
    );
    let advice = "move more slowly and keep some furniture in view, not just a bare wall; if most \
                  frames are affected, depth or camera are wrong";
    if lost.len() as f64 > MAX_LOST_SHARE * frames as f64 {
        Check::problem(NAME, seen, advice.into())
    } else {
        Check::warn(NAME, seen, advice.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::report::Verdict;

    #[test]
    fn a_few_lost_frames_are_a_warning() {
        let lost = |n: usize| (0..n).map(FrameIndex).collect::<Vec<_>>();
        assert_eq!(check(&lost(0), 100).verdict, Verdict::Ok);
        assert_eq!(check(&lost(0), 1).verdict, Verdict::Unknown);
        assert_eq!(check(&lost(2), 100).verdict, Verdict::Warn);
        assert_eq!(check(&lost(9), 100).verdict, Verdict::Problem);
    }
}
