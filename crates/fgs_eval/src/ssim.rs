//! Structural similarity (Z. Wang et al., "Image quality assessment: from error visibility to
//! structural similarity", 2004).
//!
//! Gaussian window of 11x11 pixels, sigma 1.5, K1 = 0.01, K2 = 0.03, values in 0..=1, variances
//! divided by the sum of weights. Averaged over the three channels and over the windows that lie
//! wholly inside the image: no padding. scikit-image (`gaussian_weights=True, sigma=1.5,
//! use_sample_covariance=False`) and torchmetrics agree, as they crop what their padding touched.
//! Pixels whose colour the camera did not see are outside the image: no window contains one.

use fgs_geom::Image;
use rayon::prelude::*;

use crate::EvalError;
use crate::pixels::{check_size, unit_from_byte, unit_from_float};

/// Pixels along a window's side.
const WINDOW: usize = 11;
/// Standard deviation of the window's weights, pixels.
const SIGMA: f64 = 1.5;
/// (K1 L)^2 and (K2 L)^2 with L = 1.
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Mean structural similarity of a render (RGB, clamped to 0..=1) and the camera's image, in
/// -1..=1, over the windows in which `color_valid` is true everywhere (`None`: all windows).
///
/// # Errors
/// For images of unequal size or smaller than 11x11, if no window is complete, and if a rendered
/// value is NaN.
pub fn ssim(
    render: &Image<[f32; 3]>,
    target: &Image<[u8; 3]>,
    color_valid: Option<&Image<bool>>,
) -> Result<f64, EvalError> {
    check_size(render, target)?;
    if let Some(valid) = color_valid {
        check_size(valid, target)?;
    }
    let (width, height) = (render.width(), render.height());
    if width < WINDOW || height < WINDOW {
        return Err(EvalError::TooSmall {
            width,
            height,
            minimum: WINDOW,
        });
    }
    let is_nan = |pixel: &[f32; 3]| pixel.iter().any(|value| value.is_nan());
    if let Some(i) = render.data().iter().position(is_nan) {
        return Err(EvalError::NotANumber {
            u: i % width,
            v: i / width,
        });
    }
    let x: Vec<f64> = (render.data().as_flattened().iter())
        .map(|&value| unit_from_float(value))
        .collect();
    let y: Vec<f64> = (target.data().as_flattened().iter())
        .map(|&value| unit_from_byte(value))
        .collect();
    let weights = window_weights();
    let rows: Vec<(f64, usize)> = (0..=height - WINDOW)
        .into_par_iter()
        .map_init(
            || RowMoments::new(3 * width),
            |moments, top| {
                let complete = complete_windows(width, color_valid, top);
                moments.filter_columns(&x, &y, top, &weights);
                let sum = (0..3 * complete.len())
                    .filter(|left| complete[left / 3])
                    .map(|left| similarity(moments.filter_row(left, &weights)))
                    .sum();
                (
                    sum,
                    3 * complete.iter().filter(|complete| **complete).count(),
                )
            },
        )
        .collect();
    let windows: usize = rows.iter().map(|(_, windows)| windows).sum();
    if windows == 0 {
        return Err(EvalError::NoCompleteWindow { side: WINDOW });
    }
    Ok(rows.iter().map(|(sum, _)| sum).sum::<f64>() / windows as f64)
}

/// Which windows of a row of windows contain valid pixels only, by their first column.
fn complete_windows(width: usize, valid: Option<&Image<bool>>, top: usize) -> Vec<bool> {
    let Some(valid) = valid else {
        return vec![true; width - WINDOW + 1];
    };
    let columns: Vec<bool> = (0..width)
        .map(|u| (top..top + WINDOW).all(|v| valid.at(u, v)))
        .collect();
    (columns.windows(WINDOW))
        .map(|window| window.iter().all(|column| *column))
        .collect()
}

/// The weights along one axis; a window's weight is the product of two.
fn window_weights() -> [f64; WINDOW] {
    let weights: [f64; WINDOW] = std::array::from_fn(|i| {
        let distance = (i as f64 - (WINDOW / 2) as f64) / SIGMA;
        (-0.5 * distance * distance).exp()
    });
    let sum: f64 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

/// Weighted means of x, y, x^2 + y^2 and x y.
type Moments = [f64; 4];

/// The moments of every value in a row of windows, weighted along columns. Values are interleaved
/// RGB.
struct RowMoments {
    of_value: Vec<Moments>,
}

impl RowMoments {
    fn new(values: usize) -> Self {
        Self {
            of_value: vec![[0.0; 4]; values],
        }
    }

    fn filter_columns(&mut self, x: &[f64], y: &[f64], top: usize, weights: &[f64; WINDOW]) {
        let len = self.of_value.len();
        self.of_value.fill([0.0; 4]);
        for (k, weight) in weights.iter().enumerate() {
            let row = (top + k) * len..(top + k + 1) * len;
            let pixels = x[row.clone()].iter().zip(&y[row]);
            for (moments, (&x, &y)) in self.of_value.iter_mut().zip(pixels) {
                for (moment, value) in moments.iter_mut().zip([x, y, x * x + y * y, x * y]) {
                    *moment += weight * value;
                }
            }
        }
    }

    /// The moments of the window whose first value is `left`.
    fn filter_row(&self, left: usize, weights: &[f64; WINDOW]) -> Moments {
        let mut window = [0.0; 4];
        for (moments, weight) in self.of_value[left..].iter().step_by(3).zip(weights) {
            for (sum, moment) in window.iter_mut().zip(moments) {
                *sum += weight * moment;
            }
        }
        window
    }
}

/// Eq. (13) of Wang et al.
fn similarity([mean_x, mean_y, mean_squares, mean_product]: Moments) -> f64 {
    let means_product = mean_x * mean_y;
    let squared_means = mean_x * mean_x + mean_y * mean_y;
    let covariance = mean_product - means_product;
    let variances = mean_squares - squared_means;
    (2.0 * means_product + C1) * (2.0 * covariance + C2) / ((squared_means + C1) * (variances + C2))
}
