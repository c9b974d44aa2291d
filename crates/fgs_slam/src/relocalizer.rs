//! Guesses of a frame's pose that need no idea of where the camera is: corners matched with those of
//! keyframes, and of the frame before. They are tried when the motion model has failed.

use std::sync::{Arc, OnceLock};

use fgs_features::{Features, RelativePose, match_features, relative_pose};
use fgs_geom::{KeyframeId, RgbdFrame, Se3};
use fgs_place::{PlaceDescriptor, PlaceIndex, Similar};
use nalgebra::Matrix6;

use crate::keyframes::{Keyframe, Motions};

/// Keyframes that are most like a frame are tried, up to so many.
const CANDIDATES: usize = 5;

/// So many keyframes are remembered, each with at most 100 kB of corners and points to compare.
const MAX_KEYFRAMES: usize = 1000;

/// Of the random draws by which corners are told from chance.
const SEED: u64 = 1;

/// What is needed of keyframes to find a lost camera.
#[derive(Default)]
pub struct Relocalizer {
    places: PlaceIndex,
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
    /// The keyframe whose corners say so; `None` if they are those of the last trusted frame.
    pub keyframe: Option<KeyframeId>,
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
    /// How similar it was to what was remembered when it came.
    likeness: f64,
}

impl Relocalizer {
    /// A keyframe joined the map. If there are too many, one is forgotten, whose name is returned: the
    /// one that came most like an older one, since loops close best to what was seen first.
    pub fn add(&mut self, keyframe: &Keyframe) -> Option<KeyframeId> {
        let frame = &keyframe.frame;
        let place = PlaceDescriptor::new(frame);
        let most_similar = self.places.most_similar(&place, 1);
        self.places.add(keyframe.id, &place);
        self.keyframes.push(KnownPlace {
            id: keyframe.id,
            world_from_camera: keyframe.world_from_camera,
            features: Features::detect(frame),
            likeness: most_similar.first().map_or(0.0, |like| like.similarity),
        });
        self.forget_one_beyond(MAX_KEYFRAMES)
    }

    fn forget_one_beyond(&mut self, max: usize) -> Option<KeyframeId> {
        if self.keyframes.len() <= max {
            return None;
        }
        // The newest stays: the next frames are compared with it.
        let known = self.keyframes.iter().enumerate().take(max);
        let (at, _) = known.max_by(|(_, a), (_, b)| a.likeness.total_cmp(&b.likeness))?;
        let id = self.keyframes.remove(at).id;
        self.places.remove(id);
        Some(id)
    }

