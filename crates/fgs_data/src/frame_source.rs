//! Where a recording's images come from, when they are not files of a plain folder.

use fgs_geom::Image;

use crate::{CameraFile, DataError, Format, Trajectory};

/// The images of one frame: both of the recording's camera's size.
pub struct FrameImages {
    /// Colour, as the lens drew it.
    pub color: Image<[u8; 3]>,
    /// Depth registered to it, metres; 0 means none.
    pub depth_m: Image<f32>,
    /// Which pixels the colour camera saw; `None` if all.
    pub color_valid: Option<Image<bool>>,
}

/// Gives a recording's images, in any order and to several threads at once.
pub trait FrameSource: Send + Sync {
    /// The images of the frame at `index`, from 0 to the number of time stamps less 1.
    ///
    /// # Errors
    /// If they cannot be read.
    fn read(&self, index: usize) -> Result<FrameImages, DataError>;
}

/// A recording of another program's format, opened; see [`Dataset::from_source`](crate::Dataset::from_source).
pub struct SourcedRecording {
    /// What it is.
    pub format: Format,
    /// The camera of all its frames.
    pub camera: CameraFile,
    /// The frames' times, seconds, strictly increasing, at least one.
    pub timestamps: Vec<f64>,
    /// The images.
    pub source: Box<dyn FrameSource>,
    /// The device's own poses `world_from_camera` at exactly the frames' times, or why they cannot be
    /// used.
    pub device_poses: Result<Option<Trajectory>, DataError>,
}
