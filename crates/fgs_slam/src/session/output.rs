//! What a session has found when it ends.

use std::time::Duration;

use fgs_geom::{FrameIndex, KeyframeId, Se3};
use fgs_graph::KeyframeGraph;
use fgs_splat::Gaussians;

use crate::frame_result::FrameResult;
use crate::keyframes::KeyframeKind;
use crate::mapper::MapperError;
use crate::refinement::RefinedMap;

/// What a session found. What it could not connect lies in sub-maps: number 0 is that with the most keyframes,
/// the others follow by size. Each has axes of its own, those of its first camera.
#[derive(Debug)]
#[non_exhaustive]
pub struct SlamOutput {
    /// Every frame in its order, with its pose after all corrections.
    pub frames: Vec<FrameResult>,
    /// The keyframes, in order.
    pub keyframes: Vec<KeyframeRecord>,
    /// The keyframes' poses, each in its sub-map, and how they hang together.
    pub graph: KeyframeGraph,
    /// How often a loop was closed, or sub-maps were joined.
    pub loops: usize,
    /// The map of sub-map 0 when the recording had ended.
    pub gaussians: Gaussians,
    /// The same after refinement; `None` if none was asked for or not a single step was taken.
    pub refined: Option<RefinedMap>,
    /// The maps of the further sub-maps, from number 1 on.
    pub further: Vec<FurtherMap>,
    /// Bytes that the map took on a graphics device at the end.
    pub device_bytes: u64,
    /// Where the time went.
    pub timings: Timings,
    /// Why the mapper could not go on, which ended the session early.
    pub failure: Option<MapperError>,
}

/// The map of a sub-map that is not the largest, in its own axes.
#[derive(Clone, Debug, PartialEq)]
pub struct FurtherMap {
    /// When the recording had ended.
    pub gaussians: Gaussians,
    /// After refinement, if there was any.
    pub refined: Option<Gaussians>,
}

/// A keyframe's place in the recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyframeRecord {
    /// Its name.
    pub id: KeyframeId,
    /// The frame, of the recording that the keyframe came from.
    pub index: FrameIndex,
    /// What it is for.
    pub kind: KeyframeKind,
    /// The sub-map that it is in.
    pub submap: usize,
    /// Its pose after all corrections.
    pub world_from_camera: Se3,
}

/// Wall-clock times of a session, without refinement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Timings {
    /// From the session's start to the last step done, decoding included.
    pub total: Duration,
    /// All the mapper's work.
    pub mapping: Duration,
    /// Optimisation steps taken.
    pub steps: usize,
}
