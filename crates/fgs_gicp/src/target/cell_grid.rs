//! A sparse grid of cubic cells, hashed by their coordinates: where points are, by position.
//! Invariant: a cell is in the table as long as it holds points.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hash, Hasher};

use nalgebra::Vector3;

use super::cell::CellPoints;
use super::nearest_two::NearestTwo;

/// Slots of points by the points' positions.
#[derive(Clone, Debug)]
pub(super) struct CellGrid {
    cell_size_m: f32,
    cells_per_m: f32,
    cells: HashMap<Cell, CellPoints, BuildHasherDefault<CellHasher>>,
}

/// Integer coordinates of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cell {
    x: i32,
    y: i32,
    z: i32,
}

impl CellGrid {
    /// An empty grid. A side that is not a positive number is replaced by 1 m.
    pub(super) fn new(cell_size_m: f32) -> Self {
        let cells_per_m = 1.0 / cell_size_m;
        let usable = cells_per_m.is_normal() && cells_per_m > 0.0;
        Self {
            cell_size_m: if usable { cell_size_m } else { 1.0 },
            cells_per_m: if usable { cells_per_m } else { 1.0 },
            cells: HashMap::default(),
        }
    }

    #[cfg(test)]
    pub(super) fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Puts a slot at a finite position.
    pub(super) fn insert(&mut self, position: &Vector3<f32>, slot: u32) {
        let cell = self.cell_of(position);
        self.cells.entry(cell).or_default().push(position, slot);
    }

    /// Takes a slot out from where it was put.
    pub(super) fn remove(&mut self, position: &Vector3<f32>, slot: u32) {
        let cell = self.cell_of(position);
        if let Some(points) = self.cells.get_mut(&cell) {
            points.remove(slot);
            if points.is_empty() {
                self.cells.remove(&cell);
            }
        }
    }

    /// The nearest and the next nearest point, exact as far as `max_distance_m + margin_m`, the
    /// next one also only as far as the nearest's distance plus the margin.
    #[inline(always)]
    pub(super) fn nearest_two(
        &self,
        query: &Vector3<f32>,
        max_distance_m: f32,
        margin_m: f32,
    ) -> NearestTwo {
        let mut search = Search {
            found: NearestTwo::NONE,
            limit: (max_distance_m + margin_m).powi(2),
            margin_m,
        };
        let own = self.cell_of(query);
        if let Some(points) = self.cells.get(&own) {
            search.add(points, query);
        }
        // What the own cell holds usually leaves few other cells, if any, within reach.
        self.for_cells_within(
            query,
            search.limit.sqrt(),
            #[inline(always)]
            |cell, squared_gap| {
                if cell != own
                    && squared_gap <= search.limit
                    && let Some(points) = self.cells.get(&cell)
                {
                    search.add(points, query);
                }
            },
        );
        search.found
    }

    /// Calls `visit(squared_distance, slot)` with every point at most `max_distance_m` away, and
    /// some beyond or with NaN for none.
    pub(super) fn for_points_within(
        &self,
        query: &Vector3<f32>,
        max_distance_m: f32,
        mut visit: impl FnMut(f32, u32),
    ) {
        self.for_cells_within(query, max_distance_m, |cell, _| {
            if let Some(points) = self.cells.get(&cell) {
                points.for_each(query, &mut visit);
            }
        });
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

/// A search under way.
struct Search {
    found: NearestTwo,
    /// Points beyond this squared distance are of no interest.
    limit: f32,
    margin_m: f32,
}

impl Search {
    #[inline(always)]
    fn add(&mut self, points: &CellPoints, query: &Vector3<f32>) {
        self.found.add(points, query);
        let nearest = self.found.squared_distance();
        // Not below the nearest point itself by rounding: its equals are to be met too.
        let limit = (nearest.sqrt() + self.margin_m).powi(2).max(nearest);
        self.limit = self.limit.min(limit);
    }
}

/// Bounds the rounding error of distances up to `distance_m` from `query`, which is that of the
/// coordinates that they come from.
#[inline]
pub(super) fn rounding_m(query: &Vector3<f32>, distance_m: f32) -> f32 {
    4.0 * f32::EPSILON * (query.amax() + distance_m)
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
