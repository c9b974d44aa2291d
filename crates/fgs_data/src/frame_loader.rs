//! Loads one frame: takes its images from where they are, converts depth to metres and removes lens
//! distortion.

use std::sync::Arc;

use fgs_geom::{Camera, DepthSensor, FrameIndex, Image, PixelMap, RgbdFrame, depth_from_raw};

use crate::formats::FrameFiles;
use crate::frame_source::{FrameImages, FrameSource};
use crate::images::{read_color, read_depth};
use crate::{CameraFile, DataError, Trajectory};

/// Everything needed to load a frame; shared by the decoder threads.
#[derive(Clone)]
pub(crate) struct FrameLoader {
    source: Arc<dyn FrameSource>,
    timestamps: Arc<[f64]>,
    camera: Camera,
    undistortion: Option<PixelMap>,
    /// Shared by all frames; `None` if every pixel of an undistorted image has a source.
    color_valid: Option<Arc<Image<bool>>>,
    /// What the source's depth has to be multiplied by.
    depth_factor: f32,
    depth_sensor: DepthSensor,
    color_readout_secs: f64,
    /// The recording device's own poses, of some of the frames.
    device_poses: Option<Arc<Trajectory>>,
}

impl FrameLoader {
    /// The frames of `source`, which has one for each time stamp.
    pub fn new(
        source: Arc<dyn FrameSource>,
        timestamps: Arc<[f64]>,
        camera_file: &CameraFile,
    ) -> Self {
        let camera = *camera_file.camera();
        let undistortion = camera_file
            .distortion()
            .map(|lens| lens.undistortion(&camera));
        let color_valid = undistortion.as_ref().map(PixelMap::color_valid);
        Self {
            source,
            timestamps,
            camera,
            undistortion,
            color_valid: color_valid
                .filter(|valid| valid.data().contains(&false))
                .map(Arc::new),
            depth_factor: 1.0,
            depth_sensor: camera_file.depth_sensor(),
            color_readout_secs: camera_file.color_readout_secs(),
            device_poses: None,
        }
    }

    /// The same with the device's own poses at the frames' times.
    pub fn with_device_poses(mut self, poses: &Trajectory) -> Self {
        self.device_poses = Some(Arc::new(poses.clone()));
        self
    }

    /// The same with all depth multiplied by a factor.
    pub fn with_depth_factor(mut self, factor: f32) -> Self {
        self.depth_factor = factor;
        self
    }

    /// Takes over the times of a camera file that is otherwise the same.
    pub fn set_times(&mut self, camera_file: &CameraFile) {
        self.depth_sensor = camera_file.depth_sensor();
        self.color_readout_secs = camera_file.color_readout_secs();
    }

    pub fn timestamps(&self) -> &[f64] {
        &self.timestamps
    }

    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// A frame's images as the lens drew them.
    pub fn images(&self, index: usize) -> Result<FrameImages, DataError> {
        let mut images = self.source.read(index)?;
        if self.depth_factor != 1.0 {
            images.depth_m = images.depth_m.map(|depth| self.depth_factor * depth);
        }
        Ok(images)
    }

    pub fn load(&self, index: usize) -> Result<RgbdFrame, DataError> {
        let timestamp_secs = *self.timestamps.get(index).ok_or(DataError::NoSuchFrame {
            index,
            len: self.timestamps.len(),
        })?;
        let FrameImages {
            mut color,
            mut depth_m,
            color_valid,
        } = self.images(index)?;
        if let Some(map) = &self.undistortion {
            // The map is made for this camera, whose size both images have.
            color = map.color(&color).unwrap_or(color);
            depth_m = map.depth(&depth_m).unwrap_or(depth_m);
        }
        let frame = RgbdFrame::new(
            FrameIndex(index),
            timestamp_secs,
            color,
            depth_m,
            self.camera,
        );
        let mut frame = match color_valid.map(Arc::new).or(self.color_valid.clone()) {
            Some(valid) => frame.and_then(|frame| frame.with_color_valid(valid)),
            None => frame,
        }
        .map_err(|source| DataError::Frame { index, source })?;
        frame.depth_sensor = self.depth_sensor;
        frame.color_readout_secs = self.color_readout_secs;
        let poses = self.device_poses.as_ref();
        frame.device_pose = poses.and_then(|poses| poses.at(timestamp_secs));
        Ok(frame)
    }
}

/// Frames in two files each.
pub(crate) struct FrameFilesSource {
    pub frames: Vec<FrameFiles>,
    pub camera: Camera,
    /// The raw depth value of 1 m.
    pub depth_scale: f32,
    /// The raw value that means "none", besides 0.
    pub no_depth: u16,
}

impl FrameSource for FrameFilesSource {
    fn read(&self, index: usize) -> Result<FrameImages, DataError> {
        let files = self.frames.get(index).ok_or(DataError::NoSuchFrame {
            index,
            len: self.frames.len(),
        })?;
        let raw = || read_depth(&files.depth, &self.camera);
        Ok(FrameImages {
            color: read_color(&files.color, &self.camera)?,
            depth_m: depth_from_raw(&raw()?, self.depth_scale, self.no_depth),
            color_valid: None,
        })
    }
}
