//! What goes wrong, as exit codes: 2 where the command line, a configuration or a camera has to be
//! corrected, 1 for everything else. The message is printed once, by `main`.

use std::fmt;

use fgs_data::DataError;
use fgs_slam::SlamError;

/// Everything was done.
pub const EXIT_DONE: u8 = 0;
/// It could not be done.
pub const EXIT_FAILED: u8 = 1;
/// It was asked for in a way that cannot be meant.
pub const EXIT_USAGE: u8 = 2;
/// Ctrl-C ended it; what there was is saved. 128 + SIGINT, as shells have it.
pub const EXIT_INTERRUPTED: u8 = 130;

/// The user has to change the command line, a configuration or a camera file.
#[derive(Debug)]
pub struct UsageError(pub String);

impl fmt::Display for UsageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UsageError {}

/// The exit code for an error.
pub fn exit_code(error: &anyhow::Error) -> u8 {
    let usage = error.chain().any(|cause| {
        cause.is::<UsageError>()
            || matches!(
                cause.downcast_ref(),
                Some(
                    DataError::CameraFile { .. }
                        | DataError::Camera { .. }
                        | DataError::NoCamera { .. }
                )
            )
            || matches!(cause.downcast_ref(), Some(SlamError::Config(_)))
    });
    if usage { EXIT_USAGE } else { EXIT_FAILED }
}
