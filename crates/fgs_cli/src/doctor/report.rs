//! The results of the checks, as text and as JSON.

use std::fmt;

use serde::Serialize;

/// How a check ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Nothing found.
    Ok,
    /// The recording does not show it either way.
    Unknown,
    /// Results may suffer.
    Warn,
    /// Results will be wrong.
    Problem,
}

/// The result of one check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// What was checked.
    pub name: &'static str,
    /// How it ended.
    pub verdict: Verdict,
    /// What was found: one line, with numbers.
    pub seen: String,
    /// What to change; `None` where there is nothing to do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<String>,
}

impl Check {
    /// Nothing found.
    pub fn ok(name: &'static str, seen: String) -> Self {
        Self {
            name,
            verdict: Verdict::Ok,
            seen,
            advice: None,
        }
    }

    /// The recording does not show it either way.
    pub fn unknown(name: &'static str, seen: String) -> Self {
        Self {
            verdict: Verdict::Unknown,
            ..Self::ok(name, seen)
        }
    }

    /// Results may suffer.
    pub fn warn(name: &'static str, seen: String, advice: String) -> Self {
        Self {
            verdict: Verdict::Warn,
            advice: Some(advice),
            ..Self::ok(name, seen)
        }
    }

    /// Results will be wrong.
    pub fn problem(name: &'static str, seen: String, advice: String) -> Self {
        Self {
            verdict: Verdict::Problem,
            ..Self::warn(name, seen, advice)
        }
    }
}

/// What the recording holds.
#[derive(Clone, Debug, Serialize)]
pub struct Found {
    /// The folder's layout.
    pub format: String,
    /// Number of frames.
    pub frames: usize,
    /// Number of frames that were read.
    pub frames_read: usize,
    /// Frames with a pose; 0 without poses.
    pub known_poses: usize,
    /// Whether these poses are the device's own estimates.
    pub poses_are_of_device: bool,
    /// From the first frame to the last, seconds.
    pub duration_secs: f64,
    /// Columns of the images.
    pub width: usize,
    /// Rows of the images.
    pub height: usize,
    /// Horizontal focal length, pixels.
    pub fx: f64,
    /// Vertical focal length, pixels.
    pub fy: f64,
    /// Column of the principal point.
    pub cx: f64,
    /// Row of the principal point.
    pub cy: f64,
    /// The value in a depth image that stands for 1 m.
    pub depth_scale: f64,
}

/// Everything `fgs doctor` says.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// What the recording holds.
    pub found: Found,
    /// The checks, in the order in which they were run.
    pub checks: Vec<Check>,
}

impl Report {
    /// Whether any check found a problem.
    pub fn has_problem(&self) -> bool {
        self.checks
            .iter()
            .any(|check| check.verdict == Verdict::Problem)
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Ok => "ok",
            Self::Unknown => "unknown",
            Self::Warn => "warn",
            Self::Problem => "PROBLEM",
        })
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = &self.found;
        let Found {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            ..
        } = found;
        writeln!(f, "found")?;
        writeln!(f, "  format        {}", found.format)?;
        writeln!(
            f,
            "  frames        {} in {:.1} s ({} read for the checks)",
            found.frames, found.duration_secs, found.frames_read
        )?;
        writeln!(
            f,
            "  camera        {width}x{height}, fx {fx} fy {fy} cx {cx} cy {cy}, depth scale {}",
            found.depth_scale
        )?;
        match found.known_poses {
            0 => writeln!(f, "  ground truth  none")?,
            n if found.poses_are_of_device => writeln!(
                f,
                "  ground truth  none; the device's own poses of {n} frames, which are estimates"
            )?,
            n => writeln!(f, "  ground truth  poses of {n} frames")?,
        }
        writeln!(f, "checks")?;
        for Check {
            name,
            verdict,
            seen,
            advice,
        } in &self.checks
        {
            writeln!(f, "  {verdict:<8} {name}: {seen}")?;
            if let Some(advice) = advice {
                writeln!(f, "           -> {advice}")?;
            }
        }
        let count = |wanted| {
            self.checks
                .iter()
                .filter(|check| check.verdict == wanted)
                .count()
        };
        write!(
            f,
            "problems: {}, warnings: {}",
            count(Verdict::Problem),
            count(Verdict::Warn)
        )
    }
}
