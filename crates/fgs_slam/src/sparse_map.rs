//! The tracker's copy of the sparse map: positions and covariances of its gaussians as they were
//! measured, in a point map that grows, and shrinks where the mapper prunes.
//!
//! Every point is anchored to the keyframe that brought it and moves with it. A keyframe's points
//! have consecutive ids, so that anchors take one entry per keyframe.

use std::ops::Range;

use fgs_geom::KeyframeId;
use fgs_gicp::{Point, PointMap};
use fgs_splat::SparseId;
use serde::{Deserialize, Serialize};

use crate::keyframes::Motions;
use crate::merge::Renumbering;

/// Side of the point map's cells as a multiple of the search distance. Affects speed only: from 3
/// to 6 it makes no difference; at 1 tracking takes twice as long.
const CELL_DISTANCES: f32 = 4.0;

/// The sparse map.
pub struct SparseMap {
    points: PointMap,
    /// Each keyframe that brought points, with the first of its ids; ascending.
    anchors: Vec<(u32, KeyframeId)>,
    next_id: u32,
}

/// A sparse map as plain data.
#[derive(Clone, Default, Serialize, Deserialize)]
pub struct SavedSparseMap {
    points: Vec<(u64, Point)>,
    anchors: Vec<(u32, KeyframeId)>,
    next_id: u32,
}

impl SavedSparseMap {
    /// The number of the next point.
    pub fn next_id(&self) -> u32 {
        self.next_id
    }

    /// Takes in another map.
    pub fn append(&mut self, other: Self, renumbering: Renumbering) {
        let points = other.points.into_iter();
        self.points
            .extend(points.map(|(id, point)| (id.saturating_add(self.next_id.into()), point)));
        let anchors = other.anchors.into_iter().map(|(first, anchor)| {
            let SparseId(first) = renumbering.sparse(SparseId(first));
            (first, renumbering.keyframe(anchor))
        });
        self.anchors.extend(anchors);
        self.next_id = self.next_id.saturating_add(other.next_id);
    }
}

impl SparseMap {
    /// A map that is searched up to this distance.
    pub fn restored(search_distance_m: f64, saved: SavedSparseMap) -> Self {
        let mut points = PointMap::new(CELL_DISTANCES * search_distance_m as f32);
        for (id, point) in saved.points {
            points.insert(id, point);
        }
        Self {
            points,
            anchors: saved.anchors,
            next_id: saved.next_id,
        }
    }

    /// Everything but the settings.
    pub fn save(&self) -> SavedSparseMap {
        let points = self.anchored(|_| true);
        SavedSparseMap {
            points: points.map(|(id, point)| (id, *point)).collect(),
            anchors: self.anchors.clone(),
            next_id: self.next_id,
        }
    }

    /// The target of a registration.
    pub fn points(&self) -> &PointMap {
        &self.points
    }

    /// The points, with their ids, that are anchored to one of some keyframes.
    pub fn anchored(
        &self,
        is_wanted: impl Fn(KeyframeId) -> bool,
    ) -> impl Iterator<Item = (u64, &Point)> {
        self.ids_by_anchor()
            .filter(move |(anchor, _)| is_wanted(*anchor))
            .flat_map(|(_, ids)| ids)
            .filter_map(|id| Some((id, self.points.get(id)?)))
    }

    /// Lets those of a keyframe's points (world axes) join that are further than `spacing_m` from
    /// every point so far; their positions in the input, and their ids.
    pub fn extend(
        &mut self,
        anchor: KeyframeId,
        in_world: &[Point],
        spacing_m: f64,
    ) -> Vec<(usize, SparseId)> {
        // Decided before any joins: a frame's own points do not keep each other out.
        let new: Vec<usize> = (0..in_world.len())
            .filter(|&i| {
                let position = &in_world[i].position;
                self.points.nearest(position, spacing_m as f32).is_none()
            })
            .collect();
        self.anchors.push((self.next_id, anchor));
        new.into_iter()
            .map(|i| {
                let id = self.next_id;
                self.next_id += 1;
                self.points.insert(id.into(), in_world[i]);
                (i, SparseId(id))
            })
            .collect()
    }

    /// Forgets points.
    pub fn remove(&mut self, ids: &[SparseId]) {
        for id in ids {
            self.points.remove(id.0.into());
        }
    }

    /// Moves the points anchored to each keyframe with it.
    pub fn move_anchored(&mut self, motions: &Motions) {
        let ids_of_moved: Vec<_> = self
            .ids_by_anchor()
            .filter_map(|(anchor, ids)| Some((motions.of(anchor)?, ids)))
            .collect();
        for (new_from_old, ids) in ids_of_moved {
            for id in ids {
                if let Some(point) = self.points.get(id) {
                    let moved = point.transformed(new_from_old);
                    self.points.insert(id, moved);
                }
            }
        }
    }

    /// Each keyframe that brought points, with the range of their ids.
    fn ids_by_anchor(&self) -> impl Iterator<Item = (KeyframeId, Range<u64>)> {
        let ends = self.anchors.iter().skip(1).map(|(first, _)| *first);
        let ends = ends.chain([self.next_id]);
        let both = self.anchors.iter().zip(ends);
        both.map(|((first, anchor), end)| (*anchor, (*first).into()..end.into()))
    }
}

#[cfg(test)]
mod tests {
    use fgs_geom::Se3;
    use fgs_gicp::Covariance;
    use nalgebra::{Matrix3, Vector3, Vector6};

    use super::*;

    fn points(z: f32) -> Vec<Point> {
        let covariance = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 1e-3));
        let covariance = Covariance::regularized(&covariance).unwrap();
        let at = |i| Point {
            position: Vector3::new(0.1 * i as f32, 0.0, z),
            covariance,
        };
        (0..4).map(at).collect()
    }

    fn map() -> SparseMap {
        let mut map = SparseMap::restored(0.03, SavedSparseMap::default());
        map.extend(KeyframeId(0), &points(1.0), 0.02);
        map.extend(KeyframeId(3), &points(2.0), 0.02);
        map
    }

    #[test]
    fn only_what_is_new_joins() {
        let mut map = map();
        let mut some = points(1.0);
        some[2].position.y = 0.5;
        let joined = map.extend(KeyframeId(4), &some, 0.02);
        assert_eq!(joined, [(2, SparseId(8))]);
        assert_eq!(map.points().len(), 9);
        map.remove(&[SparseId(8), SparseId(8), SparseId(99)]);
        assert_eq!(map.points().len(), 8);
    }

    #[test]
    fn a_moved_keyframe_moves_exactly_its_points_and_back() {
        let (mut map, before) = (map(), map());
        let motion = Se3::exp(&Vector6::new(0.3, -0.2, 0.5, 0.4, 0.1, -0.6));
        map.move_anchored(&Motions::new(&[
            (KeyframeId(3), motion),
            (KeyframeId(7), motion),
        ]));
        for id in 0..4 {
            assert_eq!(map.points().get(id), before.points().get(id));
        }
        for id in 4..8 {
            let (new, old) = (map.points().get(id), before.points().get(id));
            assert_eq!(new.copied(), old.map(|point| point.transformed(&motion)));
            // It is found where it now is.
            let found = map.points().nearest(&new.unwrap().position, 1e-3);
            assert_eq!(found.unwrap().id, id);
        }
        map.move_anchored(&Motions::new(&[(KeyframeId(3), motion.inverse())]));
        for id in 4..8 {
            let (new, old) = (map.points().get(id), before.points().get(id));
            let error = new.unwrap().position - old.unwrap().position;
            assert!(error.norm() <= 1e-6);
        }
    }
}
