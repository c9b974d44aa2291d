//! A stage to be timed, and its times.

use std::time::Instant;

/// Runs of a stage, after one that warms up.
pub const RUNS: usize = 15;

/// Work that is repeated and timed.
pub struct Stage<'a> {
    pub name: &'static str,
    /// Its size, in words.
    pub work: String,
    /// Bytes that must be read or written at least once.
    pub bytes: f64,
    /// Operations on `f32`, a multiply-add counting two.
    pub flops: f64,
    /// Fails if the stage's result is wrong.
    pub check: Box<dyn FnMut() -> anyhow::Result<()> + 'a>,
    pub run: Box<dyn FnMut() + Send + 'a>,
}

/// Checks a stage, times it and prints the times.
pub type Bench<'a> = dyn FnMut(Stage<'_>) -> anyhow::Result<()> + 'a;

/// Times of a stage.
#[derive(Clone, Copy)]
pub struct Times {
    pub median_ms: f64,
    pub best_ms: f64,
}

impl Times {
    /// Wall times of [`RUNS`] runs.
    pub fn measure(run: &mut (dyn FnMut() + Send)) -> Self {
        run();
        let times = (0..RUNS).map(|_| {
            let start = Instant::now();
            run();
            1e3 * start.elapsed().as_secs_f64()
        });
        Self::of(times.collect())
    }

    /// Of at least one run, milliseconds each.
    pub fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        Self {
            median_ms: times[times.len() / 2],
            best_ms: times[0],
        }
    }
}
