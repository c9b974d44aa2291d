//! The keyframes that can be found again.

use std::collections::BTreeMap;

use fgs_geom::{Camera, KeyframeId, Se3};
use nalgebra::{UnitQuaternion, Vector3};

use crate::PlaceDescriptor;
use crate::fern::{Codes, similarity};

/// What keyframes show: 256 bytes for each.
#[derive(Clone, Debug, Default)]
pub struct PlaceIndex {
    codes: BTreeMap<KeyframeId, Codes>,
}

/// A keyframe that may show what a frame shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similar {
    /// The keyframe.
    pub id: KeyframeId,
    /// 1: everything agrees. 0: no more alike than unrelated images are. Parts without contrast
    /// or shifted out of the image agree with nothing, so that the same image may have 0.95.
    /// Recordings of four rooms: every wrong keyframe is below 0.15.
    pub similarity: f64,
    /// By how much the frame's content is shifted against the keyframe's, in widths and heights of
    /// the image: what the keyframe shows at column u, the frame shows near u + shift\[0\] * width.
    pub shift: [f64; 2],
}

impl PlaceIndex {
    /// Adds a keyframe, or describes it anew.
    pub fn add(&mut self, id: KeyframeId, descriptor: &PlaceDescriptor) {
        self.codes.insert(id, descriptor.unmoved);
    }

    /// Forgets a keyframe, if it is known.
    pub fn remove(&mut self, id: KeyframeId) {
        self.codes.remove(&id);
    }

    /// The keyframes most similar to a frame, `count` at most, the best first; of equals, the older
    /// first. Takes about 1.4 ms for 1000 keyframes.
    pub fn most_similar(&self, frame: &PlaceDescriptor, count: usize) -> Vec<Similar> {
        let compared = self
            .codes
            .iter()
            .map(|(id, codes)| compare(*id, codes, frame));
        let mut similar: Vec<Similar> = compared.collect();
        similar.sort_by(|a, b| b.similarity.total_cmp(&a.similarity));
        similar.truncate(count);
        similar
    }
}

/// At the shift where the keyframe and the frame are the most similar.
fn compare(id: KeyframeId, keyframe: &Codes, frame: &PlaceDescriptor) -> Similar {
    let mut best = Similar {
        id,
        similarity: similarity(keyframe, &frame.unmoved),
        shift: [0.0; 2],
    };
    for moved in &frame.moved {
        let similarity = similarity(keyframe, &moved.codes);
        if similarity > best.similarity {
            best = Similar {
                id,
                similarity,
                shift: moved.shift,
            };
        }
    }
    best
}

impl Similar {
    /// The frame's pose relative to the keyframe if the camera has only turned, about an axis in
    /// the image plane. A start for registration.
    pub fn keyframe_from_frame(&self, camera: &Camera) -> Se3 {
        let forward = Vector3::z();
        let seen_at = Vector3::new(
            self.shift[0] * camera.width as f64 / camera.intrinsics.fx,
            self.shift[1] * camera.height as f64 / camera.intrinsics.fy,
            1.0,
        );
        // The angle is below 90 degrees, where a rotation between two directions always exists.
        let rotation = UnitQuaternion::rotation_between(&seen_at, &forward);
        Se3::new(rotation.unwrap_or_default(), Vector3::zeros())
    }
}

#[cfg(test)]
mod tests {
    use fgs_geom::{FrameIndex, Image, RgbdFrame};

    use super::*;

    const CAMERA: Camera = Camera {
        width: 40,
        height: 30,
        intrinsics: fgs_geom::Intrinsics {
            fx: 30.0,
            fy: 35.0,
            cx: 19.5,
            cy: 14.5,
        },
    };

    /// Patches of colour and depth that depend on `place`.
    fn descriptor(place: usize) -> PlaceDescriptor {
        let hash = |u, v| (u / 4 * 37 + v / 4 * 101 + place * 59) * 2_654_435_761_usize;
        let color = Image::from_fn(40, 30, |u, v| {
            [8, 13, 21].map(|bits| (hash(u, v) >> bits) as u8)
        });
        let depth_m = Image::from_fn(40, 30, |u, v| (hash(u, v) >> 10 & 3) as f32);
        let frame = RgbdFrame::new(FrameIndex(0), 0.0, color, depth_m, CAMERA);
        PlaceDescriptor::new(&frame.unwrap())
    }

    fn ids(found: &[Similar]) -> Vec<u32> {
        found.iter().map(|similar| similar.id.0).collect()
    }

    #[test]
    fn keyframes_are_added_changed_and_removed() {
        let [a, b] = [1, 2].map(descriptor);
        let mut index = PlaceIndex::default();
        assert_eq!(index.most_similar(&a, 3), []);
        for (id, descriptor) in [(7, &b), (3, &a), (5, &a)] {
            index.add(KeyframeId(id), descriptor);
        }
        let found = index.most_similar(&a, 9);
        assert_eq!(ids(&found), [3, 5, 7]);
        assert!(found[0].similarity > 0.9 && found[0].shift == [0.0; 2]);
        assert!(found[2].similarity < 0.4, "{:?}", found[2]);
        assert_eq!(ids(&index.most_similar(&b, 1)), [7]);

        index.add(KeyframeId(3), &b);
        assert_eq!(ids(&index.most_similar(&a, 1)), [5]);
        index.remove(KeyframeId(5));
        index.remove(KeyframeId(6));
        assert_eq!(ids(&index.most_similar(&b, 9)), [3, 7]);
    }

    /// What a keyframe shows in the middle, the turned camera sees at the shift.
    #[test]
    fn the_shift_gives_the_rotation() {
        for shift in [[0.2, -0.1], [0.0, 0.2], [0.0, 0.0]] {
            let similar = Similar {
                id: KeyframeId(0),
                similarity: 0.5,
                shift,
            };
            let frame_from_keyframe = similar.keyframe_from_frame(&CAMERA).inverse();
            let ray = frame_from_keyframe.transform(&Vector3::new(0.0, 0.0, 2.0));
            assert!((ray.x / ray.z * 30.0 - shift[0] * 40.0).abs() < 1e-9);
            assert!((ray.y / ray.z * 35.0 - shift[1] * 30.0).abs() < 1e-9);
        }
    }
}
