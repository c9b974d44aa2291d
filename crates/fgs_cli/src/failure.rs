//! Errors as exit codes and messages: 2 for usage errors, where the command line, a settings file or
//! a camera file has to be corrected, 1 for everything else. `main` prints the message once.

use std::fmt;

use fgs_run::RunError;

/// Everything was done.
pub const EXIT_DONE: u8 = 0;
/// It could not be done.
pub const EXIT_FAILED: u8 = 1;
/// A usage error.
pub const EXIT_USAGE: u8 = 2;
/// Ctrl-C ended it; the results so far are saved. 128 + SIGINT, as in shells.
pub const EXIT_INTERRUPTED: u8 = 130;

/// The user has to change the command line.
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
            || cause
                .downcast_ref()
                .is_some_and(|error: &RunError| error.is_usage())
    });
    if usage { EXIT_USAGE } else { EXIT_FAILED }
}

/// The library's error in terms of the command line, with the option that helps.
pub fn explain(error: RunError) -> anyhow::Error {
    let message = match &error {
        RunError::Assignment { .. } => format!("--set {error}"),
        RunError::BelongsToRun { .. } => format!("--out: {error}"),
        RunError::VoxelSize(_) => format!("--voxel-m: {error}"),
        RunError::NoDevice(_) => format!("{error} (--backend cpu computes without one)"),
        RunError::UnknownRecording { .. } | RunError::RecordingOfRun(_) => {
            format!("{error} (--dataset DIR says where it is)")
        }
        _ => return error.into(),
    };
    anyhow::Error::new(error).context(message)
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
        let refused = || RunError::Assignment {
            assignment: "seed=x".into(),
            message: "no number".into(),
        };
        let explained = explain(refused());
        assert_eq!(exit_code(&explained), EXIT_USAGE);
        assert_eq!(message(&explained), "--set seed=x: no number");
        let nested = explain(RunError::RecordingOfRun(Box::new(refused())));
        assert_eq!(exit_code(&nested), EXIT_USAGE);
    }
}
