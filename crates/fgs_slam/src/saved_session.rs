//! A session between two frames, as plain data. What can be made again from keyframes' images to the
//! last bit is not in it, nor are those images: whoever saves a session keeps them, each once.

use std::time::Duration;

use fgs_geom::{Camera, FrameIndex, KeyframeId, Se3};
use fgs_graph::{Edge, KeyframeGraph};
use fgs_splat::Gaussians;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::frame_result::FrameResult;
use crate::holdout::Holdout;
use crate::keyframes::KeyframeKind;
use crate::loops::LoopCloser;
use crate::merge::Renumbering;
use crate::separation::Separation;
use crate::session::{KeyframeRecord, SlamError};
use crate::submaps::Submaps;
use crate::system::{MapReport, SavedMapping};
use crate::tracker::SavedTracker;

/// Everything that the next frame's result depends on, apart from settings and keyframes' images. With
/// serde it can be written in any format that keeps every bit of a number.
#[derive(Serialize, Deserialize)]
pub struct SavedSession {
    pub(crate) camera: Camera,
    pub(crate) tracker: SavedTracker,
    pub(crate) mapping: SavedMapping,
    pub(crate) report: MapReport,
    pub(crate) graph: KeyframeGraph,
    pub(crate) submaps: Submaps,
    pub(crate) loops: LoopCloser,
    pub(crate) closed_loops: usize,
    pub(crate) keyframes: Vec<(KeyframeId, KeyframeKind, FrameIndex)>,
    pub(crate) frames: Vec<RecordedFrame>,
    pub(crate) first: FrameIndex,
    pub(crate) holdout: Option<Holdout>,
    pub(crate) localizes_only: bool,
    pub(crate) elapsed: Duration,
}

/// A frame's result. Its pose is relative to a keyframe, so that it follows corrections.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct RecordedFrame {
    pub result: FrameResult,
    /// The keyframe, and `keyframe_from_camera`.
    pub pose: Option<(KeyframeId, Se3)>,
}

