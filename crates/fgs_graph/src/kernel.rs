//! How much an edge counts that does not fit.

use serde::{Deserialize, Serialize};

/// What an edge's squared error costs, by its `chi2 = r^T I r`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum RobustKernel {
    /// `chi2`: for edges that are certain to be right, such as those between successive keyframes.
    #[default]
    Quadratic,
    /// Dynamic covariance scaling (Agarwal et al., ICRA 2013): `chi2` up to `threshold`, flat far
    /// beyond it. For edges that may be wrong, such as loop closures.
    ///
    /// Chosen over Cauchy's kernel because edges that fit keep their full weight, so that right
    /// loops are not softened, and because the pull of a wrong one falls to nothing.
    DynamicCovarianceScaling {
        /// The squared error from which on an edge loses weight. 12.6 is the 95 % quantile of a
        /// right edge's (six degrees of freedom).
        threshold: f64,
    },
}

impl RobustKernel {
    /// The cost of a squared error.
    pub fn cost(self, chi2: f64) -> f64 {
        match self {
            Self::DynamicCovarianceScaling { threshold } if chi2 > threshold => {
                // The integral of the weight: continuous at the threshold, with the limit
                // 3 threshold.
                threshold * (3.0 * chi2 - threshold) / (threshold + chi2)
            }
            _ => chi2,
        }
    }

    /// Derivative of the cost by the squared error: the edge's weight, 0 to 1.
    pub fn weight(self, chi2: f64) -> f64 {
        match self {
            Self::DynamicCovarianceScaling { threshold } if chi2 > threshold => {
                (2.0 * threshold / (threshold + chi2)).powi(2)
            }
            _ => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use num_dual::{Dual64, DualNum};

    use super::*;

    #[test]
    fn the_weight_is_the_derivative_of_the_cost() {
        let threshold = 4.0;
        let kernel = RobustKernel::DynamicCovarianceScaling { threshold };
        for chi2 in [0.0, 1.0, 3.999, 4.001, 10.0, 1e3, 1e6] {
            let x = Dual64::from(chi2).derivative();
            let cost = if chi2 > threshold {
                (x * 3.0 - threshold) * threshold * (x + threshold).recip()
            } else {
                x
            };
            assert!((kernel.cost(chi2) - cost.re).abs() <= 1e-12 * (1.0 + cost.re));
            assert!((kernel.weight(chi2) - cost.eps).abs() <= 1e-12, "{chi2}");
        }
    }

    #[test]
    fn large_errors_cost_no_more_and_right_edges_full() {
        let kernel = RobustKernel::DynamicCovarianceScaling { threshold: 12.6 };
        assert_eq!((kernel.cost(5.0), kernel.weight(5.0)), (5.0, 1.0));
        assert!(kernel.cost(1e12) <= 3.0 * 12.6 && kernel.weight(1e6) <= 1e-8);
        assert_eq!(RobustKernel::Quadratic.cost(1e9), 1e9);
    }
}
