//! A sparse voxel grid: cubic cells hashed by their integer coordinates, for finding points by
//! position.
//! Invariant: a cell is in the table exactly while it holds points.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hash, Hasher};

use nalgebra::Vector3;

use super::cell::CellPoints;
use super::nearest_two::NearestTwo;

/// Maps positions to the slots of points.
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
    /// An empty grid. A cell size that is not a positive number is replaced by 1 m.
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

    /// Inserts a slot at a finite position.
    pub(super) fn insert(&mut self, position: &Vector3<f32>, slot: u32) {
        let cell = self.cell_of(position);
        self.cells.entry(cell).or_default().push(position, slot);
    }

    /// Removes a slot from the position at which it was inserted.
    pub(super) fn remove(&mut self, position: &Vector3<f32>, slot: u32) {
        let cell = self.cell_of(position);
        if let Some(points) = self.cells.get_mut(&cell) {
            points.remove(slot);
            if points.is_empty() {
                self.cells.remove(&cell);
            }
        }
    }

    /// The nearest and second nearest points. The nearest is exact up to `max_distance_m +
    /// margin_m`; the second nearest also only up to the distance of the nearest plus the margin.
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
        // The cell that contains the query usually yields a point so close that few other cells, if
        // any, remain within reach.
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

    /// Calls `visit(squared_distance, slot)` for every point within `max_distance_m`. It is also
    /// called for some points further away, and with NaN for empty lanes.
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

    /// Calls `visit(cell, squared_gap)` for every cell that may hold a point within `distance_m` of
    /// `query`. The gap is a lower bound on the distance to the points of the cell.
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
        // If the search radius is large compared with the cells, iterating over the table is
        // faster.
        if cells > 64.0 && cells > self.cells.len() as f64 {
            self.cells.keys().for_each(|&cell| visit(cell, 0.0));
            return;
        }
        // Distance along one axis from the query to the cell.
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

    /// Coordinates saturate far from the origin; a single cell then holds all points beyond.
    #[inline]
    fn cell_of(&self, position: &Vector3<f32>) -> Cell {
        // Rounds down by hand, since `f32::floor` is a function call on baseline x86-64.
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

/// State of a search.
struct Search {
    found: NearestTwo,
    /// Points beyond this squared distance are irrelevant.
    limit: f32,
    margin_m: f32,
}

impl Search {
    #[inline(always)]
    fn add(&mut self, points: &CellPoints, query: &Vector3<f32>) {
        self.found.add(points, query);
        let nearest = self.found.squared_distance();
        // Rounding must not push the limit below the nearest point: equally near points have to be
        // found too.
        let limit = (nearest.sqrt() + self.margin_m).powi(2).max(nearest);
        self.limit = self.limit.min(limit);
    }
}

/// Upper bound on the rounding error of distances up to `distance_m` from `query`, which comes from
/// rounding of the coordinates.
#[inline]
pub(super) fn rounding_m(query: &Vector3<f32>, distance_m: f32) -> f32 {
    4.0 * f32::EPSILON * (query.amax() + distance_m)
}

impl Hash for Cell {
    /// Neighbouring cells differ in their low bits; the multiplication carries these up. The
    /// factors are odd and have well-mixed bits: 2^64 divided by the three-dimensional golden ratio
    /// and its powers.
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

/// Passes on the hash of a cell, but mixes high bits into the low ones, which the multiplication
/// mixes least and the table uses most. There is no random seed, so that runs are reproducible.
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
