//! FGS-SLAM: tracking with GICP against a sparse map and mapping with gaussian splatting, guided by
//! a Fourier segmentation of the image.
//!
//! [`run`] drives a [`Tracker`] and a [`Mapper`]; both are plain structs without threads.

mod config;
pub mod frequency;
mod keyframes;
mod mapper;
mod missing;
mod observer;
mod seeding;
mod surface;
mod system;
mod tracker;
mod view_choice;

pub use config::{
    ConfigError, Disks, KeyframeConfig, MappingConfig, NewPoints, SeedingConfig, SlamConfig,
    TargetCovariance, TrackingConfig,
};
pub use keyframes::{Keyframe, KeyframeKind};
pub use mapper::{Mapper, MapperError, model_settings};
pub use observer::{FrameStatus, Observer, SlamEvent};
pub use system::{Execution, KeyframeRecord, SlamError, SlamOutput, Timings, run};
pub use tracker::{Tracked, Tracker, TrackingStatus};
