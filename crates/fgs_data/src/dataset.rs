//! A recording on disk: its camera, timestamps, ground truth and frames.
//!
//! Opening reads the file lists and poses and finds the camera; images are decoded frame by frame.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use fgs_files::is_present;
use fgs_geom::{Camera, CameraError, RgbdFrame};

use crate::formats::FrameFiles;
use crate::frame_loader::{FrameFilesSource, FrameLoader};
use crate::{
    CameraFile, DataError, Format, FrameImages, FrameStream, PoseOrigin, SensorTimes,
    SourcedRecording, Trajectory, images,
};

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
    pose_origin: PoseOrigin,
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
        let timestamps = recording.frames.iter().map(|frame| frame.timestamp_secs);
        let timestamps: Arc<[f64]> = timestamps.collect();
        let source = FrameFilesSource {
            frames: recording.frames,
            camera: *camera.camera(),
            depth_scale: camera.depth_scale() as f32,
            no_depth: recording.no_depth,
        };
        let loader = FrameLoader::new(Arc::new(source), timestamps, &camera);
        let (poses, origin) = (recording.ground_truth, recording.pose_origin);
        Ok(Self::new(format, loader, camera, poses, origin))
    }

    fn new(
        format: Format,
        mut loader: FrameLoader,
        camera_file: CameraFile,
        ground_truth: Result<Option<Trajectory>, DataError>,
        pose_origin: PoseOrigin,
    ) -> Self {
        if pose_origin == PoseOrigin::Device
            && let Ok(Some(poses)) = &ground_truth
        {
            loader = loader.with_device_poses(poses);
        }
        Self {
            format,
            loader: Arc::new(loader),
            camera_file,
            ground_truth,
            pose_origin,
        }
    }

    /// A recording whose images come from elsewhere. Its camera is the one of `options`, if there is
    /// one, else its own.
    ///
    /// # Errors
    /// If there is no frame, or the camera has another size than the images.
    pub fn from_source(
        path: &Path,
        recording: SourcedRecording,
        options: &OpenOptions,
    ) -> Result<Self, DataError> {
        if recording.timestamps.is_empty() {
            return Err(DataError::Empty {
                path: path.into(),
                what: "frame",
            });
        }
        let own = recording.camera;
        let camera = options.camera.clone().unwrap_or_else(|| own.clone());
        let size = |camera: &CameraFile| (camera.camera().width, camera.camera().height);
        if size(&camera) != size(&own) {
            return Err(DataError::ImageSize {
                path: path.into(),
                width: size(&own).0 as u32,
                height: size(&own).1 as u32,
                camera_width: size(&camera).0,
                camera_height: size(&camera).1,
            });
        }
        let (source, timestamps) = (recording.source.into(), recording.timestamps.into());
        // Depth comes in metres; another scale says that they are not.
        let loader = FrameLoader::new(source, timestamps, &camera)
            .with_depth_factor((own.depth_scale() / camera.depth_scale()) as f32);
        let (format, poses) = (recording.format, recording.device_poses);
        Ok(Self::new(format, loader, camera, poses, PoseOrigin::Device))
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
        self.loader.timestamps().len()
    }

    /// Timestamp of each frame, seconds, strictly increasing. Layouts without timestamps get 30
    /// frames per second, starting at 0.
    pub fn timestamps(&self) -> impl ExactSizeIterator<Item = f64> {
        self.loader.timestamps().iter().copied()
    }

    /// The poses that come with the recording, at exactly the timestamps of their frames (see [`Trajectory::at`]). Some
    /// frames may lack one; `None` if all do.
    pub fn ground_truth(&self) -> Option<&Trajectory> {
        self.ground_truth.as_ref().ok()?.as_ref()
    }

    /// Where [`Self::ground_truth`] comes from: whether it is the truth.
    pub fn pose_origin(&self) -> PoseOrigin {
        self.pose_origin
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

    /// Reads one frame's images as the lens drew them.
    ///
    /// # Errors
    /// Those of [`Self::frame`].
    pub fn images(&self, index: usize) -> Result<FrameImages, DataError> {
        self.loader.images(index)
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
