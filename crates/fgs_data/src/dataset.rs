//! A recording on disk: its camera, timestamps, ground truth and frames.
//!
//! Opening reads the file lists and poses and finds the camera; images are decoded frame by frame.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use fgs_files::is_present;
use fgs_geom::{Camera, CameraError, RgbdFrame};

use crate::formats::FrameFiles;
use crate::frame_loader::FrameLoader;
use crate::{CameraFile, DataError, Format, FrameStream, SensorTimes, Trajectory, images};

/// How to open a recording.
#[derive(Clone, Debug)]
pub struct OpenOptions {
    /// The camera; `None` to use the one stored with the recording.
    pub camera: Option<CameraFile>,
    /// Largest time difference between a colour image and its depth image, seconds, for recordings
    /// that stamp both.
    pub max_time_difference_secs: f64,
}

impl Default for OpenOptions {
    /// The camera stored with the recording, and 0.02 s: more than half the period of a 30 Hz
    /// sensor, so that every image finds a partner, and less than a full period.
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
    ground_truth: Result<Option<Trajectory>, DataError>,
}

impl Dataset {
    /// Opens a folder in one of the four layouts of [`Format`]. The camera is taken from `options`,
    /// else from `camera.toml` in the folder, else from Replica's `cam_params.json` in the folder
    /// or its parent.
    ///
    /// # Errors
    /// If the layout is unknown, a list is malformed or inconsistent with another, or no camera is
    /// found. Damaged images are only noticed when their frame is read.
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

    /// The detected layout.
    pub fn format(&self) -> Format {
        self.format
    }

    /// The pinhole camera of every frame.
    pub fn camera(&self) -> &Camera {
        self.loader.camera()
    }

    /// The camera as given or found, with lens distortion and depth unit.
    pub fn camera_file(&self) -> &CameraFile {
        &self.camera_file
    }

    /// Says when the sensors take their images, in place of what the camera file says.
    ///
    /// # Errors
    /// If a time is out of range; see [`CameraFile::with_sensor_times`].
    pub fn set_sensor_times(&mut self, times: SensorTimes) -> Result<(), CameraError> {
        self.camera_file = self.camera_file.clone().with_sensor_times(times)?;
        Arc::make_mut(&mut self.loader).set_times(&self.camera_file);
        Ok(())
    }

    /// Number of frames, at least 1.
    #[expect(
        clippy::len_without_is_empty,
        reason = "an empty recording cannot be opened"
    )]
    pub fn len(&self) -> usize {
        self.loader.frames().len()
    }

    /// Timestamp of each frame, seconds, strictly increasing. Layouts without timestamps get 30
    /// frames per second, starting at 0.
    pub fn timestamps(&self) -> impl ExactSizeIterator<Item = f64> {
        self.loader
            .frames()
            .iter()
            .map(|frame| frame.timestamp_secs)
    }

    /// Ground-truth poses, at exactly the timestamps of their frames (see [`Trajectory::at`]). Some
    /// frames may lack one; `None` if all do.
    pub fn ground_truth(&self) -> Option<&Trajectory> {
        self.ground_truth.as_ref().ok()?.as_ref()
    }

    /// Why the recording's poses cannot be used, if it has any. Everything else can.
    pub fn ground_truth_error(&self) -> Option<&DataError> {
        self.ground_truth.as_ref().err()
    }

    /// Reads one frame.
    ///
    /// # Errors
    /// If there is no such frame, or one of its images cannot be decoded, does not have the
    /// camera's size, or is not an 8-bit colour or 16-bit depth image.
    pub fn frame(&self, index: usize) -> Result<RgbdFrame, DataError> {
        self.loader.load(index)
    }

    /// The frames of a range, clipped to the recording, in order and prefetched. A frame that
    /// cannot be read is an `Err` item, and the stream continues with the next one.
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
    if is_present(&path) {
        return CameraFile::read(&path);
    }
    if format == Format::Replica {
        for place in [folder.to_path_buf(), folder.join("..")] {
            let path = place.join("cam_params.json");
            if is_present(&path) {
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
