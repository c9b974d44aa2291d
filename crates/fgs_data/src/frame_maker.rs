//! Makes frames of images as a lens drew them: removes its distortion and says when the sensors measured.

use std::sync::Arc;

use fgs_geom::{Camera, DepthSensor, FrameError, FrameIndex, Image, PixelMap, RgbdFrame};

use crate::{CameraFile, FrameImages};

/// What a camera file means for images.
#[derive(Clone)]
pub struct FrameMaker {
    camera: Camera,
    undistortion: Option<PixelMap>,
    /// Shared by all frames; `None` if every pixel of an undistorted image has a source.
    color_valid: Option<Arc<Image<bool>>>,
    depth_sensor: DepthSensor,
    color_readout_secs: f64,
}

impl FrameMaker {
    /// For the images of a camera.
    pub fn new(camera_file: &CameraFile) -> Self {
        let camera = *camera_file.camera();
        let undistortion = camera_file
            .distortion()
            .map(|lens| lens.undistortion(&camera));
        let color_valid = undistortion.as_ref().map(PixelMap::color_valid);
        Self {
            camera,
            undistortion,
            color_valid: color_valid
                .filter(|valid| valid.data().contains(&false))
                .map(Arc::new),
            depth_sensor: camera_file.depth_sensor(),
            color_readout_secs: camera_file.color_readout_secs(),
        }
    }

    /// The pinhole camera of the frames.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Takes over the times of a camera file that is otherwise the same.
    pub(crate) fn set_times(&mut self, camera_file: &CameraFile) {
        self.depth_sensor = camera_file.depth_sensor();
        self.color_readout_secs = camera_file.color_readout_secs();
    }

    /// The frame of images that were taken at a time, seconds.
    ///
    /// # Errors
    /// If they do not make a frame of this camera.
    pub fn frame(
        &self,
        index: FrameIndex,
        timestamp_secs: f64,
        images: FrameImages,
    ) -> Result<RgbdFrame, FrameError> {
        let FrameImages {
            mut color,
            mut depth_m,
            color_valid,
        } = images;
        if let Some(map) = &self.undistortion {
            // Images of another size stay as they are, and are refused below.
            color = map.color(&color).unwrap_or(color);
            depth_m = map.depth(&depth_m).unwrap_or(depth_m);
        }
        let mut frame = RgbdFrame::new(index, timestamp_secs, color, depth_m, self.camera)?;
        if let Some(valid) = color_valid.map(Arc::new).or(self.color_valid.clone()) {
            frame = frame.with_color_valid(valid)?;
        }
        frame.depth_sensor = self.depth_sensor;
        frame.color_readout_secs = self.color_readout_secs;
        Ok(frame)
    }
}
