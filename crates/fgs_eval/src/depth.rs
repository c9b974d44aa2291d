//! Depth error of a render.

use fgs_geom::{Image, has_depth};

use crate::EvalError;
use crate::pixels::check_size;

/// Below this accumulated alpha a pixel shows more background than map, and its depth means little.
const MIN_ALPHA: f32 = 0.5;

/// Error of rendered depth against the measured one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthError {
    /// Mean absolute error over the compared pixels, metres.
    pub l1_m: f64,
    /// Fraction of the pixels with measured depth that were compared.
    pub compared_share: f64,
}

/// Compares rendered and measured depth (metres along z) at the pixels with measured depth,
/// rendered alpha above 0.5 and finite rendered depth. `None` if there is no such pixel.
///
/// # Errors
/// For images of unequal size.
pub fn depth_error(
    rendered_m: &Image<f32>,
    rendered_alpha: &Image<f32>,
    measured_m: &Image<f32>,
) -> Result<Option<DepthError>, EvalError> {
    check_size(rendered_m, measured_m)?;
    check_size(rendered_alpha, measured_m)?;
    let (mut sum_m, mut compared, mut measured) = (0.0, 0_usize, 0_usize);
    let rendered = rendered_m.data().iter().zip(rendered_alpha.data());
    for ((&depth_m, &alpha), &measured_depth_m) in rendered.zip(measured_m.data()) {
        if has_depth(measured_depth_m) {
            measured += 1;
            if alpha > MIN_ALPHA && depth_m.is_finite() {
                compared += 1;
                sum_m += (f64::from(depth_m) - f64::from(measured_depth_m)).abs();
            }
        }
    }
    Ok((compared > 0).then(|| DepthError {
        l1_m: sum_m / compared as f64,
        compared_share: compared as f64 / measured as f64,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_measured_and_covered_pixels_count() {
        let row = |values: [f32; 5]| Image::new(5, 1, values.to_vec()).unwrap();
        let error = depth_error(
            &row([1.5, 2.0, 9.0, 9.0, f32::NAN]),
            &row([0.9, 0.6, 0.5, 1.0, 1.0]),
            &row([1.0, 2.25, 3.0, 0.0, 1.0]),
        );
        let expected = DepthError {
            l1_m: 0.375,
            compared_share: 0.5,
        };
        assert_eq!(error, Ok(Some(expected)));
    }

    #[test]
    fn nothing_to_compare() {
        let empty = Image::filled(3, 2, 0.0);
        assert_eq!(depth_error(&empty, &empty, &empty), Ok(None));
        let other = Image::filled(2, 3, 0.0);
        assert!(depth_error(&empty, &empty, &other).is_err());
        assert!(depth_error(&empty, &other, &empty).is_err());
    }
}
