//! Geometry shared by every crate: rigid transforms, the pinhole camera, images and frames.
//!
//! Camera axes: x right, y down, z forward. Pixel centres lie at integer coordinates.
//! Depth is in metres; 0 or a non-finite value means "no measurement".
//! Transforms are named `a_from_b`: they map coordinates in `b` to coordinates in `a`.

mod camera;
mod depth;
mod depth_sensor;
mod distortion;
mod frame;
mod image;
mod instructions;
mod number;
mod pixel_map;
mod rigid_alignment;
mod rolling_shutter;
mod se3;

pub use camera::{Camera, CameraError, Intrinsics, View};
pub use depth::{depth_from_raw, has_depth};
pub use depth_sensor::{DepthSensor, registered_depth};
pub use distortion::Distortion;
pub use frame::{FrameError, FrameIndex, KeyframeId, RgbdFrame};
pub use image::{Image, ImageSizeError};
pub use instructions::{Instructions, InstructionsError, Kernel, dispatch};
pub use number::Number;
pub use pixel_map::PixelMap;
pub use rigid_alignment::rigid_alignment;
pub use rolling_shutter::row_delay_secs;
pub use se3::{Se3, inverse_left_jacobian, skew};
