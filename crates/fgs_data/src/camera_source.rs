//! The seam to live cameras: whatever delivers images implements [`CameraSource`].

use crate::{CameraFile, DataError, FrameImages};

/// The images of one moment.
pub struct LiveImages {
    /// When the colour image was taken, seconds on the camera's clock.
    pub timestamp_secs: f64,
    /// Both images, as the lens drew them.
    pub images: FrameImages,
}

/// A camera at work.
pub trait CameraSource: Send {
    /// The camera of all its images. Depth is registered to it and in metres, whatever the file's scale.
    fn camera_file(&self) -> &CameraFile;

    /// Waits for the next images; `None` once none will come any more. What it is too slow to hand over
    /// is its own to drop: it gives the newest.
    fn next_images(&mut self) -> Option<Result<LiveImages, DataError>>;
}
