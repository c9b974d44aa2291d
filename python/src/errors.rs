//! The library's errors as the exceptions of `fgs_slam.errors`.

use fgs_data::DataError;
use fgs_export::ExportError;
use fgs_run::RunError;
use fgs_slam::SlamError;
use fgs_splat::PlyError;
use fgs_synth::SynthError;
use pyo3::prelude::*;

/// The exceptions, as Python declares them.
mod python {
    #![allow(missing_docs, reason = "fgs_slam/errors.py documents them")]

    use pyo3::import_exception;

    import_exception!(fgs_slam.errors, AlignmentError);
    import_exception!(fgs_slam.errors, DatasetError);
    import_exception!(fgs_slam.errors, DeviceError);
    import_exception!(fgs_slam.errors, EvaluationError);
    import_exception!(fgs_slam.errors, FileError);
    import_exception!(fgs_slam.errors, FrameError);
    import_exception!(fgs_slam.errors, RunError);
    import_exception!(fgs_slam.errors, SessionError);
    import_exception!(fgs_slam.errors, SettingError);
    import_exception!(fgs_slam.errors, ShapeError);
}

pub use python::{
    AlignmentError, EvaluationError, FrameError, RunError as RunFailure, SessionError,
    SettingError, ShapeError,
};
use python::{DatasetError, DeviceError, FileError};

/// An error as the exception that Python sees.
pub trait IntoPython {
    /// The exception.
    fn into_python(self) -> PyErr;
}

impl IntoPython for RunError {
    fn into_python(self) -> PyErr {
        let message = self.to_string();
        match self {
            Self::Settings { .. }
            | Self::Assignment { .. }
            | Self::NotToml(_)
            | Self::Frames { .. }
            | Self::VoxelSize(_)
            | Self::Camera(_) => SettingError::new_err(message),
            Self::NoDevice(_) => DeviceError::new_err(message),
            Self::Data(_)
            | Self::RecordingOfRun(_)
            | Self::UnknownRecording { .. }
            | Self::OtherRecording { .. }
            | Self::NotOfMap { .. }
            | Self::NothingRead { .. } => DatasetError::new_err(message),
            Self::Slam(error) => error.into_python(),
            Self::Export(error) => error.into_python(),
            Self::Eval(_) => EvaluationError::new_err(message),
            Self::Map(_)
            | Self::NotARun { .. }
            | Self::NoCamera { .. }
            | Self::BelongsToRun { .. }
            | Self::NoMap { .. }
            | Self::MapVersion { .. }
            | Self::MapDamaged { .. }
            | Self::OutputFolder { .. }
            | Self::Refused(_)
            | Self::Incomplete { .. }
            | Self::Read { .. }
            | Self::Write { .. } => FileError::new_err(message),
            _ => RunFailure::new_err(message),
        }
    }
}

impl IntoPython for SlamError {
    fn into_python(self) -> PyErr {
        let message = self.to_string();
        match self {
            Self::Setting(_) => SettingError::new_err(message),
            Self::Frame(_) | Self::OtherCamera { .. } => FrameError::new_err(message),
            _ => SessionError::new_err(message),
        }
    }
}

impl IntoPython for DataError {
    fn into_python(self) -> PyErr {
        DatasetError::new_err(self.to_string())
    }
}

impl IntoPython for PlyError {
    fn into_python(self) -> PyErr {
        FileError::new_err(self.to_string())
    }
}

impl IntoPython for SynthError {
    fn into_python(self) -> PyErr {
        FileError::new_err(self.to_string())
    }
}

impl IntoPython for ExportError {
    fn into_python(self) -> PyErr {
        let message = self.to_string();
        match self {
            Self::Data(error) => error.into_python(),
            Self::Exists { .. } | Self::Write { .. } => FileError::new_err(message),
            Self::TooManyVoxels { .. } => SettingError::new_err(message),
            _ => RunFailure::new_err(message),
        }
    }
}
