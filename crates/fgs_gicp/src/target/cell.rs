//! The points of one map cell, stored in groups of eight so that SIMD code computes and compares
//! eight distances at once.
//! Invariant: empty lanes are NaN, so that no comparison selects them.

use std::array::from_fn;

use nalgebra::Vector3;

/// Points per group: one AVX register of `f32`, or two of SSE or NEON.
pub(super) const LANES: usize = 8;
type Lanes = [f32; LANES];

/// Positions and slots of the points in a cell, unordered.
#[derive(Clone, Debug, Default)]
pub(super) struct CellPoints {
    groups: Vec<Group>,
    len: usize,
}

/// Two cache lines.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(super) struct Group {
    x: Lanes,
    y: Lanes,
    z: Lanes,
    pub(super) slots: [u32; LANES],
}

impl Group {
    const EMPTY: Self = Self {
        x: [f32::NAN; LANES],
        y: [f32::NAN; LANES],
        z: [f32::NAN; LANES],
        slots: [u32::MAX; LANES],
    };

    #[inline(always)]
    pub(super) fn squared_distances(&self, query: &Vector3<f32>) -> Lanes {
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
    #[inline(always)]
    pub(super) fn groups(&self) -> &[Group] {
        &self.groups
    }

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

    /// Removes the point in a slot, if it is in this cell. The last point moves into the gap.
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

    /// Calls `visit(squared_distance, slot)` for every lane; the distance is NaN for empty lanes.
    #[inline]
    pub(super) fn for_each(&self, query: &Vector3<f32>, mut visit: impl FnMut(f32, u32)) {
        for group in &self.groups {
            let squared = group.squared_distances(query);
            squared
                .iter()
                .zip(group.slots)
                .for_each(|(&squared, slot)| visit(squared, slot));
        }
    }
}
