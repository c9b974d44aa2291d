//! Why a session refuses a call.

use fgs_geom::{Camera, FrameError, FrameIndex, KeyframeId};
use fgs_splat::{LossError, ModelError, SettingError};

use crate::system::MapperGone;

/// Why a session refuses a call.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SlamError {
    /// A setting is impossible.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// Threads do not start.
    #[error("cannot start the threads that compute: {0}")]
    Threads(#[from] std::io::Error),
    /// The frame is not of the session's camera.
    #[error("frame {} is not of this session's camera: {frame:?}, expected {session:?}", index.0)]
    OtherCamera {
        /// Which frame.
        index: FrameIndex,
        /// Its camera.
        frame: Box<Camera>,
        /// The session's.
        session: Box<Camera>,
    },
    /// Two maps are of different cameras.
    #[error(
        "the maps are of different cameras: {}x{} with fx = {} and {}x{} with fx = {}",
        first.width, first.height, first.intrinsics.fx,
        second.width, second.height, second.intrinsics.fx
    )]
    OtherCameras {
        /// Of the first map.
        first: Box<Camera>,
        /// Of the second.
        second: Box<Camera>,
    },
    /// The frame's images or values were changed into something impossible.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// There is no keyframe of this name.
    #[error("there is no keyframe {0:?}")]
    NoSuchKeyframe(KeyframeId),
    /// A saved session contradicts itself.
    #[error("what was saved of a session contradicts itself")]
    Inconsistent,
    /// A saved map cannot be taken over.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The images of a saved keyframe do not belong together.
    #[error(transparent)]
    Images(#[from] LossError),
    /// The mapper has failed; [`Slam::finish`] says why and returns what there was.
    #[error("the mapper has stopped")]
    MapperStopped,
}

impl From<MapperGone> for SlamError {
    fn from(_: MapperGone) -> Self {
        Self::MapperStopped
    }
}
