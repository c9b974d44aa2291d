//! Errors of a graphics device: there is none, it does not meet the requirements, or it fails. Builds
//! without the GPU backend have them too, so that [`ModelError`](crate::ModelError) is always the same.
//!
//! Messages are written for the user; the driver's own message comes last.

use thiserror::Error;

/// Why a graphics device cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum GpuError {
    /// There is no usable device. Details, possibly empty.
    #[error("no graphics device was found{}", after_colon(.0))]
    NoAdapter(String),
    /// The device does not meet the requirements.
    #[error("{device} cannot be used: {what}")]
    Unfit {
        /// The device's name.
        device: String,
        /// The limit that is too low, with its actual and its required value.
        what: String,
    },
    /// A buffer would exceed the device's limit.
    #[error(
        "{what} take {} MB, but the graphics device allows buffers of at most {} MB",
        .needed.div_ceil(1_000_000),
        .limit / 1_000_000
    )]
    TooLarge {
        /// The buffer's contents, in the plural.
        what: &'static str,
        /// Bytes needed.
        needed: u64,
        /// The largest buffer that the device can bind, bytes.
        limit: u64,
    },
    /// The device was lost, for example because its driver was restarted.
    #[error("the graphics device was lost{}", after_colon(.0))]
    Lost(String),
    /// The device is out of memory.
    #[error("the graphics device is out of memory{}", after_colon(.0))]
    OutOfMemory(String),
    /// Any other error that the device reports.
    #[error("the graphics device failed{}", after_colon(.0))]
    Other(String),
}

fn after_colon(detail: &str) -> String {
    if detail.is_empty() {
        String::new()
    } else {
        format!(": {detail}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_say_what_is_known() {
        let none = |detail: &str| GpuError::NoAdapter(detail.into()).to_string();
        assert_eq!(none(""), "no graphics device was found");
        assert_eq!(
            none("only a software device"),
            "no graphics device was found: only a software device"
        );
        let too_large = GpuError::TooLarge {
            what: "the gaussians",
            needed: 134_217_729,
            limit: 134_217_728,
        };
        assert_eq!(
            too_large.to_string(),
            "the gaussians take 135 MB, but the graphics device allows buffers of at most 134 MB"
        );
    }
}
