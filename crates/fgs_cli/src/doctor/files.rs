//! Whether the images can be read.

use fgs_geom::FrameIndex;

use super::report::Check;

const NAME: &str = "files";

/// A run skips damaged frames; if more than this share is damaged, something is wrong with the whole
/// recording.
const MAX_SHARE: f64 = 0.1;

/// Judges the frames that could not be read, each with the reason, out of `frames` tried.
pub fn check(unreadable: &[(FrameIndex, String)], frames: usize) -> Check {
    let Some((index, reason)) = unreadable.first() else {
        return Check::ok(NAME, format!("all {frames} frames examined can be read"));
    };
    let seen = format!(
        "{} of {frames} frames cannot be read; frame {}: {reason}",
        unreadable.len(),
        index.0
    );
    if unreadable.len() as f64 > MAX_SHARE * frames as f64 {
        Check::problem(
            NAME,
            seen,
            "correct the images, or the camera file, as the message says".into(),
        )
    } else {
        Check::warn(
            NAME,
            seen,
            "a run leaves such frames out; copy the files again".into(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::report::Verdict;

    #[test]
    fn damage_is_counted() {
        let damaged = |n: usize| vec![(FrameIndex(7), "x.png: broken".to_owned()); n];
        assert_eq!(check(&damaged(0), 50).verdict, Verdict::Ok);
        let one = check(&damaged(1), 50);
        assert_eq!(one.verdict, Verdict::Warn);
        assert_eq!(
            one.seen,
            "1 of 50 frames cannot be read; frame 7: x.png: broken"
        );
        assert_eq!(check(&damaged(50), 50).verdict, Verdict::Problem);
    }
}
