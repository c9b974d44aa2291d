//! A number for messages: all its digits, but not hundreds of zeros.

use std::fmt;

/// Shows a number as it is usually written, and in powers of ten where that would be long.
#[derive(Clone, Copy, Debug)]
pub struct Number(pub f64);

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(value) = self;
        let size = value.abs();
        if size.is_finite() && size != 0.0 && !(1e-6..1e16).contains(&size) {
            write!(f, "{value:e}")
        } else {
            write!(f, "{value}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_numbers_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (-5000.0, "-5000"),
            (0.3, "0.3"),
            (1305031102.175304, "1305031102.175304"),
            (1e308, "1e308"),
            (-2.5e-300, "-2.5e-300"),
            (f64::INFINITY, "inf"),
            (f64::NAN, "NaN"),
        ] {
            assert_eq!(Number(value).to_string(), text);
        }
    }
}
