//! What can be wrong with a recording. Every message names the file, and the line or key in it.

use std::path::PathBuf;

use fgs_geom::CameraError;
use thiserror::Error;

/// Why a recording, one of its frames, a camera file or a trajectory file is refused.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DataError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A recording is a folder.
    #[error("{} is not a folder", .0.display())]
    NotAFolder(PathBuf),
    /// None of the four layouts.
    #[error(
        "{} holds no recording: expected rgb.txt and depth.txt (TUM), results/ (Replica), \
         frame-*.color.png (7-Scenes), or the folders rgb/ and depth/", .0.display()
    )]
    UnknownFormat(PathBuf),
    /// One of the two lists of a TUM recording is absent.
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
    /// A line of a text file.
    #[error("{}:{line}: {fault}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong with it.
        fault: LineFault,
    },
    /// Two sets of time stamps that should overlap do not.
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
    /// Two things that belong together one to one differ in number.
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
    /// No camera is given and none is found. The message is a camera file to be completed.
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
    /// A camera file that cannot be understood.
    #[error("{}{}: {message}", path.display(), line.map(|line| format!(":{line}")).unwrap_or_default())]
    CameraFile {
        /// The file.
        path: PathBuf,
        /// The line, from 1, where one is to blame.
        line: Option<usize>,
        /// What is wrong, with the key.
        message: String,
    },
    /// A camera file with a value that no camera has.
    #[error("{}: {source}", path.display())]
    Camera {
        /// The file.
        path: PathBuf,
        /// The key, its value and what was expected.
        source: CameraError,
    },
    /// An image that cannot be decoded.
    #[error("{}: {source}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// Why.
        source: image::ImageError,
    },
    /// A JPEG file that ends before its last pixel.
    #[error("{}: the JPEG image is cut short", .0.display())]
    Truncated(PathBuf),
    /// A file too large for an image.
    #[error("{} is no image: it has more than {max_bytes} bytes", path.display())]
    FileSize {
        /// The file.
        path: PathBuf,
        /// The most that is read.
        max_bytes: u64,
    },
    /// A colour or depth image of another size than the camera's.
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
    /// A colour image that is not 8 bits a channel.
    #[error("{}: colour must have 8 bits a channel, not {bits}", path.display())]
    ColorBits {
        /// The file.
        path: PathBuf,
        /// Its bits a channel.
        bits: u16,
    },
    /// A depth image that is not 16-bit grey.
    #[error(
        "{}: depth must be one channel of 16 bits, not {channels} of {bits}", path.display()
    )]
    DepthBits {
        /// The file.
        path: PathBuf,
        /// Its channels.
        channels: u8,
        /// Its bits a channel.
        bits: u16,
    },
    /// A pose that no trajectory can hold.
    #[error("pose {index}: {fault}")]
    Pose {
        /// Where it stands, from 0.
        index: usize,
        /// What is wrong with it.
        fault: LineFault,
    },
    /// A frame that the recording does not have.
    #[error("there is no frame {index}: the recording has {len}")]
    NoSuchFrame {
        /// The frame asked for.
        index: usize,
        /// The recording's length.
        len: usize,
    },
    /// The decoder thread of this frame is gone.
    #[error("frame {0}: its decoder thread ended")]
    DecoderGone(usize),
}

/// What is wrong with one line of a text file.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LineFault {
    /// Longer than any line of these formats.
    #[error("the line is longer than {0} bytes")]
    TooLong(usize),
    /// Not UTF-8.
    #[error("the line is not text")]
    NotText,
    /// Too few or too many columns.
    #[error("expected {expected} columns, found {found}")]
    Columns {
        /// As many as there should be.
        expected: usize,
        /// As many as there are.
        found: usize,
    },
    /// A column that should be a number.
    #[error("'{0}' is not a finite number")]
    NotANumber(String),
    /// Time stands still or runs backwards.
    #[error("time stamp {current} does not come after {previous}")]
    NotIncreasing {
        /// The time stamp before, seconds.
        previous: f64,
        /// This one, seconds.
        current: f64,
    },
    /// A quaternion that is no rotation.
    #[error("the quaternion's length is {0}, not 1")]
    Quaternion(f64),
    /// A matrix that is no rigid transform.
    #[error("the matrix is no rigid transform: a rotation, a translation, and 0 0 0 1 below")]
    Matrix,
    /// A position or time stamp beyond everything plausible, or not finite.
    #[error("{0} is out of range")]
    OutOfRange(f64),
    /// A file named by a list is not there.
    #[error("{} does not exist", .0.display())]
    AbsentFile(PathBuf),
}
