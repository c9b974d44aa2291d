//! Errors of reading a recording. Every message names the file, and the line or key in it.

use std::path::PathBuf;

use fgs_geom::{CameraError, FrameError, Number};
use thiserror::Error;

/// Why a recording, a frame, a camera file or a trajectory file cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DataError {
    /// The operating system reported an error.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The path of a recording leads nowhere.
    #[error("{} does not exist", .0.display())]
    NoSuchFolder(PathBuf),
    /// The path of a recording is not a folder.
    #[error("{} is not a folder", .0.display())]
    NotAFolder(PathBuf),
    /// The folder has none of the four layouts.
    #[error(
        "{} holds no recording: expected rgb.txt and depth.txt (TUM), results/ (Replica), \
         frame-*.color.png (7-Scenes), or the folders rgb/ and depth/", .0.display()
    )]
    UnknownFormat(PathBuf),
    /// One of the two file lists of a TUM recording is missing.
    #[error("{} is missing: a TUM recording needs rgb.txt and depth.txt", .0.display())]
    MissingList(PathBuf),
    /// A list or folder without a single frame.
    #[error("{} holds no {what}", path.display())]
    Empty {
        /// The list or folder.
        path: PathBuf,
        /// What was looked for.
        what: &'static str,
    },
    /// A malformed line of a text file.
    #[error("{}:{line}: {fault}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong with it.
        fault: LineFault,
    },
    /// Two sets of timestamps that should overlap do not.
    #[error(
        "nothing in {} ({:.3} to {:.3} s) is close in time to anything in {} ({:.3} to {:.3} s)",
        first.display(), first_span_secs.0, first_span_secs.1,
        second.display(), second_span_secs.0, second_span_secs.1
    )]
    NoOverlap {
        /// The one file or folder.
        first: PathBuf,
        /// Its first and last time stamp.
        first_span_secs: (f64, f64),
        /// The other.
        second: PathBuf,
        /// Its first and last time stamp.
        second_span_secs: (f64, f64),
    },
    /// A colour image without its depth image.
    #[error("{} has no depth image {}", color.display(), depth.display())]
    NoDepth {
        /// The colour image.
        color: PathBuf,
        /// The file that should be there.
        depth: PathBuf,
    },
    /// An image whose number no image of the other kind has.
    #[error("{} has no partner: no image in {} has its number", image.display(), folder.display())]
    NoPartner {
        /// The image.
        image: PathBuf,
        /// The folder of the other kind.
        folder: PathBuf,
    },
    /// Two lists that should correspond one to one differ in length.
    #[error("{} holds {count}, but {} holds {other_count}", path.display(), other.display())]
    CountMismatch {
        /// The one file or folder.
        path: PathBuf,
        /// How many it holds.
        count: usize,
        /// The other.
        other: PathBuf,
        /// How many that holds.
        other_count: usize,
    },
    /// No camera was given and none was found. The message is a template for a camera file.
    #[error(
        "no camera is known for {folder}: write {folder}/camera.toml with these lines\n\
         width = {width}\nheight = {height}\n\
         fx = ?              # focal lengths, pixels\nfy = ?\n\
         cx = ?              # principal point, pixels; the first pixel's centre is 0\ncy = ?\n\
         depth_scale = ?     # value in the depth images that means 1 metre\n\
         distortion = [0.0, 0.0, 0.0, 0.0, 0.0] # k1, k2, p1, p2, k3; may be left out",
        folder = folder.display()
    )]
    NoCamera {
        /// The recording.
        folder: PathBuf,
        /// Columns of its first colour image.
        width: u32,
        /// Rows of its first colour image.
        height: u32,
    },
    /// A camera file that cannot be parsed.
    #[error("{}{}: {message}", path.display(), line.map(|line| format!(":{line}")).unwrap_or_default())]
    CameraFile {
        /// The file.
        path: PathBuf,
        /// The line, from 1, where one is to blame.
        line: Option<usize>,
        /// What is wrong, with the key.
        message: String,
    },
    /// A camera file with a parameter out of range.
    #[error("{}: {source}", path.display())]
    Camera {
        /// The file.
        path: PathBuf,
        /// The key, its value and what was expected.
        source: CameraError,
    },
    /// A recording in another program's format that cannot be used.
    #[error("{}: {message}", path.display())]
    Recording {
        /// The file, or the one in it.
        path: PathBuf,
        /// What is wrong, in plain words.
        message: String,
    },
    /// A path that holds no recording of any known kind.
    #[error(
        "{} holds no recording that is understood: a folder with rgb.txt and depth.txt (TUM), results/ \
         (Replica), frame-*.color.png (7-Scenes), or rgb/ and depth/; a Record3D file (.r3d); a Stray \
         Scanner folder (odometry.csv); a ROS 2 bag in MCAP; transforms.json with depth images \
         (nerfstudio); Polycam's raw data (keyframes/); or a COLMAP model with depth images", .0.display()
    )]
    UnknownRecording(PathBuf),
    /// An image that cannot be decoded.
    #[error("{}: {message}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// The decoder's message.
        message: String,
    },
    /// A JPEG file that ends before its last pixel.
    #[error("{}: the JPEG image is cut short", .0.display())]
    Truncated(PathBuf),
    /// An image whose name is not UTF-8.
    #[error("{:?}: the file's name is not UTF-8: rename it", .0)]
    NotUtf8(PathBuf),
    /// A text file longer than any of its kind.
    #[error("{} is longer than {max_bytes} bytes", path.display())]
    FileTooLong {
        /// The file.
        path: PathBuf,
        /// The most that is read.
        max_bytes: u64,
    },
    /// A file too large to be an image.
    #[error("{} is no image: it has more than {max_bytes} bytes", path.display())]
    FileSize {
        /// The file.
        path: PathBuf,
        /// The most that is read.
        max_bytes: u64,
    },
    /// A colour or depth image without the camera's size.
    #[error(
        "{} is {width}x{height}, but the camera is {camera_width}x{camera_height}: colour, and \
         depth registered to it, must both have the camera's size", path.display()
    )]
    ImageSize {
        /// The file.
        path: PathBuf,
        /// Its columns.
        width: u32,
        /// Its rows.
        height: u32,
        /// The camera's columns.
        camera_width: usize,
        /// The camera's rows.
        camera_height: usize,
    },
    /// A colour image without 8 bits per channel.
    #[error("{}: colour must have 8 bits a channel, not {bits}", path.display())]
    ColorBits {
        /// The file.
        path: PathBuf,
        /// Its bits per channel.
        bits: u16,
    },
    /// A depth image that is not 16-bit greyscale.
    #[error(
        "{}: depth must be one channel of 16 bits, not {channels} of {bits}", path.display()
    )]
    DepthBits {
        /// The file.
        path: PathBuf,
        /// Its channels.
        channels: u8,
        /// Its bits per channel.
        bits: u16,
    },
    /// An invalid pose in a trajectory.
    #[error("pose {index}: {fault}")]
    Pose {
        /// Its position in the trajectory, from 0.
        index: usize,
        /// What is wrong with it.
        fault: LineFault,
    },
    /// Images and camera that do not make a frame.
    #[error("frame {index}: {source}")]
    Frame {
        /// Its position in the recording, from 0.
        index: usize,
        /// Why.
        source: FrameError,
    },
    /// A frame index beyond the end of the recording.
    #[error("there is no frame {index}: the recording has {len}")]
    NoSuchFrame {
        /// The requested frame.
        index: usize,
        /// Number of frames.
        len: usize,
    },
    /// Decoding a frame panicked, which is a bug.
    #[error("frame {0}: the decoder panicked")]
    DecoderPanicked(usize),
}

