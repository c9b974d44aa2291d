//! The layouts of recordings on disk: detection, and one reader per layout.
//!
//! A reader turns a folder into a [`Recording`]: file names, timestamps and ground-truth poses. It
//! opens no image and does not know the camera.

mod folders;
mod poses;
mod replica;
mod seven_scenes;
mod tum;

use std::fmt;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use fgs_files::{check_regular, is_present};

use crate::{DataError, PoseOrigin, Trajectory};

/// Layouts without time stamps are given those of a sensor of this rate, frames a second: the one
/// of the sensors and renderings that these layouts hold.
const FRAME_RATE_HZ: f64 = 30.0;

/// How a recording is laid out: in a plain folder, which this crate reads, or as another program writes
/// it, which crate `fgs_recordings` reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// TUM RGB-D: `rgb.txt` and `depth.txt`, or `associations.txt`; optionally `groundtruth.txt`.
    Tum,
    /// Replica as rendered by NICE-SLAM: `results/frame*.jpg`, `results/depth*.png`; optionally
    /// `traj.txt`.
    Replica,
    /// 7-Scenes: `frame-*.color.png`, `frame-*.depth.png`; optionally `frame-*.pose.txt`.
    SevenScenes,
    /// A folder `rgb`, `color`, `image` or `images` and a folder `depth`, paired in natural order
    /// of their file names; optionally `traj.txt` or `groundtruth.txt`.
    Folders,
    /// Record3D's `.r3d`, or the folder in it.
    Record3d,
    /// Stray Scanner's folder.
    StrayScanner,
    /// A ROS 2 bag in MCAP.
    Mcap,
    /// nerfstudio's `transforms.json` with depth images.
    Nerfstudio,
    /// Polycam's raw data.
    Polycam,
    /// COLMAP's model with depth images.
    Colmap,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Tum => "TUM RGB-D",
            Self::Replica => "Replica",
            Self::SevenScenes => "7-Scenes",
            Self::Folders => "folders",
            Self::Record3d => "Record3D",
            Self::StrayScanner => "Stray Scanner",
            Self::Mcap => "ROS 2 bag (MCAP)",
            Self::Nerfstudio => "nerfstudio",
            Self::Polycam => "Polycam",
            Self::Colmap => "COLMAP",
        })
    }
}

/// What a folder holds. There is at least one frame, and times are strictly increasing.
pub(crate) struct Recording {
    pub frames: Vec<FrameFiles>,
    /// The known poses at exactly the frames' times, or why they cannot be used.
    pub ground_truth: Result<Option<Trajectory>, DataError>,
    /// Whether they are the truth.
    pub pose_origin: PoseOrigin,
    /// The value in depth images that means "none", besides 0.
    pub no_depth: u16,
}

/// One frame's files.
#[derive(Clone)]
pub(crate) struct FrameFiles {
    pub timestamp_secs: f64,
    pub color: PathBuf,
    pub depth: PathBuf,
}

impl Format {
    /// The plain layout of a folder, by the names in it.
    pub(crate) fn of(folder: &Path) -> Result<Self, DataError> {
        if !folder.is_dir() {
            return Err(match check_regular(folder) {
                Ok(()) => DataError::NotAFolder(folder.into()),
                Err(error) if error.kind() == ErrorKind::NotFound => {
                    DataError::NoSuchFolder(folder.into())
                }
                // Says what it is, a link that leads nowhere for example.
                Err(source) => DataError::Io {
                    path: folder.into(),
                    source,
                },
            });
        }
        let has = |name: &str| is_present(&folder.join(name));
        if has("rgb.txt") || has("depth.txt") || has("associations.txt") {
            Ok(Self::Tum)
        } else if has("results") {
            Ok(Self::Replica)
        } else if seven_scenes::is_laid_out_so(folder)? {
            Ok(Self::SevenScenes)
        } else if folders::color_folder(folder).is_some() && has("depth") {
            Ok(Self::Folders)
        } else {
            Err(DataError::UnknownFormat(folder.into()))
        }
    }

    /// Lists a folder of this layout. `max_difference_secs` is the most that the times of a colour
    /// image and its depth image differ, where a layout has both.
    pub(crate) fn list(
        self,
        folder: &Path,
        max_difference_secs: f64,
    ) -> Result<Recording, DataError> {
        match self {
            Self::Tum => tum::list(folder, max_difference_secs),
            Self::Replica => replica::list(folder),
            Self::SevenScenes => seven_scenes::list(folder),
            Self::Folders => folders::list(folder),
            _ => Err(DataError::UnknownFormat(folder.into())),
        }
    }
}

/// Frames at the default rate from pairs of (colour, depth) files that exist.
fn frames_at_default_rate(
    pairs: impl IntoIterator<Item = (PathBuf, PathBuf)>,
) -> Result<Vec<FrameFiles>, DataError> {
    let frame = |(index, (color, depth)): (usize, (PathBuf, PathBuf))| {
        if !is_present(&depth) {
            return Err(DataError::NoDepth { color, depth });
        }
        Ok(FrameFiles {
            timestamp_secs: index as f64 / FRAME_RATE_HZ,
            color,
            depth,
        })
    };
    pairs.into_iter().enumerate().map(frame).collect()
}

/// The error for two files whose times, in seconds and increasing, have nothing in common.
fn no_overlap(first: (&Path, &[f64]), second: (&Path, &[f64])) -> DataError {
    let span = |times: &[f64]| Some((*times.first()?, *times.last()?));
    let empty = |path: &Path| DataError::Empty {
        path: path.into(),
        what: "time stamp",
    };
    match (span(first.1), span(second.1)) {
        (Some(first_span_secs), Some(second_span_secs)) => DataError::NoOverlap {
            first: first.0.into(),
            first_span_secs,
            second: second.0.into(),
            second_span_secs,
        },
        (None, _) => empty(first.0),
        (_, None) => empty(second.0),
    }
}
