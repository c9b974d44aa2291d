//! How a time in the camera file is compared with the one that the recording shows.

use fgs_direct::TimeEstimate;
use fgs_sensors::MeasuredTime;

use super::report::Check;

/// A time of the camera file.
pub struct TimeCheck {
    /// Of the check.
    pub name: &'static str,
    /// What the time is of, such that "12 ms" can follow.
    pub what: &'static str,
    /// In the camera file.
    pub key: &'static str,
    /// What a wrong time does.
    pub harm: &'static str,
}

impl TimeCheck {
    /// Compares with what the camera file says, if it does.
    pub fn judge(&self, measured: Option<MeasuredTime>, given_secs: Option<f64>) -> Check {
        let Some(measured) = measured else {
            return Check::unknown(self.name, "too little motion to tell".into());
        };
        let TimeEstimate {
            secs,
            standard_error_secs: error_secs,
            thirds_secs,
        } = measured.estimate;
        let thirds = thirds_secs.map_or(String::new(), |thirds| {
            let [a, b, c] = thirds.map(|secs| 1e3 * secs);
            format!(" (thirds of the recording: {a:.1}, {b:.1}, {c:.1})")
        });
        let shown = format!(
            "{} {:.1} +- {:.1} ms{thirds}",
            self.what,
            1e3 * secs,
            1e3 * error_secs
        );
        let taken_secs = given_secs.unwrap_or_else(|| measured.or_zero());
        if measured.refutes(taken_secs) {
            let taken = match given_secs {
                Some(given_secs) => format!("the camera file says {:.1} ms", 1e3 * given_secs),
                None => "the recording is too short to go by it".into(),
            };
            let seen = format!(
                "{shown}; {taken}, which {} by {:.1} px at the usual {:.0} px/s",
                self.harm,
                measured.shift_px(taken_secs),
                measured.speed_px
            );
            let advice = format!("set {} = {secs:.4} in the camera file", self.key);
            Check::warn(self.name, seen, advice)
        } else if !measured.is_shown() {
            let speed_px = measured.speed_px;
            let seen = format!("the motion does not show it ({shown}, {speed_px:.0} px/s)");
            Check::unknown(self.name, seen)
        } else if given_secs.is_none() && measured.refutes(0.0) {
            Check::ok(self.name, format!("{shown}; a run goes by it"))
        } else {
            Check::ok(self.name, shown)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::report::Verdict;

    #[test]
    fn only_visible_and_certain_errors_are_reported() {
        let check = TimeCheck {
            name: "depth delay",
            what: "depth is later by",
            key: "depth_delay_secs",
            harm: "shifts colours",
        };
        let thirds = Some([-0.011, -0.012, -0.013]);
        let measured = |secs, standard_error_secs, speed_px, thirds_secs| {
            let estimate = TimeEstimate {
                secs,
                standard_error_secs,
                thirds_secs,
            };
            Some(MeasuredTime {
                estimate,
                speed_px,
                share: 1.0,
            })
        };
        let late = measured(-0.0124, 0.001, 300.0, thirds);
        let refuted = check.judge(late.clone(), Some(0.002));
        assert_eq!(refuted.verdict, Verdict::Warn);
        assert_eq!(
            refuted.seen,
            "depth is later by -12.4 +- 1.0 ms (thirds of the recording: -11.0, -12.0, -13.0); the \
             camera file says 2.0 ms, which shifts colours by 4.3 px at the usual 300 px/s"
        );
        let advice = refuted.advice.unwrap();
        assert_eq!(advice, "set depth_delay_secs = -0.0124 in the camera file");
        // Where the file says nothing, runs measure it too, unless the recording is short.
        let measured_by_runs = check.judge(late, None);
        assert_eq!(measured_by_runs.verdict, Verdict::Ok);
        assert!(measured_by_runs.seen.ends_with("; a run goes by it"));
        let short = check.judge(measured(-0.0124, 0.001, 300.0, None), None);
        assert_eq!(short.verdict, Verdict::Warn);
        // Not visible, not certain, hardly any motion.
        for (measured, expected) in [
            (measured(0.003, 0.0001, 300.0, thirds), Verdict::Ok),
            (measured(-0.0124, 0.005, 300.0, thirds), Verdict::Unknown),
            (measured(-0.5, 0.001, 10.0, thirds), Verdict::Unknown),
            (None, Verdict::Unknown),
        ] {
            assert_eq!(check.judge(measured, Some(0.002)).verdict, expected);
        }
    }
}
