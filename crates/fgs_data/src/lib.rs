//! RGB-D recordings on disk, read as a stream of frames, and trajectory files.
//!
//! Input: a folder in one of four plain layouts of [`Format`], or a [`FrameSource`] for the other
//! programs' formats (crate `fgs_recordings`). A live camera is a [`CameraSource`]. Output: undistorted
//! [`fgs_geom::RgbdFrame`]s with depth in metres, in order, prefetched on decoder threads.
//!
//! Invariant: everything specific to a data set (layout, depth unit, quaternion order) stays inside
//! this crate; nothing downstream can tell where a frame came from.
//!
//! ```no_run
//! use fgs_data::{Dataset, OpenOptions};
//!
//! let dataset = Dataset::open("recordings/desk".as_ref(), &OpenOptions::default())?;
//! for frame in dataset.frames(0..dataset.len()) {
//!     let frame = frame?;
//!     println!("{} s: {} columns", frame.timestamp_secs, frame.camera.width);
//! }
//! # Ok::<(), fgs_data::DataError>(())
//! ```

mod association;
mod camera_file;
mod camera_source;
mod dataset;
mod error;
mod formats;
mod frame_loader;
mod frame_maker;
mod frame_source;
mod frame_stream;
mod images;
mod lines;
mod natural_order;
mod plain_words;
mod pose_origin;
mod sensor_times;
mod trajectory;

pub use association::associate;
pub use camera_file::CameraFile;
pub use camera_source::{CameraSource, LiveImages};
pub use dataset::{Dataset, OpenOptions};
pub use error::{DataError, LineFault};
pub use formats::Format;
pub use frame_maker::FrameMaker;
pub use frame_source::{FrameImages, FrameSource, SourcedRecording};
pub use frame_stream::FrameStream;
pub use images::{decode_color, decode_depth, image_size};
pub use natural_order::natural_order;
pub use plain_words::plain_words;
pub use pose_origin::PoseOrigin;
pub use sensor_times::SensorTimes;
pub use trajectory::{StampedPose, Trajectory};
