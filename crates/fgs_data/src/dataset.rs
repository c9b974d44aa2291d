//! A recording: the folder opened, its frames and what is known about them.
//!
//! Opening reads the lists and poses and finds the camera; images are read frame by frame.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use fgs_geom::{Camera, RgbdFrame};

use crate::formats::FrameFiles;
use crate::frame_loader::FrameLoader;
use crate::{CameraFile, DataError, Format, FrameStream, Trajectory, images};

/// How to open a recording.
#[derive(Clone, Debug)]
pub struct OpenOptions {
    /// The camera; `None` takes the one found beside the recording.
    pub camera: Option<CameraFile>,
    /// The most that the times of a colour image and its depth image may differ, where a recording
    /// stamps both.
    pub max_time_difference_secs: f64,
}

impl Default for OpenOptions {
    /// The camera beside the recording, and 0.02 s: more than half the period of a 30 Hz sensor,
    /// so that no image is left without a partner, and less than a whole one.
    fn default() -> Self {
        Self {
            camera: None,
            max_time_difference_secs: 0.02,
        }
    }
}

/// An RGB-D recording on disk.
pub struct Dataset {
    format: Format,
    loader: Arc<FrameLoader>,
    camera_file: CameraFile,
    ground_truth: Option<Trajectory>,
}

impl Dataset {
    /// Opens a folder in one of the four layouts of [`Format`]. The camera is the one in `options`,
    /// else `camera.toml` in the folder, else Replica's `cam_params.json` in or above it.
    ///
    /// # Errors
    /// The folder has no known layout, a list or pose file is damaged or contradicts another, or
    /// no camera is known. Damaged images show when their frame is read.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DataError> {
        let format = Format::of(path)?;
        let recording = format.list(path, options.max_time_difference_secs)?;
        let camera = match &options.camera {
            Some(camera) => camera.clone(),
            None => find_camera(path, format, &recording.frames)?,
        };
        Ok(Self {
            format,
            loader: Arc::new(FrameLoader::new(
                recording.frames,
                recording.no_depth,
                &camera,
            )),
            camera_file: camera,
            ground_truth: recording.ground_truth,
        })
    }

    /// The layout found.
    pub fn format(&self) -> Format {
        self.format
    }

    /// The pinhole camera of every frame.
    pub fn camera(&self) -> &Camera {
        self.loader.camera()
    }

    /// The camera as given or found: with the lens and the unit of depth.
    pub fn camera_file(&self) -> &CameraFile {
        &self.camera_file
    }

    /// How many frames there are: at least one.
    #[expect(
        clippy::len_without_is_empty,
        reason = "an empty recording cannot be opened"
    )]
    pub fn len(&self) -> usize {
        self.loader.frames().len()
    }

    /// The time of each frame, seconds, strictly increasing. Layouts without time stamps have 30
    /// frames a second, from 0.
    pub fn timestamps(&self) -> impl ExactSizeIterator<Item = f64> {
        self.loader
            .frames()
            .iter()
            .map(|frame| frame.timestamp_secs)
    }

    /// The known poses, at exactly the times of their frames ([`Trajectory::at`]). Some frames may
    /// have none; `None` if no frame has one.
    pub fn ground_truth(&self) -> Option<&Trajectory> {
        self.ground_truth.as_ref()
    }

    /// Reads one frame.
    ///
    /// # Errors
    /// There is no such frame, or one of its images cannot be decoded, is of another size than the
    /// camera's, or is no 8-bit colour or 16-bit depth image.
    pub fn frame(&self, index: usize) -> Result<RgbdFrame, DataError> {
        self.loader.load(index)
    }

    /// The frames of a range, cut to the recording, in order and decoded ahead. A frame with an
    /// error is an `Err` item, and the stream goes on behind it.
    pub fn frames(&self, range: Range<usize>) -> FrameStream {
        FrameStream::new(&self.loader, range.start..range.end.min(self.len()))
    }
}

/// The camera beside a recording.
fn find_camera(
    folder: &Path,
    format: Format,
    frames: &[FrameFiles],
) -> Result<CameraFile, DataError> {
    let path = folder.join("camera.toml");
    if path.exists() {
        return CameraFile::read(&path);
    }
    if format == Format::Replica {
        for place in [folder.to_path_buf(), folder.join("..")] {
            let path = place.join("cam_params.json");
            if path.exists() {
                return CameraFile::read_replica(&path);
            }
        }
    }
    let first = frames.first().ok_or_else(|| DataError::Empty {
        path: folder.into(),
        what: "frame",
    })?;
    let (width, height) = images::read_size(&first.color)?;
    Err(DataError::NoCamera {
        folder: folder.into(),
        width,
        height,
    })
}
