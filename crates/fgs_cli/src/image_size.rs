//! `WxH`: the size of an image.

use std::str::FromStr;

/// An image of 8K: rendering it takes less than 2 GB.
const MAX_PIXELS: usize = 7680 * 4320;

/// Columns and rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageSize {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl FromStr for ImageSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let size = text.split_once('x').and_then(|(width, height)| {
            Some(Self {
                width: width.parse().ok()?,
                height: height.parse().ok()?,
            })
        });
        let size = size.ok_or_else(|| format!("'{text}' is not a size such as 640x480"))?;
        match size.width.checked_mul(size.height) {
            Some(pixels) if pixels <= MAX_PIXELS => Ok(size),
            _ => Err(format!(
                "{text} is too large: at most {MAX_PIXELS} pixels fit the memory, 7680x4320"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn width_then_height() {
        let size = ImageSize {
            width: 640,
            height: 480,
        };
        assert_eq!("640x480".parse(), Ok(size));
        for text in ["640", "640x", "x480", "640x480x3", "-1x5", "6.0x5"] {
            assert!(text.parse::<ImageSize>().is_err(), "{text}");
        }
        assert!("7680x4320".parse::<ImageSize>().is_ok());
        for text in ["65536x65536", "18446744073709551615x2", "7681x4320"] {
            let refusal = text.parse::<ImageSize>().unwrap_err();
            assert!(refusal.contains("at most 33177600 pixels"), "{refusal}");
        }
    }
}
