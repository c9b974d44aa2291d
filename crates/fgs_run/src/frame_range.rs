//! `A..B`: the frames of a recording from A up to, but not including, B, counted from 0.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::error::RunError;

/// A half-open range of frames. Either end may be left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct FrameRange {
    start: Option<usize>,
    end: Option<usize>,
}

impl FrameRange {
    /// The frames meant, of a recording of `len` frames.
    ///
    /// # Errors
    /// [`RunError::Frames`] if the range is empty or goes beyond the recording.
    pub fn resolve(&self, len: usize) -> Result<Range<usize>, RunError> {
        let frames = self.start.unwrap_or(0)..self.end.unwrap_or(len);
        if frames.is_empty() || frames.end > len {
            return Err(RunError::Frames { range: *self, len });
        }
        Ok(frames)
    }
}

impl From<Range<usize>> for FrameRange {
    fn from(range: Range<usize>) -> Self {
        Self {
            start: Some(range.start),
            end: Some(range.end),
        }
    }
}

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = |part: &str| match part.trim() {
            "" => Ok(None),
            number => number.parse().map(Some),
        };
        text.split_once("..")
            .and_then(|(start, end)| {
                Some(Self {
                    start: parse(start).ok()?,
                    end: parse(end).ok()?,
                })
            })
            .ok_or_else(|| format!("'{text}' is not a range such as 0..500, 100.. or ..50"))
    }
}

impl TryFrom<String> for FrameRange {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<FrameRange> for String {
    fn from(range: FrameRange) -> Self {
        range.to_string()
    }
}

impl fmt::Display for FrameRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = |end: Option<usize>| end.map(|n| n.to_string()).unwrap_or_default();
        write!(f, "{}..{}", text(self.start), text(self.end))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(text: &str) -> Result<Range<usize>, String> {
        let range: FrameRange = text.parse()?;
        assert_eq!(range.to_string().parse(), Ok(range));
        range.resolve(100).map_err(|error| error.to_string())
    }

    #[test]
    fn half_open_with_optional_ends() {
        assert_eq!(resolve("3..7"), Ok(3..7));
        assert_eq!(resolve("3.."), Ok(3..100));
        assert_eq!(resolve("..100"), Ok(0..100));
        assert_eq!(resolve(".."), Ok(0..100));
    }

    #[test]
    fn nonsense_is_refused() {
        for text in [
            "", "5", "7..3", "3..3", "100..", "0..101", "-1..5", "a..b", "1...5",
        ] {
            assert!(resolve(text).is_err(), "{text}");
        }
    }
}
