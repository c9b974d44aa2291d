//! Why a camera cannot be used.

use fgs_data::DataError;
use thiserror::Error;

/// Why a camera cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Ros2Error {
    /// `ROS_DOMAIN_ID` is no number that ROS takes.
    #[error("ROS_DOMAIN_ID is {0:?}: a number from 0 to 232 is expected")]
    Domain(String),
    /// DDS or ROS refused something.
    #[error("ROS 2: {0}")]
    Ros(String),
    /// Nothing came in time.
    #[error("{0}")]
    Silent(String),
    /// The camera's messages are not understood.
    #[error(transparent)]
    Data(#[from] DataError),
}

impl Ros2Error {
    /// Of an error of the ROS client, whose kinds have no type in common.
    pub(crate) fn ros(error: impl std::fmt::Display) -> Self {
        Self::Ros(error.to_string())
    }
}
