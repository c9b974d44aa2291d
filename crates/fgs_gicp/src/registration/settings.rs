//! Settings of a registration, with defaults for a hand-held structured-light camera.

/// Robust kernel: the weight of a correspondence as a function of its residual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kernel {
    /// Weight 1 for all correspondences.
    None,
    /// Weight `1 / (1 + (r/scale)^2)`.
    Cauchy {
        /// Residual at which the weight is 1/2, metres.
        scale_m: f64,
    },
    /// Weight `1 / (1 + (r/scale)^2)^2`. The influence of outliers vanishes.
    GemanMcClure {
        /// Residual at which the weight is 1/4, metres.
        scale_m: f64,
    },
    /// Weight 1 up to the scale and `scale/r` beyond.
    Huber {
        /// Residual above which correspondences are down-weighted, metres.
        scale_m: f64,
    },
}

impl Kernel {
    /// The weight of a correspondence, given its squared residual in square metres.
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
    /// Maximum distance between the two points of a correspondence.
    pub max_correspondence_distance_m: f32,
    /// Robust kernel.
    pub kernel: Kernel,
    /// Maximum number of Gauss-Newton iterations over all points.
    pub max_iterations: usize,
    /// Converged when the rotation of a step is below this ...
    pub rotation_epsilon_rad: f64,
    /// ... and its translation is below this.
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
