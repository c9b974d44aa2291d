//! An incremental map of points in hashed cubic cells, the target of a registration.
//!
//! Inserting, moving and removing a point is O(1); the nearest point within a distance is found
//! exactly, in constant time where the density of points is bounded. Cells of about the search
//! distance are fastest.
//! Invariant: of equally near points the one with the smallest id is found, so that answers do not
//! depend on the order of insertion.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hash, Hasher};

use nalgebra::Vector3;

use super::cell::{CellPoints, NearestTwo};
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

/// Points with ids, to be searched by position.
#[derive(Clone, Debug)]
pub struct PointMap {
    cell_size_m: f32,
    cells_per_m: f32,
    cells: HashMap<Cell, CellPoints, BuildHasherDefault<CellHasher>>,
    slots: Vec<(u64, Point)>,
    slot_from_id: HashMap<u64, u32>,
    /// Slots whose points were removed, to be used again.
    free: Vec<u32>,
}

/// Integer coordinates of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cell {
    x: i32,
    y: i32,
    z: i32,
}

impl PointMap {
    /// An empty map with cubic cells of the given side. A side that is not a positive number is
    /// replaced by 1 m: it affects speed alone.
    pub fn new(cell_size_m: f32) -> Self {
        let cells_per_m = 1.0 / cell_size_m;
        let usable = cells_per_m.is_normal() && cells_per_m > 0.0;
        Self {
            cell_size_m: if usable { cell_size_m } else { 1.0 },
            cells_per_m: if usable { cells_per_m } else { 1.0 },
            cells: HashMap::default(),
            slots: Vec::new(),
            slot_from_id: HashMap::new(),
            free: Vec::new(),
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.slot_from_id.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.slot_from_id.is_empty()
    }

    /// The point with an id.
    pub fn get(&self, id: u64) -> Option<&Point> {
        let slot = *self.slot_from_id.get(&id)?;
        Some(&self.slots[slot as usize].1)
    }

    /// Puts a point under an id, in place of the one that had it. A point that is not finite is
    /// not put in, and `false` returned.
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
        self.cells
            .entry(self.cell_of(&point.position))
            .or_default()
            .push(&point.position, slot);
        true
    }

    /// Takes the point with an id out and returns it.
    pub fn remove(&mut self, id: u64) -> Option<Point> {
        let slot = self.slot_from_id.remove(&id)?;
        let point = self.slots[slot as usize].1;
        let cell = self.cell_of(&point.position);
        if let Some(points) = self.cells.get_mut(&cell) {
            points.remove(slot);
            if points.is_empty() {
                self.cells.remove(&cell);
            }
        }
        self.free.push(slot);
        Some(point)
    }

