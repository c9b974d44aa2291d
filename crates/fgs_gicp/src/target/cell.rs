//! The points of one cell of a map, eight side by side, so that eight distances are computed and
//! compared at once.
//! Invariant: lanes without a point are NaN, so that no comparison finds them near.

use std::array::from_fn;

use nalgebra::Vector3;

/// Points per group: one AVX register of `f32`, two of SSE or NEON.
const LANES: usize = 8;
type Lanes = [f32; LANES];

/// Positions and slots of a cell's points, in no particular order.
#[derive(Clone, Debug, Default)]
pub(super) struct CellPoints {
    groups: Vec<Group>,
    len: usize,
}

#[derive(Clone, Debug)]
struct Group {
    x: Lanes,
    y: Lanes,
    z: Lanes,
    slots: [u32; LANES],
}

impl Group {
    const EMPTY: Self = Self {
        x: [f32::NAN; LANES],
        y: [f32::NAN; LANES],
        z: [f32::NAN; LANES],
        slots: [u32::MAX; LANES],
    };

    #[inline(always)]
    fn squared_distances(&self, query: &Vector3<f32>) -> Lanes {
        from_fn(|i| {
            let (dx, dy, dz) = (
                self.x[i] - query.x,
                self.y[i] - query.y,
                self.z[i] - query.z,
            );
            dx * dx + dy * dy + dz * dz
        })
    }

    fn set(&mut self, lane: usize, position: &Vector3<f32>, slot: u32) {
        (self.x[lane], self.y[lane], self.z[lane]) = (position.x, position.y, position.z);
        self.slots[lane] = slot;
    }
}

impl CellPoints {
    pub(super) fn is_empty(&self) -> bool {
        self.len == 0
    }

    pub(super) fn push(&mut self, position: &Vector3<f32>, slot: u32) {
        if self.len.is_multiple_of(LANES) {
            self.groups.push(Group::EMPTY);
        }
        self.groups[self.len / LANES].set(self.len % LANES, position, slot);
        self.len += 1;
    }

    /// Takes a slot's point out, if it is here; the last point takes its place.
    pub(super) fn remove(&mut self, slot: u32) {
        let Some(at) = (0..self.len).find(|&i| self.groups[i / LANES].slots[i % LANES] == slot)
        else {
            return;
        };
        self.len -= 1;
        let (group, lane) = (&self.groups[self.len / LANES], self.len % LANES);
        let last = Vector3::new(group.x[lane], group.y[lane], group.z[lane]);
        let last_slot = group.slots[lane];
        self.groups[at / LANES].set(at % LANES, &last, last_slot);
        self.groups[self.len / LANES].set(lane, &Vector3::repeat(f32::NAN), u32::MAX);
        self.groups.truncate(self.len.div_ceil(LANES));
    }

    /// Calls `visit(squared_distance, slot)` for every point.
    #[inline]
    pub(super) fn for_each(&self, query: &Vector3<f32>, mut visit: impl FnMut(f32, u32)) {
        for group in &self.groups {
            let squared = group.squared_distances(query);
            squared
                .iter()
                .zip(group.slots)
                .filter(|(squared, _)| !squared.is_nan())
                .for_each(|(&squared, slot)| visit(squared, slot));
        }
    }
}

/// The two points nearest to a query, kept lane by lane, so that no branch depends on distances.
///
/// A point is one number: the squared distance's bits, which order as the distance does, above its
/// slot.
pub(super) struct NearestTwo {
    nearest: [u64; LANES],
    next: [u64; LANES],
}

/// Comes after every point.
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
        for group in &points.groups {
            let squared = group.squared_distances(query);
            for lane in 0..LANES {
                let key = key(squared[lane], group.slots[lane]);
                next[lane] = next[lane].min(key.max(nearest[lane]));
                nearest[lane] = nearest[lane].min(key);
            }
        }
        (self.nearest, self.next) = (nearest, next);
    }

    /// Of the nearest point; infinite if there is none.
    #[inline(always)]
    pub(super) fn squared_distance(&self) -> f32 {
        squared_distance(min(&self.nearest))
    }

    /// Of the next nearest point; infinite if there is none. Equal to the nearest one's if there
    /// are several nearest points.
    #[inline(always)]
    pub(super) fn next_squared_distance(&self) -> f32 {
        let nearest = min(&self.nearest);
        let others = self
            .nearest
            .map(|key| if key == nearest { NO_POINT } else { key });
        squared_distance(min(&others).min(min(&self.next)))
    }

    /// Of the nearest point, or of one of them.
    #[inline(always)]
    pub(super) fn slot(&self) -> u32 {
        min(&self.nearest) as u32
    }
}

/// By halves, so that it takes as few steps as can be.
#[inline(always)]
fn min(lanes: &[u64; LANES]) -> u64 {
    let four: [u64; 4] = from_fn(|i| lanes[i].min(lanes[i + 4]));
    four[0].min(four[2]).min(four[1].min(four[3]))
}
