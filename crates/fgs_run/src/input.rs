//! Where a run's frames come from: a recording, or a live camera.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use fgs_data::{CameraFile, CameraSource, DataError, Dataset, FrameMaker};
use fgs_geom::{Camera, FrameIndex, RgbdFrame};

/// Where the frames come from.
pub enum Input {
    /// A recording, whose frames can be read again.
    Recording(Dataset),
    /// A camera, whose frames come once.
    Camera(LiveCamera),
}

impl Input {
    /// The camera of all frames.
    pub fn camera(&self) -> &Camera {
        match self {
            Self::Recording(dataset) => dataset.camera(),
            Self::Camera(live) => live.maker.camera(),
        }
    }
}

/// A camera at work, with the camera file that applies to its images.
pub struct LiveCamera {
    maker: FrameMaker,
    /// Until the run takes it.
    source: Mutex<Option<Box<dyn CameraSource>>>,
}

impl LiveCamera {
    /// `file` takes the place of the camera's own.
    ///
    /// # Errors
    /// If it is of another size than the images. `name` is the camera's, for the message.
    pub(crate) fn new(
        name: &str,
        source: Box<dyn CameraSource>,
        file: &CameraFile,
    ) -> Result<Self, DataError> {
        let (own, camera) = (source.camera_file().camera(), file.camera());
        if (own.width, own.height) != (camera.width, camera.height) {
            return Err(DataError::ImageSize {
                path: name.into(),
                width: own.width as u32,
                height: own.height as u32,
                camera_width: camera.width,
                camera_height: camera.height,
            });
        }
        Ok(Self {
            maker: FrameMaker::new(file),
            source: Mutex::new(Some(source)),
        })
    }

    /// The next `limit` frames, as `fgs_slam` takes them from a live source; none if they were taken before.
    /// Their numbers are left to who takes them. `path` is the camera's, for messages.
    pub(crate) fn frames(
        &self,
        limit: usize,
        path: PathBuf,
    ) -> impl FnMut() -> Option<Result<RgbdFrame, DataError>> + Send + use<> {
        let maker = self.maker.clone();
        let mut source = self
            .source
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let (mut left, mut last_secs) = (limit, f64::NEG_INFINITY);
        move || {
            left = left.checked_sub(1)?;
            let fault = |message| DataError::Recording {
                path: path.clone(),
                message,
            };
            Some(source.as_mut()?.next_images()?.and_then(|next| {
                let secs = next.timestamp_secs;
                if secs <= last_secs {
                    return Err(fault(format!("{secs} s comes after {last_secs} s")));
                }
                let frame = maker.frame(FrameIndex(0), secs, next.images);
                let frame = frame.map_err(|error| fault(error.to_string()))?;
                last_secs = secs;
                Ok(frame)
            }))
        }
    }
}
