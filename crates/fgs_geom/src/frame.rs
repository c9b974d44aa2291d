//! One RGB-D frame: a colour image, the depth image registered to it, and their camera.
//!
//! [`RgbdFrame::new`] is the gate through which every frame enters, from a file or a live camera:
//! whatever it accepts, tracker and mapper can take without further checks.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{Camera, DepthSensor, Image, Se3};

/// The position of a frame in its recording, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct FrameIndex(pub usize);

/// Identifies a keyframe. Ids increase in the order of creation and are never reused within a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct KeyframeId(pub u32);

/// A colour image and the depth image registered to it, both with the size of `camera` and free of
/// lens distortion.
///
/// The fields can be read, and changed in place, but a frame is made by [`RgbdFrame::new`] only. One that
/// was saved is to be [checked](RgbdFrame::check) when it is read back.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[non_exhaustive]
pub struct RgbdFrame {
    /// The frame's position in its recording.
    pub index: FrameIndex,
    /// Time at which the colour image was taken, seconds on the recording's clock.
    pub timestamp_secs: f64,
    /// 8-bit sRGB.
    pub color: Image<[u8; 3]>,
    /// Depth along z, metres; 0 or non-finite where nothing was measured.
    pub depth_m: Image<f32>,
    /// The pinhole camera of both images.
    pub camera: Camera,
    /// Which colour pixels the camera saw; `None` if it saw all of them. The border that removing
    /// lens distortion leaves was not seen. Frames of one recording share the mask.
    pub color_valid: Option<Arc<Image<bool>>>,
    /// Where and when the depth image was measured.
    pub depth_sensor: DepthSensor,
    /// How long the colour camera takes to read its rows, seconds: from the first row to the last;
    /// negative if it reads from the bottom; 0 for a global shutter. The frame's time is that of
    /// the middle row.
    pub color_readout_secs: f64,
    /// Where the recording device believes its colour camera to have been, `world_from_camera` in a world of
    /// its own, which may drift and jump; `None` if it does not say.
    pub device_pose: Option<Se3>,
}

/// Why images and camera do not make a frame.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum FrameError {
    /// An image's size is not the camera's.
    #[error("{image} is {width}x{height}, but the camera is {camera_width}x{camera_height}")]
    Size {
        /// "colour", "depth" or "colour validity".
        image: &'static str,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// The camera's columns.
        camera_width: usize,
        /// The camera's rows.
        camera_height: usize,
    },
    /// The time stamp is NaN or infinite.
    #[error("time stamp {0} is not finite")]
    Timestamp(f64),
    /// A finite depth value is below zero.
    #[error("depth at pixel ({u}, {v}) is negative: {depth_m} m")]
    NegativeDepth {
        /// Column of the first such pixel.
        u: usize,
        /// Row of the first such pixel.
        v: usize,
        /// Its depth, metres.
        depth_m: f32,
    },
}

impl RgbdFrame {
    /// A frame with every colour pixel valid.
    ///
    /// # Errors
    /// - An image's size differs from the camera's.
    /// - The time stamp is not finite: motion prediction and trajectory files need real times. A
    ///   source without a clock can count frames and divide by its frame rate.
    /// - A finite depth is negative, which only a wrong sign or unit can cause. NaN, either
    ///   infinity and 0 are accepted as "no measurement".
    pub fn new(
        index: FrameIndex,
        timestamp_secs: f64,
        color: Image<[u8; 3]>,
        depth_m: Image<f32>,
        camera: Camera,
    ) -> Result<Self, FrameError> {
        let frame = Self {
            index,
            timestamp_secs,
            color,
            depth_m,
            camera,
            color_valid: None,
            depth_sensor: DepthSensor::default(),
            color_readout_secs: 0.0,
            device_pose: None,
        };
        frame.check()?;
        Ok(frame)
    }

    /// Looks again at what [`new`](Self::new) requires, for frames that were changed since.
    ///
    /// # Errors
    /// As for `new`, and if the validity mask's size differs from the camera's.
    pub fn check(&self) -> Result<(), FrameError> {
        check_size("colour", &self.color, &self.camera)?;
        check_size("depth", &self.depth_m, &self.camera)?;
        if let Some(valid) = &self.color_valid {
            check_size("colour validity", valid, &self.camera)?;
        }
        if !self.timestamp_secs.is_finite() {
            return Err(FrameError::Timestamp(self.timestamp_secs));
        }
        let is_negative = |depth_m: &f32| depth_m.is_finite() && *depth_m < 0.0;
        if let Some(i) = self.depth_m.data().iter().position(is_negative) {
            return Err(FrameError::NegativeDepth {
                u: i % self.camera.width,
                v: i / self.camera.width,
                depth_m: self.depth_m.data()[i],
            });
        }
        Ok(())
    }