    /// The nearest point at most `max_distance_m` away.
    #[inline]
    pub fn nearest(&self, query: &Vector3<f32>, max_distance_m: f32) -> Option<Neighbor<'_>> {
        let found = self.search(query, max_distance_m, 0.0);
        let squared_distance = found.squared_distance();
        (squared_distance <= max_distance_m * max_distance_m).then(|| {
            let slot = self.smallest_id(query, &found);
            self.neighbor(slot, squared_distance)
        })
    }

    /// The nearest point at most `max_distance_m` away, with a radius in which it stays so. That
    /// radius is at most half of `margin_m`; larger ones take longer to find.
    #[inline(always)]
    pub(crate) fn lasting_nearest(
        &self,
        query: &Vector3<f32>,
        max_distance_m: f32,
        margin_m: f32,
    ) -> LastingNearest {
        let found = self.search(query, max_distance_m, margin_m);
        let distance = found.squared_distance().sqrt();
        let (slot, radius) = if distance <= max_distance_m {
            // No other point is nearer than this: those beyond the margin were not looked at.
            let next = found.next_squared_distance().sqrt();
            let stays_nearest = 0.5 * (next.min(distance + margin_m) - distance);
            let slot = self.smallest_id(query, &found);
            (Some(slot), stays_nearest.min(max_distance_m - distance))
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

    /// The point in a slot that a search has found.
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
        self.for_cells_within(query, max_distance_m, |cell, _| {
            let Some(points) = self.cells.get(&cell) else {
                return;
            };
            points.for_each(query, |squared_distance, slot| {
                if squared_distance <= limit {
                    found.push(self.neighbor(slot, squared_distance));
                }
            });
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

    /// The nearest and the next nearest point, exact as far as `max_distance_m + margin_m`, the
    /// next one also only as far as the nearest's distance plus the margin.
    #[inline(always)]
    fn search(&self, query: &Vector3<f32>, max_distance_m: f32, margin_m: f32) -> NearestTwo {
        let mut found = NearestTwo::NONE;
        let own = self.cell_of(query);
        if let Some(points) = self.cells.get(&own) {
            found.add(points, query);
        }
        let reach = (max_distance_m + margin_m).powi(2);
        // Points beyond this squared distance are of no interest. Not below the nearest point
        // itself by rounding: its equals are to be met too.
        let limit_of = |found: &NearestTwo| {
            let nearest = found.squared_distance();
            reach.min((nearest.sqrt() + margin_m).powi(2).max(nearest))
        };
        let mut limit = limit_of(&found);
        // What the own cell holds usually leaves few other cells, if any, within reach.
        self.for_cells_within(
            query,
            limit.sqrt(),
            #[inline(always)]
            |cell, squared_gap| {
                if cell != own
                    && squared_gap <= limit
                    && let Some(points) = self.cells.get(&cell)
                {
                    found.add(points, query);
                    limit = limit_of(&found);
                }
            },
        );
        found
    }

    /// Of the nearest points that a search has found, the one with the smallest id.
    #[inline(always)]
    fn smallest_id(&self, query: &Vector3<f32>, found: &NearestTwo) -> u32 {
        let nearest = found.squared_distance();
        if found.next_squared_distance() > nearest {
            return found.slot();
        }
        self.smallest_id_at(query, nearest, found.slot())
    }

    /// Of the points at a squared distance, `slot` among them, the one with the smallest id.
    #[cold]
    fn smallest_id_at(&self, query: &Vector3<f32>, squared_distance: f32, mut slot: u32) -> u32 {
        let id = |slot: u32| self.slots[slot as usize].0;
        self.for_cells_within(query, squared_distance.sqrt(), |cell, _| {
            if let Some(points) = self.cells.get(&cell) {
                points.for_each(query, |squared, other| {
                    if squared == squared_distance && id(other) < id(slot) {
                        slot = other;
                    }
                });
            }
        });
        slot
    }

    /// Calls `visit(cell, squared_gap)` with every cell that may hold a point within `distance_m`
    /// of `query`. No point of the cell is nearer than the gap.
    #[inline(always)]
    fn for_cells_within(
        &self,
        query: &Vector3<f32>,
        distance_m: f32,
        mut visit: impl FnMut(Cell, f32),
    ) {
        let rounding_m = rounding_m(query, distance_m);
        let reach = distance_m + rounding_m;
        let low = self.cell_of(&query.map(|x| x - reach));
        let high = self.cell_of(&query.map(|x| x + reach));
        let side = |low: i32, high: i32| f64::from(high) - f64::from(low) + 1.0;
        let cells = side(low.x, high.x) * side(low.y, high.y) * side(low.z, high.z);
        // A search far beyond the cells' size is quicker through the table itself.
        if cells > 64.0 && cells > self.cells.len() as f64 {
            self.cells.keys().for_each(|&cell| visit(cell, 0.0));
            return;
        }
        // Along one axis, from the query to the cell.
        let squared_gap = |cell: i32, x: f32| {
            let low = cell as f32 * self.cell_size_m;
            let gap = (low - x).max(x - low - self.cell_size_m) - rounding_m;
            gap.max(0.0).powi(2)
        };
        for x in low.x..=high.x {
            let gap_x = squared_gap(x, query.x);
            for y in low.y..=high.y {
                let gap_xy = gap_x + squared_gap(y, query.y);
                for z in low.z..=high.z {
                    visit(Cell { x, y, z }, gap_xy + squared_gap(z, query.z));
                }
            }
        }
    }

    /// Saturates far away, where one cell then holds all points.
    #[inline]
    fn cell_of(&self, position: &Vector3<f32>) -> Cell {
        // Rounds down; `f32::floor` is a function call on baseline x86-64.
        let coordinate = |x: f32| {
            let scaled = x * self.cells_per_m;
            let truncated = scaled as i32;
            truncated.saturating_sub(i32::from(scaled < truncated as f32))
        };
        Cell {
            x: coordinate(position.x),
            y: coordinate(position.y),
            z: coordinate(position.z),
        }
    }
}

/// Bounds the rounding error of distances up to `distance_m` from `query`, which is that of the
/// coordinates that they come from.
#[inline]
fn rounding_m(query: &Vector3<f32>, distance_m: f32) -> f32 {
    4.0 * f32::EPSILON * (query.amax() + distance_m)
}

/// The nearest point within a distance, and for how far around the query it stays so.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LastingNearest {
    pub(crate) slot: Option<u32>,
    query: Vector3<f32>,
    radius_m: f32,
}

impl LastingNearest {
    /// Knows nothing yet.
    pub(crate) fn unknown() -> Self {
        Self {
            slot: None,
            query: Vector3::zeros(),
            radius_m: -1.0,
        }
    }

    /// Whether a search at `query` would find the same point.
    #[inline]
    pub(crate) fn holds_at(&self, query: &Vector3<f32>) -> bool {
        self.radius_m > 0.0 && (query - self.query).norm_squared() < self.radius_m * self.radius_m
    }
}

impl Hash for Cell {
    /// Neighbouring cells differ in low bits, which a multiplication carries up. The odd factors'
    /// bits are well mixed: 2^64 over the three-dimensional golden ratio and its powers.
    #[inline]
    fn hash<H: Hasher>(&self, state: &mut H) {
        let factors = [
            0xd1b5_4a32_d192_ed03_u64,
            0xabc9_8388_fb8f_ac03,
            0x8cb9_2ba7_2f3d_8dd7,
        ];
        let mixed = [self.x, self.y, self.z]
            .into_iter()
            .zip(factors)
            .fold(0, |sum: u64, (x, factor)| {
                sum.wrapping_add((x as u64).wrapping_mul(factor))
            });
        state.write_u64(mixed);
    }
}

/// Takes a cell's hash as it is, but for the low bits, which a multiplication mixes least and the
/// table uses most. Fixed, so that runs repeat.
#[derive(Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u64(byte.into()));
    }

    #[inline]
    fn write_u64(&mut self, value: u64) {
        self.0 = self.0.rotate_left(23) ^ value;
    }

    #[inline]
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }
}

#[cfg(test)]
#[path = "point_map_tests.rs"]
mod tests;
