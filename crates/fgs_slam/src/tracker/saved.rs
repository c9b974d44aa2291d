//! A tracker as plain data.

use std::sync::Arc;

use fgs_geom::{Camera, KeyframeId, RgbdFrame, Se3};
use serde::{Deserialize, Serialize};

use super::footing::Footing;
use super::{Tracker, Unmapped};
use crate::merge::Renumbering;
use crate::motion::MotionModel;
use crate::moving::MovingThings;
use crate::repeats::{Clock, LatestFrame};
use crate::sparse_map::SavedSparseMap;
use crate::two_motions::UsualFit;

/// What a tracker remembers, as plain data, apart from its keyframes.
#[derive(Default, Serialize, Deserialize)]
pub struct SavedTracker {
    pub(super) frames_since_keyframe: Option<usize>,
    pub(super) map: SavedSparseMap,
    pub(super) motion: MotionModel,
    pub(super) moving: MovingThings,
    pub(super) usual_fit: UsualFit,
    pub(super) footing: Footing,
    pub(super) clock: Clock,
    pub(super) frames: SavedFrames,
    pub(super) latest: Option<LatestFrame<usize>>,
    pub(super) last: Option<(usize, Se3)>,
    pub(super) home: Option<KeyframeId>,
    pub(super) unmapped: Option<Unmapped<usize>>,
}

/// The frames that a tracker remembers, mostly one in several roles: each once, named by its place.
#[derive(Default, Serialize, Deserialize)]
pub struct SavedFrames(Vec<Arc<RgbdFrame>>);

impl SavedFrames {
    fn place_of(&mut self, frame: &Arc<RgbdFrame>) -> usize {
        let place = self.0.iter().position(|saved| Arc::ptr_eq(saved, frame));
        place.unwrap_or_else(|| {
            self.0.push(Arc::clone(frame));
            self.0.len() - 1
        })
    }

    /// `None` if there is none.
    pub(super) fn get(&self, place: usize) -> Option<Arc<RgbdFrame>> {
        self.0.get(place).map(Arc::clone)
    }
}

impl SavedTracker {
    /// The camera is lost, and nothing is known of where it has been.
    pub fn lose(&mut self) {
        *self = Self {
            frames_since_keyframe: self.frames_since_keyframe,
            map: std::mem::take(&mut self.map),
            footing: Footing::Lost { followed: 0 },
            ..Self::default()
        };
    }

    /// The number of the next sparse point.
    pub fn next_point(&self) -> u32 {
        self.map.next_id()
    }

    /// Takes in another's sparse map.
    pub fn append(&mut self, other: Self, renumbering: Renumbering) {
        self.map.append(other.map, renumbering);
    }

    /// Whether what it remembers is of a camera.
    pub fn is_of(&self, camera: &Camera) -> bool {
        let is_sound = |frame: &Arc<RgbdFrame>| frame.camera == *camera && frame.check().is_ok();
        let last = self.last.iter().map(|(place, _)| *place);
        let latest = self.latest.iter().map(|latest| latest.frame);
        let unmapped = self.unmapped.iter().map(|unmapped| unmapped.frame);
        self.moving.are_of(camera)
            && self.frames.0.iter().all(is_sound)
            && (last.chain(latest).chain(unmapped)).all(|place| place < self.frames.0.len())
    }

    /// The keyframes that it is tracked from, or was.
    pub fn homes(&self) -> impl Iterator<Item = KeyframeId> {
        let before = match &self.footing {
            Footing::Found { home_before, .. } => *home_before,
            Footing::Firm | Footing::Lost { .. } => None,
        };
        let unmapped = self.unmapped.as_ref().and_then(|unmapped| unmapped.home);
        self.home.into_iter().chain(before).chain(unmapped)
    }
}

impl Tracker {
    /// Everything but the settings and the keyframes.
    pub fn save(&self) -> SavedTracker {
        let mut frames = SavedFrames::default();
        let last = self.relocalizer.last();
        let last = last.map(|(frame, pose)| (frames.place_of(frame), *pose));
        let latest = self.latest.as_ref();
        let latest = latest.map(|latest| latest.with_frame(frames.place_of(&latest.frame)));
        let unmapped = self.unmapped.as_ref();
        let unmapped =
            unmapped.map(|unmapped| unmapped.with_frame(frames.place_of(&unmapped.frame)));
        SavedTracker {
            frames_since_keyframe: self.policy.frames_since_keyframe(),
            map: self.map.save(),
            motion: self.motion.clone(),
            moving: self.moving.clone(),
            usual_fit: self.usual_fit.clone(),
            footing: self.footing.clone(),
            clock: self.clock,
            frames,
            latest,
            last,
            home: self.home,
            unmapped,
        }
    }
}
