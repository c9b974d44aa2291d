//! What a registration may be told, with defaults for a hand-held structured-light camera.

/// How much a pair with a large residual counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kernel {
    /// All pairs count fully.
    None,
    /// Weight `1 / (1 + (r/scale)^2)`.
    Cauchy {
        /// Residual whose weight is a half, metres.
        scale_m: f64,
    },
    /// Weight `1 / (1 + (r/scale)^2)^2`: outliers end up without influence.
    GemanMcClure {
        /// Residual whose weight is a quarter, metres.
        scale_m: f64,
    },
    /// Weight 1 up to the scale and `scale/r` beyond.
    Huber {
        /// Residual from which on pairs count less, metres.
        scale_m: f64,
    },
}

impl Kernel {
    /// The weight of a pair whose squared residual is given, square metres.
    #[inline]
    pub fn weight(&self, squared: f64) -> f64 {
        match *self {
            Self::None => 1.0,
            Self::Cauchy { scale_m } => 1.0 / (1.0 + squared / (scale_m * scale_m)),
            Self::GemanMcClure { scale_m } => (1.0 + squared / (scale_m * scale_m)).powi(-2),
            Self::Huber { scale_m } => {
                if squared <= scale_m * scale_m {
                    1.0
                } else {
                    scale_m / squared.sqrt()
                }
            }
        }
    }
}

/// Settings of [`align`](crate::align).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Points further apart are no pair.
    pub max_correspondence_distance_m: f32,
    /// Robust kernel.
    pub kernel: Kernel,
    /// Number of linearisations of all points after which the search ends.
    pub max_iterations: usize,
    /// Converged when a step turns less than this ...
    pub rotation_epsilon_rad: f64,
    /// ... and moves less than this.
    pub translation_epsilon_m: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            max_correspondence_distance_m: 0.03,
            kernel: Kernel::None,
            max_iterations: 64,
            rotation_epsilon_rad: 2e-3,
            translation_epsilon_m: 5e-4,
        }
    }
}
