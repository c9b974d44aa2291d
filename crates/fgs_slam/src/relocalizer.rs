//! Guesses of a frame's pose that need no idea of where the camera is: corners matched with those of
//! keyframes, and of the frame before. They are tried when the motion model has failed.

use std::sync::{Arc, OnceLock};

use fgs_features::{Features, RelativePose, match_features, relative_pose};
use fgs_geom::{KeyframeId, RgbdFrame, Se3};
use fgs_place::{PlaceDescriptor, PlaceIndex, Similar};
use nalgebra::Matrix6;

use crate::keyframes::{Keyframe, move_pose};

/// Keyframes that are most like a frame are tried, up to so many.
const CANDIDATES: usize = 5;

/// Of the random draws by which corners are told from chance.
const SEED: u64 = 1;

/// What is needed of keyframes to find a lost camera.
#[derive(Default)]
pub struct Relocalizer {
    places: PlaceIndex,
    /// What the newest keyframe shows.
    newest_place: Option<PlaceDescriptor>,
    /// In the order they came, which is that of their ids.
    keyframes: Vec<KnownPlace>,
    /// The last frame with a trusted pose.
    last: Option<LastFrame>,
}

struct LastFrame {
    frame: Arc<RgbdFrame>,
    world_from_camera: Se3,
    /// Detected when first asked for; a camera that is lost asks again and again.
    features: OnceLock<Features>,
}

/// Where a frame may have been taken.
pub struct Guess {
    /// The colour camera's pose.
    pub world_from_camera: Se3,
    /// How sure it is, tangent `[omega, v]` in the camera's axes.
    pub information: Matrix6<f64>,
    /// Corners that agree with it.
    inliers: usize,
}

struct KnownPlace {
    id: KeyframeId,
    world_from_camera: Se3,
    features: Features,
}

impl Relocalizer {
    /// A keyframe joined the map.
    pub fn add(&mut self, keyframe: &Keyframe) {
        let frame = &keyframe.frame;
        let place = PlaceDescriptor::new(frame);
        self.places.add(keyframe.id, &place);
        self.newest_place = Some(place);
        self.keyframes.push(KnownPlace {
            id: keyframe.id,
            world_from_camera: keyframe.world_from_camera,
            features: Features::detect(frame),
        });
    }

    /// The last frame whose pose is trusted, and its pose.
    pub fn last(&self) -> Option<(&Arc<RgbdFrame>, &Se3)> {
        let last = self.last.as_ref()?;
        Some((&last.frame, &last.world_from_camera))
    }

    /// A frame whose pose is trusted.
    pub fn observe(&mut self, frame: &Arc<RgbdFrame>, world_from_camera: &Se3) {
        self.last = Some(LastFrame {
            frame: Arc::clone(frame),
            world_from_camera: *world_from_camera,
            features: OnceLock::new(),
        });
    }

    /// Where a frame was taken, judged by the last trusted frame and the newest keyframe, the more
    /// probable first.
    pub fn guesses_nearby(&self, frame: &Features) -> Vec<Guess> {
        let last = self.last.iter().filter_map(|last| {
            let features = last.features.get_or_init(|| Features::detect(&last.frame));
            Guess::new(frame, features, &last.world_from_camera)
        });
        let newest = self.keyframes.last();
        sorted(last.chain(newest.and_then(|keyframe| keyframe.guess(frame))))
    }

    /// Where a frame was taken, judged by the keyframes that look most like it.
    pub fn guesses_anywhere(&self, frame: &RgbdFrame, features: &Features) -> Vec<Guess> {
        let similar = (self.places).most_similar(&PlaceDescriptor::new(frame), CANDIDATES);
        sorted((similar.iter()).filter_map(|similar| self.known(similar.id)?.guess(features)))
    }

    /// All keyframes, the one most like the newest first.
    pub fn similar_to_newest(&self) -> Vec<Similar> {
        let newest = self.newest_place.as_ref();
        newest.map_or_else(Vec::new, |newest| {
            self.places.most_similar(newest, self.keyframes.len())
        })
    }

    /// The pose of keyframe `b` in the axes of `a`, from the corners that they have in common.
    pub fn relative_pose(&self, a: KeyframeId, b: KeyframeId) -> Option<RelativePose> {
        let (a, b) = (&self.known(a)?.features, &self.known(b)?.features);
        relative_pose(a, b, &match_features(a, b), SEED)
    }

    fn known(&self, id: KeyframeId) -> Option<&KnownPlace> {
        let at = (self.keyframes).binary_search_by_key(&id, |keyframe| keyframe.id);
        self.keyframes.get(at.ok()?)
    }

    /// Keyframes were moved, each by its `new_world_from_old_world`.
    pub fn move_keyframes(&mut self, moves: &[(KeyframeId, Se3)]) {
        for keyframe in &mut self.keyframes {
            move_pose(&mut keyframe.world_from_camera, keyframe.id, moves);
        }
    }

    /// The world around the newest keyframe moved rigidly, and the camera with it.
    pub fn move_camera(&mut self, new_from_old: &Se3) {
        if let Some(last) = &mut self.last {
            last.world_from_camera = *new_from_old * last.world_from_camera;
        }
    }
}

impl KnownPlace {
    fn guess(&self, frame: &Features) -> Option<Guess> {
        Guess::new(frame, &self.features, &self.world_from_camera)
    }
}

impl Guess {
    /// From the corners that a frame has in common with another, whose pose is known.
    fn new(frame: &Features, other: &Features, world_from_other: &Se3) -> Option<Self> {
        let matches = match_features(other, frame);
        let relative = relative_pose(other, frame, &matches, SEED)?;
        Some(Self {
            world_from_camera: *world_from_other * relative.a_from_b,
            information: relative.information,
            inliers: relative.inliers,
        })
    }
}

/// By falling number of inliers.
fn sorted(guesses: impl Iterator<Item = Guess>) -> Vec<Guess> {
    let mut guesses: Vec<_> = guesses.collect();
    guesses.sort_by_key(|guess| std::cmp::Reverse(guess.inliers));
    guesses
}
