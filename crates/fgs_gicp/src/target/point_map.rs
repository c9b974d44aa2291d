//! An incremental map of points with ids, stored in cubic cells: the target of a registration.
//!
//! Inserting, moving and removing a point is O(1). The nearest point within a given distance is
//! found exactly, in constant time if the point density is bounded. Cells of about three times the
//! search distance are fastest.
//! Invariant: of equally near points the one with the smallest id is returned, so results do not
//! depend on the order of insertion.

use std::collections::HashMap;

use nalgebra::Vector3;

use super::cell_grid::{CellGrid, rounding_m};
use super::nearest_two::NearestTwo;
use crate::Point;

/// A point of the map found by a search.
#[derive(Clone, Copy, Debug)]
pub struct Neighbor<'a> {
    /// The point's id.
    pub id: u64,
    /// The point.
    pub point: &'a Point,
    /// Squared distance to the query, square metres.
    pub squared_distance: f32,
}

/// Points with ids, searchable by position.
#[derive(Clone, Debug)]
pub struct PointMap {
    cells: CellGrid,
    slots: Vec<(u64, Point)>,
    slot_from_id: HashMap<u64, u32>,
    /// Slots of removed points, to be reused.
    free: Vec<u32>,
}

impl PointMap {
    /// An empty map with cubic cells of the given side. A side that is not a positive number is
    /// replaced by 1 m, which affects only speed.
    pub fn new(cell_size_m: f32) -> Self {
        Self {
            cells: CellGrid::new(cell_size_m),
            slots: Vec::new(),
            slot_from_id: HashMap::new(),
            free: Vec::new(),
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.slot_from_id.len()
    }

    /// Whether the map holds no points.
    pub fn is_empty(&self) -> bool {
        self.slot_from_id.is_empty()
    }

    /// The point with an id.
    pub fn get(&self, id: u64) -> Option<&Point> {
        let slot = *self.slot_from_id.get(&id)?;
        Some(&self.slots[slot as usize].1)
    }

    /// Inserts a point under an id, replacing the point that had this id. A point that is not
    /// finite is not inserted; the old one is removed all the same, and `false` is returned.
    pub fn insert(&mut self, id: u64, point: Point) -> bool {
        self.remove(id);
        if !point.is_finite() {
            return false;
        }
        let slot = match self.free.pop() {
            Some(slot) => {
                self.slots[slot as usize] = (id, point);
                slot
            }
            None => {
                self.slots.push((id, point));
                (self.slots.len() - 1) as u32
            }
        };
        self.slot_from_id.insert(id, slot);
        self.cells.insert(&point.position, slot);
        true
    }

    /// Removes the point with this id and returns it.
    pub fn remove(&mut self, id: u64) -> Option<Point> {
        let slot = self.slot_from_id.remove(&id)?;
        let point = self.slots[slot as usize].1;
        self.cells.remove(&point.position, slot);
        self.free.push(slot);
        Some(point)
    }

    /// The nearest point at most `max_distance_m` away.
    #[inline]
    pub fn nearest(&self, query: &Vector3<f32>, max_distance_m: f32) -> Option<Neighbor<'_>> {
        let found = self.cells.nearest_two(query, max_distance_m, 0.0);
        let squared_distance = found.squared_distance();
        if squared_distance <= max_distance_m * max_distance_m {
            let slot = self.smallest_id(query, &found)?;
            return Some(self.neighbor(slot, squared_distance));
        }
        None
    }

    /// The nearest point at most `max_distance_m` away, with the radius around the query within
    /// which it remains the nearest. That radius is at most half of `margin_m`; a larger margin
    /// makes the search slower.
    #[inline(always)]
    pub(crate) fn lasting_nearest(
        &self,
        query: &Vector3<f32>,
        max_distance_m: f32,
        margin_m: f32,
    ) -> LastingNearest {
        let found = self.cells.nearest_two(query, max_distance_m, margin_m);
        let distance = found.squared_distance().sqrt();
        let (slot, radius) = if distance <= max_distance_m {
            // Lower bound on the distance of any other point, since points beyond the margin were
            // not searched.
            let next = found.next_squared_distance().sqrt();
            let stays_nearest = 0.5 * (next.min(distance + margin_m) - distance);
            let slot = self.smallest_id(query, &found);
            (slot, stays_nearest.min(max_distance_m - distance))
        } else {
            let stays_away = distance.min(max_distance_m + margin_m) - max_distance_m;
            (None, stays_away)
        };
        LastingNearest {
            slot,
            query: *query,
            radius_m: radius - rounding_m(query, max_distance_m),
        }
    }

    /// The point in a slot returned by a search.
    #[inline]
    pub(crate) fn point_in(&self, slot: u32) -> &Point {
        &self.slots[slot as usize].1
    }

    /// The `count` nearest points at most `max_distance_m` away, nearest first.
    pub fn k_nearest(
        &self,
        query: &Vector3<f32>,
        count: usize,
        max_distance_m: f32,
    ) -> Vec<Neighbor<'_>> {
        let mut found = Vec::new();
        let limit = max_distance_m * max_distance_m;
        self.cells
            .for_points_within(query, max_distance_m, |squared_distance, slot| {
                if squared_distance <= limit {
                    found.push(self.neighbor(slot, squared_distance));
                }
            });
        found.sort_by(|a, b| {
            let by_distance = a.squared_distance.total_cmp(&b.squared_distance);
            by_distance.then(a.id.cmp(&b.id))
        });
        found.truncate(count);
        found
    }

    fn neighbor(&self, slot: u32, squared_distance: f32) -> Neighbor<'_> {
        let (id, point) = &self.slots[slot as usize];
        Neighbor {
            id: *id,
            point,
            squared_distance,
        }
    }

    /// The nearest point found; in case of a tie, the one with the smallest id.
    #[inline(always)]
    fn smallest_id(&self, query: &Vector3<f32>, found: &NearestTwo) -> Option<u32> {
        let slot = found.slot()?;
        let nearest = found.squared_distance();
        if found.next_squared_distance() > nearest {
            return Some(slot);
        }
        Some(self.smallest_id_at(query, nearest, slot))
    }

    /// The point with the smallest id at exactly this squared distance; `slot` is one of them.
    #[cold]
    fn smallest_id_at(&self, query: &Vector3<f32>, squared_distance: f32, mut slot: u32) -> u32 {
        let id = |slot: u32| self.slots[slot as usize].0;
        self.cells
            .for_points_within(query, squared_distance.sqrt(), |squared, other| {
                if squared == squared_distance && id(other) < id(slot) {
                    slot = other;
                }
            });
        slot
    }
}

/// The result of a nearest-neighbour search, with the radius around the query within which it
/// remains valid. Lets registration skip searches after small steps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LastingNearest {
    pub(crate) slot: Option<u32>,
    query: Vector3<f32>,
    radius_m: f32,
}

impl LastingNearest {
    /// No search has been done yet.
    pub(crate) fn unknown() -> Self {
        Self {
            slot: None,
            query: Vector3::zeros(),
            radius_m: -1.0,
        }
    }

    /// Whether a new search at `query` is certain to give the same result.
    #[inline]
    pub(crate) fn holds_at(&self, query: &Vector3<f32>) -> bool {
        self.radius_m > 0.0 && (query - self.query).norm_squared() < self.radius_m * self.radius_m
    }
}

#[cfg(test)]
#[path = "point_map_tests.rs"]
mod tests;
