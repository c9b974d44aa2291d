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
    /// 1: the same image. 0: no more alike than unrelated images are.
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
    /// first. Takes about 1 ms for 1000 keyframes.
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