    /// The same frame with a mask of the colour pixels that the camera saw.
    ///
    /// # Errors
    /// If the mask's size differs from the camera's.
    pub fn with_color_valid(mut self, valid: Arc<Image<bool>>) -> Result<Self, FrameError> {
        check_size("colour validity", &valid, &self.camera)?;
        self.color_valid = Some(valid);
        Ok(self)
    }

    /// Whether the camera saw the colour of pixel (u, v). Panics outside the image.
    #[inline]
    pub fn has_color(&self, u: usize, v: usize) -> bool {
        (self.color_valid.as_ref()).is_none_or(|valid| valid.at(u, v))
    }
}

fn check_size<T>(name: &'static str, image: &Image<T>, camera: &Camera) -> Result<(), FrameError> {
    if (image.width(), image.height()) == (camera.width, camera.height) {
        return Ok(());
    }
    Err(FrameError::Size {
        image: name,
        width: image.width(),
        height: image.height(),
        camera_width: camera.width,
        camera_height: camera.height,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;

    const W: usize = 4;
    const H: usize = 3;

    fn frame(
        timestamp_secs: f64,
        color: Image<[u8; 3]>,
        depth_m: Image<f32>,
    ) -> Result<RgbdFrame, FrameError> {
        let intrinsics = Intrinsics {
            fx: 4.0,
            fy: 4.0,
            cx: 1.5,
            cy: 1.0,
        };
        let camera = Camera::new(W, H, intrinsics).unwrap();
        RgbdFrame::new(FrameIndex(0), timestamp_secs, color, depth_m, camera)
    }

    fn color() -> Image<[u8; 3]> {
        Image::filled(W, H, [1, 2, 3])
    }

    #[test]
    fn missing_depth_is_accepted() {
        let mut depth_m = Image::filled(W, H, 1.0);
        for (u, none) in [0.0, -0.0, f32::NAN, f32::NEG_INFINITY]
            .into_iter()
            .enumerate()
        {
            depth_m.set(u, 1, none);
        }
        let frame = frame(-3.5, color(), depth_m).unwrap();
        assert!(frame.color_valid.is_none() && frame.has_color(3, 2));
    }

    #[test]
    fn images_of_another_size_are_refused() {
        let depth_m = Image::filled(W, H, 1.0);
        let size = |image, width, height| {
            Some(FrameError::Size {
                image,
                width,
                height,
                camera_width: W,
                camera_height: H,
            })
        };
        let large = Image::filled(W, H + 1, 1.0);
        assert_eq!(frame(0.0, color(), large).err(), size("depth", W, H + 1));
        let turned = Image::filled(H, W, [0; 3]);
        assert_eq!(
            frame(0.0, turned, depth_m.clone()).err(),
            size("colour", H, W)
        );
        let frame = frame(0.0, color(), depth_m).unwrap();
        let masked = frame.with_color_valid(Arc::new(Image::filled(W - 1, H, true)));
        assert_eq!(masked.err(), size("colour validity", W - 1, H));
    }

    #[test]
    fn impossible_values_are_refused() {
        for secs in [f64::NAN, f64::INFINITY] {
            let refused = frame(secs, color(), Image::filled(W, H, 1.0)).unwrap_err();
            assert!(matches!(refused, FrameError::Timestamp(_)));
        }
        let mut depth_m = Image::filled(W, H, 1.0);
        depth_m.set(3, 1, -0.25);
        let refused = frame(0.0, color(), depth_m).unwrap_err();
        let message = "depth at pixel (3, 1) is negative: -0.25 m";
        assert_eq!(refused.to_string(), message);
    }

    #[test]
    fn the_mask_tells_which_colours_are_valid() {
        let frame = frame(0.0, color(), Image::filled(W, H, 1.0)).unwrap();
        let valid = Arc::new(Image::from_fn(W, H, |u, _| u > 0));
        let frame = frame.with_color_valid(valid).unwrap();
        assert!(!frame.has_color(0, 2) && frame.has_color(1, 2));
    }
}
