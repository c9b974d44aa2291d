//! Frames that are kept out of the map on purpose, so that it can be judged by views it has never
//! seen.
//!
//! Work on novel view synthesis keeps back every 8th image, the first among them. Here the first frame
//! starts the map, so it is the last of every N frames that is kept out.

use std::num::ParseIntError;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// The last of every N frames. As text and in files: N.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "usize", into = "usize")]
pub struct Holdout(usize);

/// Why there is no such [`Holdout`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum HoldoutError {
    /// Nothing would be left for the map.
    #[error("one frame in {0} cannot be held out, only one in 2 or more")]
    TooFew(usize),
    /// The text is no number.
    #[error(transparent)]
    NotANumber(#[from] ParseIntError),
}

impl Holdout {
    /// The frames N-1, 2N-1, 3N-1, ... of a session, counted from its first, which is 0.
    ///
    /// # Errors
    /// If `n` is less than 2.
    pub fn every(n: usize) -> Result<Self, HoldoutError> {
        if n < 2 {
            return Err(HoldoutError::TooFew(n));
        }
        Ok(Self(n))
    }

    /// Whether a frame is held out, given its place in the session, from 0.
    pub fn contains(self, place: usize) -> bool {
        place % self.0 == self.0 - 1
    }
}

impl TryFrom<usize> for Holdout {
    type Error = HoldoutError;

    fn try_from(n: usize) -> Result<Self, HoldoutError> {
        Self::every(n)
    }
}

impl From<Holdout> for usize {
    fn from(holdout: Holdout) -> Self {
        holdout.0
    }
}

impl FromStr for Holdout {
    type Err = HoldoutError;

    fn from_str(text: &str) -> Result<Self, HoldoutError> {
        Self::every(text.parse()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_of_every_n_and_never_the_first() {
        let held_out = |n| {
            let holdout = Holdout::every(n).unwrap();
            (0..25).filter(move |place| holdout.contains(*place))
        };
        assert!(held_out(8).eq([7, 15, 23]));
        assert!(held_out(2).eq((1..25).step_by(2)));
    }

    #[test]
    fn less_than_two_is_refused() {
        for text in ["0", "1", "-3", "x", ""] {
            assert!(text.parse::<Holdout>().is_err(), "{text}");
        }
        assert_eq!(Holdout::every(1), Err(HoldoutError::TooFew(1)));
        assert_eq!("2".parse(), Holdout::every(2));
    }
}
