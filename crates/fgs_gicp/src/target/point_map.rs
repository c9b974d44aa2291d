//! An incremental map of points in hashed cubic cells, the target of a registration.
//!
//! Inserting, moving and removing a point is O(1); the nearest point within a distance is found
//! exactly, in constant time where the density of points is bounded. Cells of about the search
//! distance are fastest.
//! Invariant: of equally near points the one with the smallest id is found, so that answers do not
//! depend on the order of insertion.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use nalgebra::Vector3;

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
    cells_per_m: f32,
    cells: HashMap<Cell, Vec<Entry>, BuildHasherDefault<CellHasher>>,
    slots: Vec<(u64, Point)>,
    slot_from_id: HashMap<u64, u32>,
    /// Slots whose points were removed, to be used again.
    free: Vec<u32>,
}

/// Integer coordinates of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Cell {
    x: i32,
    y: i32,
    z: i32,
}

/// A point in its cell: what the search reads, side by side.
#[derive(Clone, Copy, Debug)]
struct Entry {
    position: Vector3<f32>,
    slot: u32,
}

impl PointMap {
    /// An empty map with cubic cells of the given side. A side that is not a positive number is
    /// replaced by 1 m: it affects speed alone.
    pub fn new(cell_size_m: f32) -> Self {
        let cells_per_m = 1.0 / cell_size_m;
        let usable = cells_per_m.is_normal() && cells_per_m > 0.0;
        Self {
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
        let entry = Entry {
            position: point.position,
            slot,
        };
        self.cells
            .entry(self.cell_of(&point.position))
            .or_default()
            .push(entry);
        true
    }

    /// Takes the point with an id out and returns it.
    pub fn remove(&mut self, id: u64) -> Option<Point> {
        let slot = self.slot_from_id.remove(&id)?;
        let point = self.slots[slot as usize].1;
        let cell = self.cell_of(&point.position);
        if let Some(entries) = self.cells.get_mut(&cell) {
            entries.retain(|entry| entry.slot != slot);
            if entries.is_empty() {
                self.cells.remove(&cell);
            }
        }
        self.free.push(slot);
        Some(point)
    }

    /// The nearest point at most `max_distance_m` away.
    #[inline]
    pub fn nearest(&self, query: &Vector3<f32>, max_distance_m: f32) -> Option<Neighbor<'_>> {
        let mut best = Nearest {
            squared_distance: max_distance_m * max_distance_m,
            slot: None,
        };
        let own = self.cell_of(query);
        self.search_cell(own, query, &mut best);
        // What the own cell holds usually leaves few other cells, if any, within reach.
        let reach = best.squared_distance.sqrt();
        self.for_cells_within(query, reach, |cell| {
            if cell != own {
                self.search_cell(cell, query, &mut best);
            }
        });
        best.slot
            .map(|slot| self.neighbor(slot, best.squared_distance))
    }

    /// The `count` nearest points at most `max_distance_m` away, nearest first.
    pub fn k_nearest(
        &self,
        query: &Vector3<f32>,
        count: usize,
        max_distance_m: f32,
    ) -> Vec<Neighbor<'_>> {
        let mut found = Vec::new();
        self.for_cells_within(query, max_distance_m, |cell| {
            for entry in self.cells.get(&cell).into_iter().flatten() {
                let squared_distance = (entry.position - query).norm_squared();
                if squared_distance <= max_distance_m * max_distance_m {
                    found.push(self.neighbor(entry.slot, squared_distance));
                }
            }
        });
        found.sort_by(|a, b| {
            a.squared_distance
                .total_cmp(&b.squared_distance)
                .then(a.id.cmp(&b.id))
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

    #[inline]
    fn search_cell(&self, cell: Cell, query: &Vector3<f32>, best: &mut Nearest) {
        for entry in self.cells.get(&cell).into_iter().flatten() {
            let squared_distance = (entry.position - query).norm_squared();
            if squared_distance < best.squared_distance {
                best.squared_distance = squared_distance;
                best.slot = Some(entry.slot);
            } else if squared_distance == best.squared_distance {
                let id = |slot: u32| self.slots[slot as usize].0;
                if best.slot.is_none_or(|slot| id(entry.slot) < id(slot)) {
                    best.slot = Some(entry.slot);
                }
            }
        }
    }

    /// Calls `visit` with every cell that may hold a point within `distance_m` of `query`.
    #[inline]
    fn for_cells_within(
        &self,
        query: &Vector3<f32>,
        distance_m: f32,
        mut visit: impl FnMut(Cell),
    ) {
        let low = self.cell_of(&query.map(|x| x - distance_m));
        let high = self.cell_of(&query.map(|x| x + distance_m));
        let side = |low: i32, high: i32| f64::from(high) - f64::from(low) + 1.0;
        let cells = side(low.x, high.x) * side(low.y, high.y) * side(low.z, high.z);
        // A search far beyond the cells' size is quicker through the table itself.
        if cells > 64.0 && cells > self.cells.len() as f64 {
            self.cells.keys().for_each(|&cell| visit(cell));
            return;
        }
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    visit(Cell { x, y, z });
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

/// The best candidate so far; its distance starts at the search radius.
struct Nearest {
    squared_distance: f32,
    slot: Option<u32>,
}

/// Mixes the three coordinates by multiplication: neighbouring cells differ in low bits, which the
/// table's index must depend on. Fixed, so that runs repeat.
#[derive(Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(u64::from(byte));
        }
    }

    #[inline]
    fn write_i32(&mut self, value: i32) {
        self.write_u64(u64::from(value as u32));
    }

    #[inline]
    fn write_u64(&mut self, value: u64) {
        // An odd constant with well-mixed bits: 2^64 over the golden ratio.
        self.0 = (self.0.rotate_left(23) ^ value).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }

    #[inline]
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }
}
