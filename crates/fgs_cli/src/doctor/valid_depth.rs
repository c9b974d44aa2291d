//! How many pixels have valid depth.

use fgs_geom::FrameIndex;

use super::report::Check;

const NAME: &str = "valid depth";

/// With less, a frame is more holes than surface and may not be trackable.
const MIN_SHARE: f64 = 0.2;

/// Structured light indoors gives 70 to 90 %.
const USUAL_SHARE: f64 = 0.5;

/// Checks the share of pixels with valid depth in each frame that was read.
pub fn check(shares: &[(FrameIndex, f64)]) -> Check {
    let Some(worst) = shares.iter().min_by(|a, b| a.1.total_cmp(&b.1)) else {
        return Check::unknown(NAME, "no frame could be read".into());
    };
    let mean = shares.iter().map(|(_, share)| share).sum::<f64>() / shares.len() as f64;
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let poor = shares
        .iter()
        .filter(|(_, share)| *share < MIN_SHARE)
        .count();
    let seen = format!(
        "{} of the pixels; {poor} frames under {}, the poorest {} (frame {})",
        percent(mean),
        percent(MIN_SHARE),
        percent(worst.1),
        worst.0.0
    );
    let advice = "keep 0.5 to 4 m from surfaces, and away from glass, mirrors and sunlight";
    if mean < MIN_SHARE {
        Check::problem(NAME, seen, advice.into())
    } else if poor > 0 || mean < USUAL_SHARE {
        Check::warn(NAME, seen, advice.into())
    } else {
        Check::ok(NAME, format!("{} of the pixels", percent(mean)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::report::Verdict;

    #[test]
    fn means_and_poor_frames() {
        let verdict = |shares: &[f64]| {
            let shares: Vec<_> = shares
                .iter()
                .enumerate()
                .map(|(i, s)| (FrameIndex(i), *s))
                .collect();
            check(&shares).verdict
        };
        assert_eq!(verdict(&[0.72, 0.7]), Verdict::Ok);
        assert_eq!(verdict(&[0.9, 0.9, 0.1]), Verdict::Warn);
        assert_eq!(verdict(&[0.4, 0.4]), Verdict::Warn);
        assert_eq!(verdict(&[0.1, 0.1]), Verdict::Problem);
        assert_eq!(verdict(&[]), Verdict::Unknown);
    }
}