impl DataError {
    /// Whether something else has to be named, or a camera file written: trying again without that is
    /// pointless.
    pub fn is_usage(&self) -> bool {
        match self {
            Self::CameraFile { .. }
            | Self::Camera { .. }
            | Self::NoCamera { .. }
            | Self::NoSuchFolder(_)
            | Self::NotAFolder(_)
            | Self::NotUtf8(_)
            | Self::UnknownFormat(_)
            | Self::UnknownRecording(_) => true,
            Self::Line { fault, .. } => *fault == LineFault::Utf16,
            Self::Io { source, .. } => source.kind() == std::io::ErrorKind::InvalidInput,
            _ => false,
        }
    }
}

/// What is wrong with a line of a text file, or with a pose.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum LineFault {
    /// Longer than any line of these formats can be.
    #[error("the line is longer than {0} bytes")]
    TooLong(usize),
    /// Two bytes a character.
    #[error("the file is UTF-16 text: save it as UTF-8")]
    Utf16,
    /// Not UTF-8.
    #[error("the line is not text")]
    NotText,
    /// Too few or too many columns.
    #[error("expected {expected} columns, found {found}")]
    Columns {
        /// Number required.
        expected: usize,
        /// Number found.
        found: usize,
    },
    /// A column that is not a finite number.
    #[error("'{0}' is not a finite number")]
    NotANumber(String),
    /// A timestamp not later than the previous one.
    #[error("time stamp {} does not come after {}", Number(*.current), Number(*.previous))]
    NotIncreasing {
        /// The previous timestamp, seconds.
        previous: f64,
        /// This timestamp, seconds.
        current: f64,
    },
    /// A quaternion whose length is not 1.
    #[error("the quaternion's length is {}, not 1", Number(*.0))]
    Quaternion(f64),
    /// A matrix that is not a rigid transform.
    #[error("the matrix is no rigid transform: a rotation, a translation, and 0 0 0 1 below")]
    Matrix,
    /// A position or timestamp that is implausibly large or not finite.
    #[error("{} is out of range", Number(*.0))]
    OutOfRange(f64),
    /// A listed file that does not exist.
    #[error("{} does not exist", .0.display())]
    AbsentFile(PathBuf),
    /// What is listed is no file.
    #[error("{} {what}", path.display())]
    NotAFile {
        /// The path.
        path: PathBuf,
        /// What it is.
        what: String,
    },
}