impl SavedSession {
    /// Of a session that has seen nothing.
    pub(crate) fn new(camera: &Camera, seed: u64) -> Self {
        Self {
            camera: *camera,
            tracker: SavedTracker::default(),
            mapping: SavedMapping::new(seed),
            report: MapReport::default(),
            graph: KeyframeGraph::new(),
            submaps: Submaps::default(),
            loops: LoopCloser::default(),
            closed_loops: 0,
            keyframes: Vec::new(),
            frames: Vec::new(),
            first: FrameIndex(0),
            holdout: None,
            localizes_only: false,
            elapsed: Duration::ZERO,
        }
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The keyframes, whose images a session needs to go on, in their order.
    pub fn keyframes(&self) -> impl ExactSizeIterator<Item = KeyframeId> {
        self.keyframes.iter().map(|(id, ..)| *id)
    }

    /// What became of the last frame; `None` if there was none.
    pub fn last_frame(&self) -> Option<&FrameResult> {
        self.frames.last().map(|frame| &frame.result)
    }

    /// The frame to go on with.
    pub fn next_frame(&self) -> FrameIndex {
        let next = |last: &FrameResult| FrameIndex(last.index.0 + 1);
        self.last_frame().map_or(self.first, next)
    }

    /// The largest sub-map as it is now, and its keyframes, in its axes: sub-map 0 of
    /// [`SlamOutput`](crate::SlamOutput).
    ///
    /// # Errors
    /// [`SlamError::Inconsistent`] if what was saved contradicts itself.
    pub fn largest_map(&self) -> Result<(Gaussians, Vec<KeyframeRecord>), SlamError> {
        let all = self.mapping.gaussians();
        if !self.is_consistent() || !all.has_len(all.len()) {
            return Err(SlamError::Inconsistent);
        }
        let separation = Separation::new(&self.submaps, &self.graph);
        let maps = separation.maps(all.clone(), &self.graph);
        let graph = separation.graph(self.graph.clone());
        let keyframes = self.keyframes.iter().filter_map(|(id, kind, index)| {
            Some(KeyframeRecord {
                id: *id,
                index: *index,
                kind: *kind,
                submap: separation.number_of(*id).filter(|number| *number == 0)?,
                world_from_camera: *graph.pose(*id)?,
            })
        });
        let keyframes = keyframes.collect();
        Ok((maps.into_iter().next().unwrap_or_default(), keyframes))
    }

    /// The start of another session in the same place: the map stays, frames and motion are forgotten,
    /// and the camera is lost. It is found by what keyframes look like, and extends the map from there.
    #[must_use]
    pub fn into_map(mut self) -> Self {
        self.tracker.lose();
        self.mapping.forget_counts();
        self.report.forget_frames();
        Self {
            closed_loops: 0,
            frames: Vec::new(),
            first: FrameIndex(0),
            holdout: None,
            elapsed: Duration::ZERO,
            ..self
        }
    }

    /// The same, but the map stays as it is: frames are tracked, and none becomes a keyframe.
    #[must_use]
    pub fn localizing_only(mut self) -> Self {
        self.mapping.freeze();
        Self {
            localizes_only: true,
            ..self
        }
    }

    /// The number that the next keyframe has; `None` if there is no keyframe.
    pub(crate) fn next_keyframe(&self) -> Option<KeyframeId> {
        let (newest, ..) = self.keyframes.last()?;
        Some(KeyframeId(newest.0.saturating_add(1)))
    }

    /// This map with another, whose sub-maps are further ones of it and whose keyframes are numbered on from
    /// its own. All stay where they are; `away` says where the other is about to go, metres.
    ///
    /// # Errors
    /// If the two are of different cameras, or their numbers do not suffice.
    pub(crate) fn beside(mut self, other: Self, away: Vector3<f64>) -> Result<Self, SlamError> {
        if self.camera != other.camera {
            return Err(SlamError::OtherCameras {
                first: Box::new(self.camera),
                second: Box::new(other.camera),
            });
        }
        let renumbering = Renumbering {
            keyframes: self.next_keyframe().map_or(0, |next| next.0),
            sparse: self.tracker.next_point(),
        };
        let renumbered = |id| renumbering.keyframe(id);
        for (id, pose) in other.graph.poses() {
            self.graph.add_keyframe(renumbered(id), *pose);
        }
        for edge in other.graph.edges() {
            let edge = Edge {
                from: renumbered(edge.from),
                to: renumbered(edge.to),
                ..edge.clone()
            };
            let added = self.graph.add_edge(edge);
            added.map_err(|_| SlamError::Inconsistent)?;
        }
        let keyframes = other.keyframes.iter();
        self.keyframes
            .extend(keyframes.map(|(id, kind, index)| (renumbered(*id), *kind, *index)));
        self.submaps.append(other.submaps, renumbering, away);
        self.tracker.append(other.tracker, renumbering);
        self.mapping.append(other.mapping, renumbering);
        self.report.append(other.report, renumbering);
        Ok(self)
    }

    /// Whether it can be the state of a session: names of keyframes agree, and what has images or
    /// cameras has those of this one.
    pub(crate) fn is_consistent(&self) -> bool {
        self.keyframes.is_sorted_by(|(a, ..), (b, ..)| a < b)
            && self.keyframes().eq(self.graph.poses().map(|(id, _)| id))
            && self.submaps.is_consistent(self.keyframes().next())
            && self.tracker.homes().all(|id| self.graph.pose(id).is_some())
            && self.tracker.is_of(&self.camera)
            && self.mapping.is_of(&self.camera)
            && self.mapping.views().is_sorted_by(|a, b| a < b)
            && (self.mapping.views()).all(|id| self.graph.pose(id).is_some())
            && (self.frames.iter()).all(|frame| frame.result.index.0 < usize::MAX)
    }
}
