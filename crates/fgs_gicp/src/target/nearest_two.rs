//! The two nearest points seen so far, tracked in eight lanes so that no branch depends on
//! distances.
//!
//! Each candidate is one integer key: the bits of its squared distance, which sort like the
//! distance, above its slot. Invariant: NaN sorts after every point and so is never selected.

use std::array::from_fn;

use nalgebra::Vector3;

use super::cell::{CellPoints, LANES};

/// The two nearest points in each lane.
pub(super) struct NearestTwo {
    nearest: [u64; LANES],
    next: [u64; LANES],
}

/// Sorts after every point.
const NO_POINT: u64 = key(f32::INFINITY, u32::MAX);

#[inline(always)]
const fn key(squared_distance: f32, slot: u32) -> u64 {
    (squared_distance.to_bits() as u64) << 32 | slot as u64
}

#[inline(always)]
fn squared_distance(key: u64) -> f32 {
    f32::from_bits((key >> 32) as u32)
}

impl NearestTwo {
    pub(super) const NONE: Self = Self {
        nearest: [NO_POINT; LANES],
        next: [NO_POINT; LANES],
    };

    #[inline(always)]
    pub(super) fn add(&mut self, points: &CellPoints, query: &Vector3<f32>) {
        let (mut nearest, mut next) = (self.nearest, self.next);
        for group in points.groups() {
            let squared = group.squared_distances(query);
            for lane in 0..LANES {
                let key = key(squared[lane], group.slots[lane]);
                next[lane] = next[lane].min(key.max(nearest[lane]));
                nearest[lane] = nearest[lane].min(key);
            }
        }
        (self.nearest, self.next) = (nearest, next);
    }

    /// Squared distance of the nearest point; infinite if there is none.
    #[inline(always)]
    pub(super) fn squared_distance(&self) -> f32 {
        squared_distance(min(&self.nearest))
    }

    /// Squared distance of the second nearest point; infinite if there is none. Equal to that of
    /// the nearest point in case of a tie.
    #[inline(always)]
    pub(super) fn next_squared_distance(&self) -> f32 {
        let nearest = min(&self.nearest);
        let others = self
            .nearest
            .map(|key| if key == nearest { NO_POINT } else { key });
        squared_distance(min(&others).min(min(&self.next)))
    }

    /// Slot of the nearest point, or of one of them in case of a tie; `None` if there is no point.
    #[inline(always)]
    pub(super) fn slot(&self) -> Option<u32> {
        let nearest = min(&self.nearest);
        (nearest < NO_POINT).then_some(nearest as u32)
    }
}

/// A pairwise reduction, to keep the dependency chain short.
#[inline(always)]
fn min(lanes: &[u64; LANES]) -> u64 {
    let four: [u64; 4] = from_fn(|i| lanes[i].min(lanes[i + 4]));
    four[0].min(four[2]).min(four[1].min(four[3]))
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Covers cells with any number of points, also after a removal, and searches over several
    /// cells.
    #[test]
    fn equals_a_sorted_list() {
        let mut rng = Pcg64Mcg::seed_from_u64(7);
        let mut random = || Vector3::from_fn(|_, _| rng.random_range(-1.0f32..1.0));
        for count in 0..40_u32 {
            let query = random();
            let positions: Vec<Vector3<f32>> = (0..count).map(|_| random()).collect();
            let mut cells = [CellPoints::default(), CellPoints::default()];
            for (slot, position) in (0..).zip(&positions) {
                cells[usize::from(slot % 3 == 0)].push(position, slot);
            }
            cells[0].remove(4);
            let mut expected: Vec<(f32, u32)> = (0..)
                .zip(&positions)
                .filter(|(slot, _)| *slot != 4)
                .map(|(slot, position)| ((position - query).norm_squared(), slot))
                .collect();
            expected.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut found = NearestTwo::NONE;
            cells.iter().for_each(|points| found.add(points, &query));
            let distance = |i: usize| expected.get(i).map_or(f32::INFINITY, |point| point.0);
            assert_eq!(found.slot(), expected.first().map(|point| point.1));
            assert_eq!(found.squared_distance(), distance(0));
            assert_eq!(found.next_squared_distance(), distance(1));
        }
    }
}
