//! How tracker and mapper take turns, as the user names it.

use clap::ValueEnum;
use fgs_slam::Execution;
use serde::{Deserialize, Serialize};

/// `--mode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Tracker and mapper in strict turns: the same result, byte for byte, every time
    Lockstep,
    /// Tracker and mapper side by side; each frame still gets its iterations
    Parallel,
    /// Side by side, frames arrive by their time stamps, late ones are dropped
    Realtime,
}

impl From<Mode> for Execution {
    fn from(mode: Mode) -> Self {
        match mode {
            Mode::Lockstep => Self::Lockstep,
            Mode::Parallel => Self::Parallel,
            Mode::Realtime => Self::Realtime,
        }
    }
}
