//! The colours of a trajectory's errors.

use plotters::style::RGBColor;

/// From right to wrong. None is the red of lost frames.
const COLORS: [RGBColor; 5] = [
    RGBColor(44, 95, 158),
    RGBColor(46, 150, 160),
    RGBColor(90, 175, 90),
    RGBColor(205, 175, 40),
    RGBColor(235, 120, 30),
];

/// Classes of errors of equal width.
pub struct ErrorColors {
    class_m: f64,
}

impl ErrorColors {
    /// Classes for a run's errors in metres; what is above most of them shares the last class. `None`
    /// without errors.
    pub fn of(errors_m: impl Iterator<Item = f64>) -> Option<Self> {
        let mut errors: Vec<f64> = errors_m.collect();
        errors.sort_by(f64::total_cmp);
        let high = *errors.get(errors.len() * 95 / 100)?;
        Some(Self {
            class_m: (high / COLORS.len() as f64).max(1e-4),
        })
    }

    pub fn color(&self, error_m: f64) -> RGBColor {
        let class = (error_m / self.class_m) as usize;
        COLORS[class.min(COLORS.len() - 1)]
    }

    /// Each colour with the errors that it stands for.
    pub fn legend(&self) -> Vec<(RGBColor, String)> {
        let bound = |class: usize| 100.0 * self.class_m * class as f64;
        let last = COLORS.len() - 1;
        let classes = COLORS.into_iter().enumerate();
        classes
            .map(|(class, color)| {
                let text = if class == last {
                    format!("over {:.2} cm", bound(class))
                } else {
                    format!("{:.2} to {:.2} cm", bound(class), bound(class + 1))
                };
                (color, text)
            })
            .collect()
    }
}
