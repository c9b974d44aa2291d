//! Errors of this crate: those of `fgs_data`, with the file and what is wrong with it in plain words.

use std::io;
use std::path::Path;

use fgs_data::DataError;

pub(crate) fn fault(path: &Path, message: String) -> DataError {
    DataError::Recording {
        path: path.into(),
        message,
    }
}

pub(crate) fn io_fault(path: &Path, source: io::Error) -> DataError {
    DataError::Io {
        path: path.into(),
        source,
    }
}
