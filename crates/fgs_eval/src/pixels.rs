//! Rendered and measured pixels on one scale, and images of one size.

use fgs_geom::Image;

use crate::EvalError;

/// A rendered value as it would be displayed, without rounding to a byte.
pub(crate) fn unit_from_float(value: f32) -> f64 {
    f64::from(value).clamp(0.0, 1.0)
}

/// A camera's byte on the scale of the render.
pub(crate) fn unit_from_byte(value: u8) -> f64 {
    f64::from(value) / 255.0
}

pub(crate) fn check_size<A, B>(a: &Image<A>, b: &Image<B>) -> Result<(), EvalError> {
    let (a, b) = ((a.width(), a.height()), (b.width(), b.height()));
    if a == b {
        Ok(())
    } else {
        Err(EvalError::UnequalSizes { a, b })
    }
}
