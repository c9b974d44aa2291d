//! Why a run was refused or failed. Messages name the file, key or value at fault.

use std::io;
use std::path::PathBuf;

use fgs_data::DataError;
use fgs_eval::EvalError;
use fgs_export::ExportError;
use fgs_files::FolderError;
use fgs_slam::SlamError;
use fgs_splat::{GpuError, PlyError};
use thiserror::Error;

use crate::frame_range::FrameRange;
use crate::run_folder::CONFIG;

/// Why something could not be done.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RunError {
    /// A settings file cannot be read, or a key or value in it is refused.
    #[error("{}{}: {message}", path.display(), line.map(|line| format!(":{line}")).unwrap_or_default())]
    Settings {
        /// The file.
        path: PathBuf,
        /// The line, from 1, where it is known.
        line: Option<usize>,
        /// What is wrong.
        message: String,
    },
    /// A single setting, given as `key=value`, is refused.
    #[error("{assignment}: {message}")]
    Assignment {
        /// The setting as given.
        assignment: String,
        /// What is wrong.
        message: String,
    },
    /// The settings cannot be written as TOML, such as a seed over 2^63.
    #[error("the settings cannot be written as TOML: {0}")]
    NotToml(String),
    /// A range of frames is empty or goes beyond the recording.
    #[error("the range {range} is empty or goes beyond the recording, which has {len} frames")]
    Frames {
        /// What was asked for.
        range: FrameRange,
        /// Frames in the recording.
        len: usize,
    },
    /// Something was asked for that only a recording can give.
    #[error("a live camera's frames come once: {0}")]
    NotLive(&'static str),
    /// The camera file given for the recording is refused, or does not fit its images.
    #[error(transparent)]
    Camera(DataError),
    /// A graphics device was asked for, but none can be used.
    #[error(transparent)]
    NoDevice(GpuError),
    /// The recording, its own camera or a trajectory file is refused.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The recording that a finished run was made from cannot be opened.
    #[error("cannot open the run's recording: {0}")]
    RecordingOfRun(#[source] Box<RunError>),
    /// A finished run does not say where its recording is.
    #[error("{} does not name the run's recording", path.display())]
    UnknownRecording {
        /// The run's settings.
        path: PathBuf,
    },
    /// A folder is not that of a finished run.
    #[error("{} is not the folder of a run: it has no {CONFIG}", path.display())]
    NotARun {
        /// The folder.
        path: PathBuf,
    },
    /// A recording is not the one that a finished run was made from.
    #[error("{} is not the run's recording: {difference}", path.display())]
    OtherRecording {
        /// The recording.
        path: PathBuf,
        /// How it differs.
        difference: String,
    },
    /// Not a single frame could be read.
    #[error("none of the {frames} frames could be read")]
    NothingRead {
        /// Frames that were tried.
        frames: usize,
    },
    /// Tracking and mapping could not be started, or broke down.
    #[error(transparent)]
    Slam(#[from] SlamError),
    /// The thread that tracks panicked: a bug.
    #[error("the tracker stopped on an internal error")]
    TrackerPanicked,
    /// The results cannot be scored.
    #[error(transparent)]
    Eval(#[from] EvalError),
    /// The map cannot be read or written.
    #[error(transparent)]
    Map(#[from] PlyError),
    /// A folder for results cannot be made or written to.
    #[error("cannot write to the output folder {}: {source}", path.display())]
    OutputFolder {
        /// The folder.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// A folder holds no map to go on with.
    #[error("{} holds no map: a run with checkpoints leaves one", path.display())]
    NoMap {
        /// The folder.
        path: PathBuf,
    },
    /// Two maps have no place in common that could be recognised.
    #[error(
        "{} and {} meet nowhere: no place was found that both show",
        first.display(),
        second.display()
    )]
    MapsDoNotMeet {
        /// The first map.
        first: PathBuf,
        /// The second.
        second: PathBuf,
    },
    /// A merged map could not be optimised.
    #[error(transparent)]
    Mapper(#[from] fgs_slam::MapperError),
    /// A merged map would replace one that it is made of.
    #[error("{} is one of the maps to be merged: choose another folder", path.display())]
    MergesInto {
        /// The folder.
        path: PathBuf,
    },
    /// A map was written by a newer program.
    #[error("the map in {} is of version {version}; this program reads version {known}", path.display())]
    MapVersion {
        /// The folder.
        path: PathBuf,
        /// The map's version.
        version: u32,
        /// The newest version that can be read.
        known: u32,
    },
    /// A file of a map is not what was written.
    #[error("{} is damaged: {what}", path.display())]
    MapDamaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// A recording does not belong to a map.
    #[error("the map in {} cannot go on with this recording: {what}", path.display())]
    NotOfMap {
        /// The map's folder.
        path: PathBuf,
        /// How the recording differs.
        what: String,
    },
    /// The output folder holds something else, or is in use.
    #[error("output folder {0}")]
    Refused(#[source] FolderError),
    /// A result could not be written; the others were.
    #[error("{source}; the other results are in {}{}", saved.display(), kept_in_words(kept))]
    Incomplete {
        /// The first error.
        source: Box<RunError>,
        /// Where the other results are.
        saved: PathBuf,
        /// The folder of earlier results that were therefore not replaced.
        kept: Option<PathBuf>,
    },
    /// There is nothing to export.
    #[error("the run's map is empty")]
    EmptyMap,
    /// A finished run does not say what its camera was.
    #[error("{} names no camera", path.display())]
    NoCamera {
        /// The run's settings.
        path: PathBuf,
    },
    /// An export would replace one of the run's own files.
    #[error("{} belongs to the run", path.display())]
    BelongsToRun {
        /// The file.
        path: PathBuf,
    },
    /// The side of a voxel, in metres, is not possible.
    #[error("a voxel of {0} m: a length of 0.001 to 1 m is expected")]
    VoxelSize(f64),
    /// An export failed, or was stopped.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// A file cannot be read or is damaged.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

fn kept_in_words(kept: &Option<PathBuf>) -> String {
    let kept = kept.as_ref();
    kept.map_or(String::new(), |kept| {
        format!(", the earlier ones in {} are as they were", kept.display())
    })
}

impl From<FolderError> for RunError {
    fn from(error: FolderError) -> Self {
        match error {
            FolderError::Io { folder, source } => Self::OutputFolder {
                path: folder,
                source,
            },
            refused => Self::Refused(refused),
        }
    }
}

impl RunError {
    /// Whether this is a usage error: what was asked for, a settings file or a camera file has to be
    /// corrected, and trying again without that is pointless.
    pub fn is_usage(&self) -> bool {
        match self {
            Self::Settings { .. }
            | Self::Assignment { .. }
            | Self::Frames { .. }
            | Self::NotLive(_)
            | Self::Camera(_)
            | Self::NoDevice(_)
            | Self::UnknownRecording { .. }
            | Self::OtherRecording { .. }
            | Self::NotARun { .. }
            | Self::NoMap { .. }
            | Self::MergesInto { .. }
            | Self::NotOfMap { .. }
            | Self::BelongsToRun { .. }
            | Self::VoxelSize(_) => true,
            Self::Refused(error) => !matches!(error, FolderError::Busy(_)),
            Self::Read { source, .. } => source.kind() == io::ErrorKind::InvalidInput,
            Self::Data(error) => error.is_usage(),
            Self::Slam(error) => matches!(error, SlamError::Setting(_)),
            Self::RecordingOfRun(error) => error.is_usage(),
            _ => false,
        }
    }
}
