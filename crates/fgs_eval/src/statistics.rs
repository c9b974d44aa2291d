//! Summary statistics of a list of errors.

/// Summary statistics, in the unit of the errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics {
    /// Root mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median; for an even number of errors the mean of the two middle ones.
    pub median: f64,
    /// Maximum.
    pub max: f64,
    /// Population standard deviation (divided by n, not n - 1).
    pub std: f64,
}

impl Statistics {
    /// Summarises finite, non-negative errors; `None` if the list is empty.
    pub(crate) fn of(mut errors: Vec<f64>) -> Option<Self> {
        errors.sort_by(f64::total_cmp);
        let max = *errors.last()?;
        let count = errors.len() as f64;
        let middle = [(errors.len() - 1) / 2, errors.len() / 2].map(|i| errors[i]);
        let mean = errors.iter().sum::<f64>() / count;
        let mean_of = |f: &dyn Fn(f64) -> f64| errors.iter().map(|&e| f(e)).sum::<f64>() / count;
        Some(Self {
            rmse: mean_of(&|e| e * e).sqrt(),
            mean,
            median: 0.5 * (middle[0] + middle[1]),
            max,
            std: mean_of(&|e| (e - mean).powi(2)).sqrt(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_few_numbers() {
        let even = Statistics::of(vec![7.0, 1.0, 5.0, 3.0]).unwrap();
        assert_eq!((even.mean, even.median, even.max), (4.0, 4.0, 7.0));
        assert_eq!(even.rmse, 21_f64.sqrt());
        assert_eq!(even.std, 5_f64.sqrt());
        assert_eq!(Statistics::of(vec![9.0, 1.0, 2.0]).unwrap().median, 2.0);
        assert_eq!(Statistics::of(vec![]), None);
    }
}
