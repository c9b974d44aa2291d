//! Loads one frame from its two files: decodes them, converts depth to metres and removes lens
//! distortion.

use std::sync::Arc;

use fgs_geom::{Camera, DepthSensor, FrameIndex, Image, PixelMap, RgbdFrame, depth_from_raw};

use crate::formats::FrameFiles;
use crate::images::{read_color, read_depth};
use crate::{CameraFile, DataError};

/// Everything needed to load a frame; shared by the decoder threads.
#[derive(Clone)]
pub(crate) struct FrameLoader {
    frames: Vec<FrameFiles>,
    camera: Camera,
    undistortion: Option<PixelMap>,
    /// Shared by all frames; `None` if every pixel of an undistorted image has a source.
    color_valid: Option<Arc<Image<bool>>>,
    depth_scale: f32,
    no_depth: u16,
    depth_sensor: DepthSensor,
    color_readout_secs: f64,
}

impl FrameLoader {
    pub fn new(frames: Vec<FrameFiles>, no_depth: u16, camera_file: &CameraFile) -> Self {
        let camera = *camera_file.camera();
        let undistortion = camera_file
            .distortion()
            .map(|lens| lens.undistortion(&camera));
        let color_valid = undistortion.as_ref().map(PixelMap::color_valid);
        Self {
            frames,
            camera,
            undistortion,
            color_valid: color_valid
                .filter(|valid| valid.data().contains(&false))
                .map(Arc::new),
            depth_scale: camera_file.depth_scale() as f32,
            no_depth,
            depth_sensor: camera_file.depth_sensor(),
            color_readout_secs: camera_file.color_readout_secs(),
        }
    }

    /// Takes over the times of a camera file that is otherwise the same.
    pub fn set_times(&mut self, camera_file: &CameraFile) {
        self.depth_sensor = camera_file.depth_sensor();
        self.color_readout_secs = camera_file.color_readout_secs();
    }

    pub fn frames(&self) -> &[FrameFiles] {
        &self.frames
    }

    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    pub fn load(&self, index: usize) -> Result<RgbdFrame, DataError> {
        let files = self.frames.get(index).ok_or(DataError::NoSuchFrame {
            index,
            len: self.frames.len(),
        })?;
        let mut color = read_color(&files.color, &self.camera)?;
        let raw = read_depth(&files.depth, &self.camera)?;
        let mut depth_m = depth_from_raw(&raw, self.depth_scale, self.no_depth);
        if let Some(map) = &self.undistortion {
            // The map is made for this camera, whose size both images have.
            color = map.color(&color).unwrap_or(color);
            depth_m = map.depth(&depth_m).unwrap_or(depth_m);
        }
        let frame = RgbdFrame::new(
            FrameIndex(index),
            files.timestamp_secs,
            color,
            depth_m,
            self.camera,
        );
        let mut frame = match &self.color_valid {
            Some(valid) => frame.and_then(|frame| frame.with_color_valid(valid.clone())),
            None => frame,
        }
        .map_err(|source| DataError::Frame { index, source })?;
        frame.depth_sensor = self.depth_sensor;
        frame.color_readout_secs = self.color_readout_secs;
        Ok(frame)
    }
}
