//! Sub-maps: parts of what a session has recorded that nothing connects yet. Each has axes of its own, and
//! they lie so far apart that no frame sees anything of another.
//!
//! A camera that is lost for a while where nothing is known starts one. Two become one when a keyframe of
//! the one shows what the other shows (loops/).
//!
//! Differs from the paper, which has one map and never loses the camera.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use fgs_geom::KeyframeId;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::merge::Renumbering;

/// A new sub-map begins so far above all that is known, metres. Farther than any building is high, and near
/// enough for single precision to tell a hundredth of a millimetre. Above, since cameras hardly look there.
pub const APART_M: f64 = 100.0;

/// Which sub-map each keyframe belongs to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Submaps {
    /// The keyframes from which on another sub-map is meant, with its number; ascending. Numbers are given in
    /// the order in which sub-maps began.
    runs: Vec<(KeyframeId, usize)>,
    /// By number: where the first camera was, metres in the session's axes, which are parallel.
    origins: Vec<Vector3<f64>>,
}

impl Submaps {
    /// A keyframe joined the sub-map of the keyframe before it, or starts one.
    pub fn add(&mut self, id: KeyframeId, previous: Option<KeyframeId>, position: Vector3<f64>) {
        let submap = previous
            .and_then(|previous| self.of(previous))
            .unwrap_or_else(|| {
                self.origins.push(position);
                self.origins.len() - 1
            });
        if self.runs.last().is_none_or(|(_, last)| *last != submap) {
            self.runs.push((id, submap));
        }
    }

    /// The sub-map of a keyframe; `None` of one before all.
    pub fn of(&self, id: KeyframeId) -> Option<usize> {
        let after = self.runs.partition_point(|(first, _)| *first <= id);
        Some(self.runs.get(after.checked_sub(1)?)?.1)
    }

    /// Whether two keyframes are of different sub-maps.
    pub fn are_apart(&self, a: KeyframeId, b: KeyframeId) -> bool {
        self.of(a) != self.of(b)
    }

    /// The sub-maps of two keyframes become one, which has the number and the origin of the older.
    pub fn join(&mut self, a: KeyframeId, b: KeyframeId) {
        let (Some(a), Some(b)) = (self.of(a), self.of(b)) else {
            return;
        };
        for (_, submap) in &mut self.runs {
            if *submap == a.max(b) {
                *submap = a.min(b);
            }
        }
        self.runs.dedup_by_key(|(_, submap)| *submap);
    }

    /// Takes in the sub-maps of another session's keyframes, which are about to go `away`, metres.
    pub fn append(&mut self, other: Self, renumbering: Renumbering, away: Vector3<f64>) {
        let before = self.origins.len();
        let runs = other.runs.into_iter();
        self.runs
            .extend(runs.map(|(id, submap)| (renumbering.keyframe(id), before + submap)));
        self.origins
            .extend(other.origins.into_iter().map(|origin| origin + away));
    }

    /// Where the axes of a sub-map have their origin, metres in the session's.
    pub fn origin(&self, submap: usize) -> Vector3<f64> {
        self.origins.get(submap).copied().unwrap_or_default()
    }

    /// Whether it can be that of some keyframes.
    pub fn is_consistent(&self, first: Option<KeyframeId>) -> bool {
        self.runs.is_sorted_by(|(a, _), (b, _)| a < b)
            && self.runs.first().map(|(id, _)| *id) == first
            && self
                .runs
                .iter()
                .all(|(_, submap)| *submap < self.origins.len())
    }

    /// The sub-maps of some keyframes, those with the most first, of equal ones the older.
    pub fn by_size(&self, keyframes: impl Iterator<Item = KeyframeId>) -> Vec<usize> {
        let mut counts = BTreeMap::<usize, usize>::new();
        for submap in keyframes.filter_map(|id| self.of(id)) {
            *counts.entry(submap).or_default() += 1;
        }
        let mut order: Vec<usize> = counts.keys().copied().collect();
        order.sort_by_key(|submap| Reverse(counts[submap]));
        order
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn id(number: u32) -> KeyframeId {
        KeyframeId(number)
    }

    /// Keyframes 0 to 2 in the first, 3 and 4 in the second, 5 in the first again, 6 to 9 in the third.
    fn three() -> Submaps {
        let mut submaps = Submaps::default();
        for (number, previous) in [None, Some(0), Some(1), None, Some(3), Some(1), None]
            .into_iter()
            .enumerate()
        {
            let number = number as u32;
            let position = Vector3::repeat(f64::from(number));
            submaps.add(id(number), previous.map(id), position);
        }
        for number in 7..10 {
            submaps.add(id(number), Some(id(number - 1)), Vector3::zeros());
        }
        submaps
    }

    fn numbers(submaps: &Submaps) -> Vec<usize> {
        (0..10)
            .map(|number| submaps.of(id(number)).unwrap())
            .collect()
    }

    #[test]
    fn keyframes_are_in_the_submap_that_they_were_tracked_from() {
        let submaps = three();
        assert_eq!(numbers(&submaps), [0, 0, 0, 1, 1, 0, 2, 2, 2, 2]);
        assert_eq!(submaps.origin(1), Vector3::repeat(3.0));
        assert!(submaps.are_apart(id(2), id(3)) && !submaps.are_apart(id(2), id(5)));
        assert_eq!(submaps.by_size((0..10).map(id)), [0, 2, 1]);
        assert_eq!(submaps.by_size((3..10).map(id)), [2, 1, 0]);
        assert!(submaps.is_consistent(Some(id(0))) && !submaps.is_consistent(Some(id(1))));
    }

    #[test]
    fn the_newer_of_two_that_meet_becomes_the_older() {
        let mut submaps = three();
        submaps.join(id(8), id(4));
        assert_eq!(numbers(&submaps), [0, 0, 0, 1, 1, 0, 1, 1, 1, 1]);
        submaps.join(id(0), id(6));
        assert_eq!(numbers(&submaps), [0; 10]);
        assert_eq!(submaps.by_size((0..10).map(id)), [0]);
        // The next has a number of its own.
        submaps.add(id(10), None, Vector3::zeros());
        assert_eq!(submaps.of(id(10)), Some(3));
    }
}
