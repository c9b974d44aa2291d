//! Which robust edges to believe: truncated least squares by graduated non-convexity (Yang et al.
//! 2020, "Graduated Non-Convexity for Robust Spatial Perception", Sec. III).
//!
//! Why not Cauchy: a false loop keeps pulling. Why not Geman-McClure: true loops count less too, and
//! from a drifted start, like dynamic covariance scaling, it rejects the loops that would correct
//! the drift. What is left here at the end counts fully or not at all: the result is that of least
//! squares without the rejected edges.

/// Growth of the control parameter from one surrogate to the next: the authors' choice.
const GROWTH: f64 = 1.4;

/// From here on the surrogate's weights are rounded to 0 and 1.
const LAST_CONTROL: f64 = 16.0;

/// The surrogate of the truncated quadratic, from convex (0) to exact (infinity).
#[derive(Clone, Copy, Debug)]
pub struct Truncation {
    control: f64,
    max_squared: f64,
}

impl Truncation {
    /// The surrogate that is convex for errors up to `largest`.
    pub fn convex(largest: f64, max_squared: f64) -> Self {
        let largest = largest.max(2.0 * max_squared);
        Self {
            control: max_squared / (2.0 * largest - max_squared),
            max_squared,
        }
    }

    /// The next, less convex surrogate.
    pub fn sharper(self) -> Self {
        Self {
            control: GROWTH * self.control,
            ..self
        }
    }

    /// Weight of an edge of this squared error, in `[0, 1]` (Eq. 14).
    pub fn weight(&self, squared: f64) -> f64 {
        let Self {
            control,
            max_squared,
        } = *self;
        let ratio = squared / max_squared;
        if control >= LAST_CONTROL {
            return if ratio <= 1.0 { 1.0 } else { 0.0 };
        }
        if ratio <= control / (control + 1.0) {
            1.0
        } else if ratio >= (control + 1.0) / control {
            0.0
        } else {
            (control * (control + 1.0) / ratio).sqrt() - control
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The weight is where `w ratio + control (1 - w) / (control + w)` is least: the penalty of
    /// Black and Rangarajan's duality, searched by brute force.
    #[test]
    fn weights_minimise_the_penalised_cost() {
        let mut truncation = Truncation::convex(1e3, 4.0);
        while truncation.control < LAST_CONTROL {
            let control = truncation.control;
            for ratio in [1e-3, 0.1, 0.7, 0.99, 1.01, 1.5, 3.0, 40.0, 250.0, 1e4] {
                let cost = |w: f64| w * ratio + control * (1.0 - w) / (control + w);
                let weight = truncation.weight(4.0 * ratio);
                let least = (0..=1000)
                    .map(|i| cost(f64::from(i) / 1000.0))
                    .fold(f64::INFINITY, f64::min);
                assert!((0.0..=1.0).contains(&weight));
                assert!(cost(weight) <= least + 1e-12, "{control} {ratio}");
            }
            truncation = truncation.sharper();
        }
        assert_eq!(truncation.weight(4.0), 1.0);
        assert_eq!(truncation.weight(4.001), 0.0);
    }
}
