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

/// The error and its causes, one line of each, each said once: many errors quote their cause.
pub fn message(error: &anyhow::Error) -> String {
    let mut message = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        let cause = cause.lines().next().unwrap_or_default();
        if !message.contains(cause) {
            message = format!("{message}: {cause}");
        }
    }
    message
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_said_once() {
        let cause = anyhow::anyhow!("file x: no such file").context("file x: no such file");
        let error = cause.context("cannot start");
        assert_eq!(message(&error), "cannot start: file x: no such file");
    }

    #[test]
    fn codes_are_found_through_context() {
        let usage = anyhow::Error::new(UsageError("no".into())).context("cannot start");
        assert_eq!(exit_code(&usage), EXIT_USAGE);
        assert_eq!(exit_code(&anyhow::anyhow!("no")), EXIT_FAILED);
    }
}
