//! How a time in the camera file is compared with the one that the recording shows.

use fgs_direct::TimeEstimate;

use super::report::Check;

/// In standard errors.
const MIN_SIGNIFICANCE: f64 = 4.0;

/// Where the image moves by less in a second, what looks like motion may be its measurement's error.
const MIN_SPEED_PX: f64 = 20.0;

/// A smaller shift in the image is not worth a setting, pixels of the recording.
const MIN_SHIFT_PX: f64 = 0.5;

/// If a standard error shifts the image by more, pixels, the recording does not show the time.
const MAX_ERROR_PX: f64 = 1.0;

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
    /// By how much of the motion during that time the image is off at most.
    pub share: f64,
}

impl TimeCheck {
    /// Compares; `speed_px` is how fast the image usually moves, pixels of the recording per second.
    pub fn judge(
        &self,
        found: Option<TimeEstimate>,
        speed_px: Option<f64>,
        given_secs: f64,
    ) -> Check {
        let Some((found, speed_px)) = found.zip(speed_px) else {
            return Check::unknown(self.name, "too little motion to tell".into());
        };
        let TimeEstimate {
            secs,
            standard_error_secs: error_secs,
            thirds_secs,
        } = found;
        let (change_secs, shift_px) = ((secs - given_secs).abs(), self.share * speed_px);
        let is_wrong = change_secs * shift_px >= MIN_SHIFT_PX
            && change_secs >= MIN_SIGNIFICANCE * error_secs
            && speed_px >= MIN_SPEED_PX;
        let thirds = thirds_secs.map_or(String::new(), |thirds| {
            let [a, b, c] = thirds.map(|secs| 1e3 * secs);
            format!(" (thirds of the recording: {a:.1}, {b:.1}, {c:.1})")
        });
        let measured = format!(
            "{} {:.1} +- {:.1} ms{thirds}",
            self.what,
            1e3 * secs,
            1e3 * error_secs
        );
        if is_wrong {
            let seen = format!(
                "{measured}; the camera file says {:.1} ms, which {} by {:.1} px at the usual \
                 {speed_px:.0} px/s",
                1e3 * given_secs,
                self.harm,
                change_secs * shift_px
            );
            let advice = format!("set {} = {secs:.4} in the camera file", self.key);
            Check::warn(self.name, seen, advice)
        } else if error_secs * shift_px > MAX_ERROR_PX || speed_px < MIN_SPEED_PX {
            let seen = format!("the motion does not show it ({measured}, {speed_px:.0} px/s)");
            Check::unknown(self.name, seen)
        } else {
            Check::ok(self.name, measured)
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
            share: 1.0,
        };
        let judge = |secs, standard_error_secs, speed_px| {
            let found = TimeEstimate {
                secs,
                standard_error_secs,
                thirds_secs: Some([-0.011, -0.012, -0.013]),
            };
            check.judge(Some(found), Some(speed_px), 0.002)
        };
        let late = judge(-0.0124, 0.001, 300.0);
        assert_eq!(late.verdict, Verdict::Warn);
        assert_eq!(
            late.seen,
            "depth is later by -12.4 +- 1.0 ms (thirds of the recording: -11.0, -12.0, -13.0); the \
             camera file says 2.0 ms, which shifts colours by 4.3 px at the usual 300 px/s"
        );
        let advice = late.advice.unwrap();
        assert_eq!(advice, "set depth_delay_secs = -0.0124 in the camera file");
        // Not visible, not certain, hardly any motion.
        assert_eq!(judge(0.003, 0.0001, 300.0).verdict, Verdict::Ok);
        assert_eq!(judge(-0.0124, 0.005, 300.0).verdict, Verdict::Unknown);
        assert_eq!(judge(-0.5, 0.001, 10.0).verdict, Verdict::Unknown);
        let nothing = check.judge(None, Some(300.0), 0.002);
        assert_eq!(nothing.verdict, Verdict::Unknown);
    }
}
