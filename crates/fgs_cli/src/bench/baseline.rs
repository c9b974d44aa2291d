//! `--save-baseline` and `--baseline`: the times of every stage kept in a file, and how a later run
//! on the same machine compares with them. Times of another machine or another instruction set say
//! nothing, so they are refused.

use std::fs;
use std::io::Write;
use std::path::Path;

use anyhow::Context;
use serde::{Deserialize, Serialize};

use crate::console::Console;
use crate::failure::UsageError;

/// Fifty stages take 10 kB.
const MAX_BYTES: u64 = 1 << 20;

/// A stage counts as slower when it takes more than this many times as long as it did.
const SLOWER: f64 = 1.1;

/// The times of a machine.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// The processor's name.
    pub cpu: String,
    /// The instruction set that kernels used.
    pub instructions: String,
    pub stages: Vec<StageTime>,
}

/// The time of a stage; all but the time tells which one it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageTime {
    pub input: String,
    pub stage: String,
    pub work: String,
    pub threads: usize,
    /// The best of several runs: what else the machine does moves it least.
    pub best_ms: f64,
}

impl StageTime {
    fn is_of_same_stage(&self, other: &Self) -> bool {
        let of = |time: &Self| Self {
            best_ms: 0.0,
            ..time.clone()
        };
        of(self) == of(other)
    }
}

impl Baseline {
    /// Of this machine, before anything is timed.
    pub fn of_this_machine() -> Self {
        Self {
            cpu: cpu_name(),
            instructions: fgs_geom::Instructions::in_use().to_string(),
            stages: Vec::new(),
        }
    }

    /// Reads one of this machine.
    ///
    /// # Errors
    /// If the file is no baseline, or one of another machine or instruction set.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let text = fgs_files::read_text(path, MAX_BYTES)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let baseline: Self = serde_json::from_str(&text)
            .map_err(|e| UsageError(format!("{} is no baseline: {e}", path.display())))?;
        let here = Self::of_this_machine();
        if (&baseline.cpu, &baseline.instructions) != (&here.cpu, &here.instructions) {
            return Err(UsageError(format!(
                "{} is of another machine: {} with {}, this is {} with {}",
                path.display(),
                baseline.cpu,
                baseline.instructions,
                here.cpu,
                here.instructions
            ))
            .into());
        }
        Ok(baseline)
    }

    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        let json = serde_json::to_vec_pretty(self)?;
        fgs_files::write_file(path, |file| file.write_all(&json))
            .with_context(|| format!("cannot write {}", path.display()))
    }

    /// Each stage of `now` that this has too: its time and the ratio to what it was.
    fn ratios<'a>(&self, now: &'a [StageTime]) -> Vec<(&'a StageTime, f64)> {
        let ratio = |time: &'a StageTime| {
            let before = self.stages.iter().find(|s| s.is_of_same_stage(time))?;
            Some((time, time.best_ms / before.best_ms))
        };
        now.iter().filter_map(ratio).collect()
    }

    /// Says which stages are slower than here, and how many could be compared.
    pub fn compare(&self, now: &[StageTime], console: Console) {
        let ratios = self.ratios(now);
        console.say(format!(
            "\n{} of {} stages compared with the baseline",
            ratios.len(),
            now.len()
        ));
        let mut slower: Vec<_> = ratios.iter().filter(|(_, r)| *r > SLOWER).collect();
        slower.sort_by(|a, b| b.1.total_cmp(&a.1));
        for (time, ratio) in &slower {
            console.say(format!(
                "slower x{ratio:.2}: {} {}, {}, {} thread(s): {:.3} ms",
                time.input, time.stage, time.work, time.threads, time.best_ms
            ));
        }
        if slower.is_empty() && !ratios.is_empty() {
            console.say(format!("none is slower than x{SLOWER}"));
        }
        for (time, ratio) in ratios {
            let slower = ratio > SLOWER;
            console.event(
                "compared",
                serde_json::json!({"stage": time, "ratio": ratio, "slower": slower}),
            );
        }
    }
}

/// As Linux calls the processor, with the numbers that tell its generation. Elsewhere only the
/// architecture and system: baselines of different machines are then not told apart.
fn cpu_name() -> String {
    let info = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let value = |key: &str| {
        info.lines()
            .filter_map(|line| line.split_once(':'))
            .find_map(|(name, value)| (name.trim() == key).then(|| value.trim()))
    };
    let keys = ["model name", "cpu family", "model", "stepping"];
    let known: Vec<&str> = keys.into_iter().filter_map(value).collect();
    if known.is_empty() {
        return format!("{} {}", std::env::consts::ARCH, std::env::consts::OS);
    }
    known.join(" ")
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    fn time(stage: &str, work: &str, best_ms: f64) -> StageTime {
        StageTime {
            input: "room".to_owned(),
            stage: stage.to_owned(),
            work: work.to_owned(),
            threads: 1,
            best_ms,
        }
    }

    #[test]
    fn the_same_stages_are_compared_by_ratio() {
        let mut before = Baseline::of_this_machine();
        before.stages = vec![time("a", "1 point", 2.0), time("b", "1 point", 2.0)];
        let now = [time("b", "1 point", 3.0), time("a", "2 points", 9.0)];
        let ratios = before.ratios(&now);
        assert_eq!(ratios, [(&now[0], 1.5)]);
    }

    #[test]
    fn only_times_of_this_machine_are_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("baseline.json");
        let mut baseline = Baseline::of_this_machine();
        baseline.stages.push(time("a", "1 point", 2.0));
        baseline.write(&path).unwrap();
        assert_eq!(Baseline::read(&path).unwrap(), baseline);
        baseline.cpu.push('x');
        baseline.write(&path).unwrap();
        let message = Baseline::read(&path).unwrap_err().to_string();
        assert!(message.contains("another machine"), "{message}");
        fs::write(&path, "[]").unwrap();
        assert!(Baseline::read(&path).is_err());
    }
}
