//! A time that all parts of a recording share, with the error that their disagreement shows.
//!
//! Errors of measurements close in time are correlated; those of large blocks of the recording are
//! taken as independent.

/// Number of blocks of the recording.
const BLOCKS: usize = 6;

/// Fewer measurements give no estimate: the covariance of the errors of motions alone has 21 parameters.
pub(crate) const MIN_MEASUREMENTS: usize = 15;

/// An estimated time difference.
#[derive(Clone, Debug)]
pub struct TimeEstimate {
    /// The estimate, seconds.
    pub secs: f64,
    /// Its standard error, from the scatter between parts of the recording, seconds.
    pub standard_error_secs: f64,
    /// What the first, middle and last third of the measurements alone say; `None` if these are too
    /// few.
    pub thirds_secs: Option<[f64; 3]>,
}

/// Half the squared error of one measurement, around the estimate: its first and second derivative
/// with respect to the time.
#[derive(Clone, Copy)]
pub(crate) struct Parabola {
    pub slope: f64,
    pub curvature: f64,
}

impl Parabola {
    /// The sum of some.
    pub(crate) fn sum(parabolas: &[Self]) -> Self {
        Self {
            slope: parabolas.iter().map(|one| one.slope).sum(),
            curvature: parabolas.iter().map(|one| one.curvature).sum(),
        }
    }

    /// From here to the minimum.
    pub(crate) fn step(&self) -> f64 {
        -self.slope / self.curvature
    }
}

impl TimeEstimate {
    /// From all measurements in temporal order, at their common minimum.
    pub(crate) fn at_minimum(secs: f64, parabolas: &[Parabola]) -> Self {
        let parts = |count: usize| {
            let len = parabolas.len();
            let part = move |i: usize| &parabolas[i * len / count..(i + 1) * len / count];
            (0..count).map(move |i| Parabola::sum(part(i)))
        };
        let blocks = BLOCKS as f64;
        let squares: f64 = parts(BLOCKS).map(|block| block.slope.powi(2)).sum();
        let mut standard_error_secs =
            (squares * blocks / (blocks - 1.0)).sqrt() / Parabola::sum(parabolas).curvature;
        let mut thirds_secs = None;
        if parabolas.len() / 3 >= MIN_MEASUREMENTS {
            let thirds: Vec<f64> = parts(3).map(|third| secs + third.step()).collect();
            let mean = thirds.iter().sum::<f64>() / 3.0;
            let squares: f64 = thirds.iter().map(|third| (third - mean).powi(2)).sum();
            standard_error_secs = standard_error_secs.max((squares / 6.0).sqrt());
            thirds_secs = thirds.try_into().ok();
        }
        Self {
            secs,
            standard_error_secs,
            thirds_secs,
        }
    }
}
