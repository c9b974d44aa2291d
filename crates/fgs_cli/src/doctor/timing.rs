//! Frame rate and gaps in the time stamps.

use fgs_sensors::{is_gap, usual_interval};

use super::report::Check;

const NAME: &str = "frame rate";

/// At lower rates a hand-held camera moves too far between frames.
const MIN_RATE_HZ: f64 = 10.0;

/// Checks strictly increasing times; `are_made_up` if the recording has no time stamps of its own.
pub fn check(times_secs: &[f64], are_made_up: bool) -> Check {
    let Some(usual) = usual_interval(times_secs) else {
        return Check::unknown(NAME, "there is a single frame".into());
    };
    let rate = 1.0 / usual;
    if are_made_up {
        return Check::unknown(
            NAME,
            format!("there are no time stamps; {rate:.0} Hz is assumed"),
        );
    }
    let gaps: Vec<(usize, f64)> = times_secs
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .enumerate()
        .filter(|(_, interval)| is_gap(*interval, usual))
        .collect();
    if let Some((before, longest)) = gaps.iter().max_by(|a, b| a.1.total_cmp(&b.1)) {
        return Check::warn(
            NAME,
            format!(
                "{rate:.1} Hz, gaps: {}; the longest is {longest:.2} s after frame {before}",
                gaps.len()
            ),
            "tracking may be lost there: record to a faster disk, or use the frames on one side \
             (--frames)"
                .into(),
        );
    }
    if rate < MIN_RATE_HZ {
        let advice = "move slowly: neighbouring frames must overlap widely";
        return Check::warn(NAME, format!("{rate:.1} Hz"), advice.into());
    }
    Check::ok(NAME, format!("{rate:.1} Hz without gaps"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::report::Verdict;

    #[test]
    fn rate_and_gaps() {
        let mut times: Vec<f64> = (0..20).map(|i| 7.0 + f64::from(i) / 25.0).collect();
        assert_eq!(
            check(&times, false),
            Check::ok(NAME, "25.0 Hz without gaps".into())
        );
        times.remove(9);
        assert_eq!(
            check(&times, false).verdict,
            Verdict::Ok,
            "one frame lost is no gap"
        );
        times.remove(9);
        let gap = check(&times, false);
        assert_eq!(gap.verdict, Verdict::Warn);
        assert_eq!(
            gap.seen,
            "25.0 Hz, gaps: 1; the longest is 0.12 s after frame 8"
        );
        assert_eq!(check(&[0.0, 0.5, 1.0], false).verdict, Verdict::Warn);
        assert_eq!(check(&[0.0], false).verdict, Verdict::Unknown);
        assert_eq!(check(&[0.0, 0.1], true).verdict, Verdict::Unknown);
    }
}