    /// Whether a keyframe is remembered.
    pub fn knows(&self, id: KeyframeId) -> bool {
        self.known(id).is_some()
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

    /// Where a frame was taken, judged by the last trusted frame and the keyframe that the camera was
    /// tracked from, the more probable first.
    pub fn guesses_nearby(&self, frame: &Features, home: Option<KeyframeId>) -> Vec<Guess> {
        let last = self.last.iter().filter_map(|last| {
            let features = last.features.get_or_init(|| Features::detect(&last.frame));
            Guess::new(frame, features, &last.world_from_camera)
        });
        let home = home.and_then(|home| self.known(home));
        sorted(last.chain(home.and_then(|keyframe| keyframe.guess(frame))))
    }

    /// Where a frame was taken, judged by the keyframes that look most like it.
    pub fn guesses_anywhere(&self, frame: &RgbdFrame, features: &Features) -> Vec<Guess> {
        let similar = (self.places).most_similar(&PlaceDescriptor::new(frame), CANDIDATES);
        sorted((similar.iter()).filter_map(|similar| self.known(similar.id)?.guess(features)))
    }

    /// How far up what is remembered reaches, metres along -y; `None` if that is nothing.
    pub fn highest_m(&self) -> Option<f64> {
        let heights = self.keyframes.iter();
        let heights = heights.map(|keyframe| -keyframe.world_from_camera.translation.y);
        heights.max_by(f64::total_cmp)
    }

    /// All that are remembered, the one most like a frame first.
    pub fn similar_to(&self, frame: &RgbdFrame) -> Vec<Similar> {
        (self.places).most_similar(&PlaceDescriptor::new(frame), self.keyframes.len())
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

    /// Keyframes were moved.
    pub fn move_keyframes(&mut self, motions: &Motions) {
        for keyframe in &mut self.keyframes {
            motions.apply(keyframe.id, &mut keyframe.world_from_camera);
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
        let guess = Guess::new(frame, &self.features, &self.world_from_camera)?;
        Some(Guess {
            keyframe: Some(self.id),
            ..guess
        })
    }
}

impl Guess {
    /// From the corners that a frame has in common with another, whose pose is known.
    fn new(frame: &Features, other: &Features, world_from_other: &Se3) -> Option<Self> {
        let matches = match_features(other, frame);
        let relative = relative_pose(other, frame, &matches, SEED)?;
        Some(Self {
            keyframe: None,
            world_from_camera: *world_from_other * relative.a_from_b,
            information: relative.information,
            inliers: relative.inliers,
        })
    }
}

/// Whether a frame shows what the one before it shows, from nearby.
pub fn follows(frame: &RgbdFrame, before: &RgbdFrame) -> bool {
    let (frame, before) = (Features::detect(frame), Features::detect(before));
    Guess::new(&frame, &before, &Se3::identity()).is_some()
}

/// By falling number of inliers.
fn sorted(guesses: impl Iterator<Item = Guess>) -> Vec<Guess> {
    let mut guesses: Vec<_> = guesses.collect();
    guesses.sort_by_key(|guess| std::cmp::Reverse(guess.inliers));
    guesses
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use fgs_synth::{SensorModel, Sequence, kinect_camera};

    use super::*;
    use crate::keyframes::KeyframeKind;

    #[test]
    fn of_too_many_keyframes_the_one_that_showed_the_least_new_is_forgotten() {
        let camera = kinect_camera(160, 120).unwrap();
        let rooms = [1, 2, 3].map(|room| Sequence::new(room, 40, camera, SensorModel::exact()));
        let mut relocalizer = Relocalizer::default();
        // The third shows what the first does, in another room than those between.
        let frames = [(0, 0), (1, 0), (0, 1), (2, 0), (2, 9)];
        for (id, (room, index)) in (0..).zip(frames) {
            let forgotten = relocalizer.add(&Keyframe {
                id: KeyframeId(id),
                kind: KeyframeKind::Mapping,
                frame: Arc::new(rooms[room].frame(index)),
                world_from_camera: Se3::identity(),
                previous: None,
                information: None,
                new_points: Vec::new(),
            });
            assert_eq!(forgotten, None);
        }
        let frame = rooms[0].frame(2);
        let features = Features::detect(&frame);
        assert_eq!(relocalizer.guesses_anywhere(&frame, &features).len(), 2);
        assert_eq!(relocalizer.forget_one_beyond(5), None);
        assert_eq!(relocalizer.forget_one_beyond(4), Some(KeyframeId(2)));
        assert!(relocalizer.knows(KeyframeId(0)) && !relocalizer.knows(KeyframeId(2)));
        assert!(
            relocalizer
                .relative_pose(KeyframeId(0), KeyframeId(2))
                .is_none()
        );
        assert_eq!(relocalizer.similar_to(&frame).len(), 4);
        // The place is still found, by its first keyframe.
        assert_eq!(relocalizer.guesses_anywhere(&frame, &features).len(), 1);
        // However much the newest is like others, it stays.
        relocalizer.forget_one_beyond(3);
        relocalizer.forget_one_beyond(2);
        assert_eq!(relocalizer.forget_one_beyond(1), Some(KeyframeId(0)));
        assert!(relocalizer.knows(KeyframeId(4)));
    }
}
