//! RealSense cameras, through librealsense2: colour, and depth that it aligns to colour.
//!
//! It was compiled and linked with librealsense 2.59 and run up to the point where no camera is found. It was
//! never run with a camera.

#![cfg(feature = "sdk")]

mod camera;
mod stream;

pub use camera::{RealsenseCamera, RealsenseError, open};
