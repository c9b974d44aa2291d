//! `WxH`: the size of an image.

use std::str::FromStr;

/// A frame of 8K: making it takes less than 2 GB.
const MAX_FRAME_PIXELS: usize = 7680 * 4320;

/// A picture is written some rows at a time, whatever its size. But browsers and most programs that show
/// pictures take no larger ones, and rendering such a one takes minutes.
const MAX_PICTURE_PIXELS: usize = 16384 * 16384;

/// Columns and rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageSize {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl ImageSize {
    /// The size of a picture that is never in memory as a whole.
    ///
    /// # Errors
    /// If it is none, or too large.
    pub fn of_picture(text: &str) -> Result<Self, String> {
        let limit = "16384x16384, are what programs can show";
        Self::parse(text, MAX_PICTURE_PIXELS, limit)
    }

    fn parse(text: &str, max_pixels: usize, limit: &str) -> Result<Self, String> {
        let size = text.split_once('x').and_then(|(width, height)| {
            Some(Self {
                width: width.parse().ok()?,
                height: height.parse().ok()?,
            })
        });
        let size = size.ok_or_else(|| format!("'{text}' is not a size such as 640x480"))?;
        match size.width.checked_mul(size.height) {
            Some(pixels) if pixels <= max_pixels => Ok(size),
            _ => Err(format!(
                "{text} is too large: at most {max_pixels} pixels, as in {limit}"
            )),
        }
    }
}

impl FromStr for ImageSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::parse(text, MAX_FRAME_PIXELS, "7680x4320, fit the memory")
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
        assert!(ImageSize::of_picture("16384x16384").is_ok());
        for text in ["65536x65536", "16385x16384", "18446744073709551615x2", "5"] {
            assert!(ImageSize::of_picture(text).is_err(), "{text}");
        }
    }
}
