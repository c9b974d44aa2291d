//! FGS-SLAM: tracking with GICP against a sparse map and mapping with gaussian splatting, guided by
//! a Fourier segmentation of the image.
//!
//! A [`Slam`] session takes frames one by one. [`drive`] feeds it a recording, [`replay`] does so at
//! the recording's own pace, [`live`] feeds it a camera. [`Slam::finish_refined`] optimises the map
//! further when the frames have ended. A [`Mapper`] alone, with a
//! [`KeyframePreparer`], builds a map from poses that are known.

mod color_aligner;
mod config;
mod event;
mod frame_result;
pub mod frequency;
mod holdout;
mod image_memory;
mod inferred_depth;
mod keyframes;
mod loops;
mod machine_memory;
mod map_alignment;
mod mapper;
mod merge;
mod missing;
mod motion;
mod moving;
mod prepare;
mod refinement;
mod registrar;
mod relocalizer;
mod repeats;
mod saved_session;
mod seam;
mod seeding;
mod separation;
mod session;
mod sparse_map;
mod submaps;
mod surface;
mod system;
mod tracker;
mod two_motions;
mod verdict;
mod view_choice;
mod weak_directions;

pub use config::{
    KeyframeConfig, LoopConfig, MappingConfig, SeedingConfig, SlamConfig, SurfaceConfig,
    TrackingConfig,
};
pub use event::{Addition, SlamEvent, Subscription};
pub use fgs_splat::SettingError;
pub use frame_result::{FrameResult, FrameStatus, TrackingQuality};
pub use holdout::{Holdout, HoldoutError};
pub use keyframes::{Keyframe, KeyframeKind, NewPoint};
pub use mapper::{Mapper, MapperError, model_settings};
pub use prepare::{KeyframePreparer, PreparedKeyframe};
pub use refinement::RefinedMap;
pub use saved_session::SavedSession;
pub use session::{FurtherMap, KeyframeRecord, Slam, SlamError, SlamOutput, Timings};
pub use system::{
    Execution, UnknownExecution, drive, drive_with, live, live_with, replay, replay_with,
};
