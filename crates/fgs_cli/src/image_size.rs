//! `WxH`: the size of an image.

use std::str::FromStr;

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
        size.ok_or_else(|| format!("'{text}' is not a size such as 640x480"))
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
    }
}
