//! Why a run cannot be shown in Rerun.

use std::io;
use std::path::PathBuf;

use re_sdk::RecordingStreamError;
use re_sdk::sink::{FileSinkError, SinkFlushError};

/// Why a run cannot be shown in Rerun, or not be written for it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RerunError {
    /// Nobody listens where a viewer does.
    #[error(
        "no Rerun viewer listens at {address}; start one of version {version} first: \
         `pip install rerun-sdk=={version}` or `cargo install rerun-cli@{version}`, then `rerun`"
    )]
    NoViewer {
        /// The viewer's address.
        address: std::net::SocketAddr,
        /// Of the viewer that understands what is sent.
        version: &'static str,
    },
    /// There is a file of another program.
    #[error("{path} exists and is no Rerun recording")]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's refusal.
        source: io::Error,
    },
    /// No thread starts.
    #[error("cannot start a thread: {0}")]
    Thread(#[source] io::Error),
    /// What was to be shown was not taken in time.
    #[error("the viewer or the disk is too slow: what was left at the end of the run is lost")]
    TooSlow,
    /// The thread that looks on panicked.
    #[error("the thread that looks on panicked")]
    Panicked,
    /// The Rerun library refuses something.
    #[error(transparent)]
    Stream(#[from] RecordingStreamError),
    /// The Rerun library cannot make the file.
    #[error(transparent)]
    Sink(#[from] FileSinkError),
    /// Something was not written or sent.
    #[error(transparent)]
    Flush(#[from] SinkFlushError),
}
