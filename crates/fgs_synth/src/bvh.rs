//! A bounding volume hierarchy (BVH) over solids, traversed front to back.
//!
//! Nodes have four children whose boxes are tested side by side in `f32`. The tree is built with
//! the surface area heuristic, because a room holds both walls and teacups.

use nalgebra::Vector3;

use crate::shape::{Ray, Solid};

const WIDTH: usize = 4;
/// Boxes are padded by this much, metres, against `f32` rounding, which at 10 m is a hundredth of
/// it.
const MARGIN_M: f64 = 1e-4;

/// Traversal stack size. Each level adds at most three entries, so this suffices for 21 levels;
/// a furnished room has about 8.
const STACK: usize = 64;

type Bounds = [Vector3<f64>; 2];
/// A solid's index and bounding box.
type Item = (usize, Bounds);

#[derive(Clone, Copy)]
enum Child {
    Solid(u32),
    Node(u32),
}

/// A node's children and their boxes, as a structure of arrays: `low[axis][child]` and
/// `high[axis][child]`. Unused slots hold boxes that no ray enters.
struct Node {
    low: [[f32; WIDTH]; 3],
    high: [[f32; WIDTH]; 3],
    children: [Child; WIDTH],
}

impl Node {
    /// Ray parameter at which the ray enters each child's box (slab test); infinity for a miss.
    #[inline]
    fn entries(&self, origin: &[f32; 3], inverse: &[f32; 3]) -> [f32; WIDTH] {
        let mut enter = [0.0_f32; WIDTH];
        let mut leave = [f32::INFINITY; WIDTH];
        for axis in 0..3 {
            for i in 0..WIDTH {
                let a = (self.low[axis][i] - origin[axis]) * inverse[axis];
                let b = (self.high[axis][i] - origin[axis]) * inverse[axis];
                // Plain comparisons: f32::min and max spend time on NaN, which does not occur here.
                let (near, far) = if a < b { (a, b) } else { (b, a) };
                enter[i] = if near > enter[i] { near } else { enter[i] };
                leave[i] = if far < leave[i] { far } else { leave[i] };
            }
        }
        let mut entries = [f32::INFINITY; WIDTH];
        for i in 0..WIDTH {
            entries[i] = if enter[i] <= leave[i] {
                enter[i]
            } else {
                f32::INFINITY
            };
        }
        entries
    }
}

/// The hierarchy. Node 0 is the root.
pub(crate) struct Bvh {
    nodes: Vec<Node>,
}

impl Bvh {
    pub fn new(solids: &[Solid]) -> Self {
        let mut items: Vec<Item> = (solids.iter().enumerate())
            .map(|(index, solid)| (index, solid.bounds()))
            .collect();
        let mut nodes = Vec::new();
        build(&mut items, &mut nodes);
        Self { nodes }
    }

    /// Calls `meet` for each solid whose box the ray enters before `limit` (a ray parameter, in
    /// units of the ray's direction). `meet` may lower the limit to cull everything behind a hit.
    #[inline]
    pub fn visit(&self, ray: &Ray, limit: &mut f64, mut meet: impl FnMut(usize, &mut f64)) {
        // Stands for the reciprocal of 0: far beyond any room, yet finite, so that 0 times it is
        // not NaN.
        const LARGEST: f64 = 1e15;
        let origin = [0, 1, 2].map(|axis| ray.origin[axis] as f32);
        let inverse =
            [0, 1, 2].map(|axis| (1.0 / ray.direction[axis]).clamp(-LARGEST, LARGEST) as f32);
        let mut stack = [(Child::Node(0), 0.0_f32); STACK];
        let mut len = 1;
        while len > 0 {
            len -= 1;
            let (child, entry) = stack[len];
            if f64::from(entry) >= *limit {
                continue;
            }
            let node = match child {
                Child::Solid(solid) => {
                    meet(solid as usize, limit);
                    continue;
                }
                Child::Node(node) => &self.nodes[node as usize],
            };
            let first = len;
            for (child, entry) in node.children.iter().zip(node.entries(&origin, &inverse)) {
                if f64::from(entry) < *limit {
                    // Insertion sort that leaves the nearest child on top of the stack.
                    let mut place = len;
                    while place > first && stack[place - 1].1 < entry {
                        stack[place] = stack[place - 1];
                        place -= 1;
                    }
                    stack[place] = (*child, entry);
                    len += 1;
                }
            }
        }
    }
}

/// Appends the subtree over `items` to `nodes` and returns the index of its root.
fn build(items: &mut [Item], nodes: &mut Vec<Node>) -> usize {
    let index = nodes.len();
    nodes.push(Node {
        low: [[f32::INFINITY; WIDTH]; 3],
        high: [[f32::INFINITY; WIDTH]; 3],
        children: [Child::Solid(u32::MAX); WIDTH],
    });
    let mut groups = vec![items];
    while groups.len() < WIDTH {
        groups.sort_by_key(|group| group.len());
        match groups.pop() {
            Some(largest) if largest.len() > 1 => {
                let (left, right) = split(largest);
                groups.extend([left, right]);
            }
            only => {
                groups.extend(only.filter(|group| !group.is_empty()));
                break;
            }
        }
    }
    for (i, group) in groups.into_iter().enumerate() {
        let Some([low, high]) = group.iter().map(|(_, bounds)| *bounds).reduce(union) else {
            continue;
        };
        let child = match &*group {
            [(solid, _)] => Child::Solid(*solid as u32),
            _ => Child::Node(build(group, nodes) as u32),
        };
        let node = &mut nodes[index];
        node.children[i] = child;
        for axis in 0..3 {
            node.low[axis][i] = (low[axis] - MARGIN_M) as f32;
            node.high[axis][i] = (high[axis] + MARGIN_M) as f32;
        }
    }
    index
}

fn union(a: Bounds, b: Bounds) -> Bounds {
    [a[0].inf(&b[0]), a[1].sup(&b[1])]
}

fn half_area([low, high]: &Bounds) -> f64 {
    let size = high - low;
    size.x * size.y + size.y * size.z + size.z * size.x
}

fn sort_along(items: &mut [Item], axis: usize) {
    let center = |[low, high]: &Bounds| low[axis] + high[axis];
    items.sort_by(|a, b| center(&a.1).total_cmp(&center(&b.1)));
}

/// Splits two or more items into two non-empty parts of least cost by the surface area heuristic:
/// the sum over both parts of surface area times item count.
fn split(items: &mut [Item]) -> (&mut [Item], &mut [Item]) {
    let (mut least, mut best_axis, mut best_count) = (f64::INFINITY, 0, items.len() / 2);
    for axis in 0..3 {
        sort_along(items, axis);
        let running_area = |so_far: &mut Option<Bounds>, (_, next): &Item| {
            let bounds = so_far.map_or(*next, |bounds| union(bounds, *next));
            *so_far = Some(bounds);
            Some(half_area(&bounds))
        };
        let left: Vec<f64> = items.iter().scan(None, running_area).collect();
        let right: Vec<f64> = items.iter().rev().scan(None, running_area).collect();
        for count in 1..items.len() {
            let rest = items.len() - count;
            let cost = left[count - 1] * count as f64 + right[rest - 1] * rest as f64;
            if cost < least {
                (least, best_axis, best_count) = (cost, axis, count);
            }
        }
    }
    sort_along(items, best_axis);
    items.split_at_mut(best_count)
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::shape::Form;

    #[test]
    fn agrees_with_trying_every_solid() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let mut vector = |low: f64, high: f64| Vector3::from_fn(|_, _| rng.random_range(low..high));
        for count in [0, 1, 2, 5, 60] {
            let solids: Vec<Solid> = (0..count)
                .map(|i| {
                    let form = [Form::Block, Form::Ball][i % 2];
                    let turn = Rotation3::new(vector(-1.0, 1.0));
                    Solid::new(form, vector(0.05, 0.4), vector(-2.0, 2.0), turn)
                })
                .collect();
            let bvh = Bvh::new(&solids);
            let mut hits = 0;
            for i in 0..500 {
                let mut ray = Ray {
                    origin: vector(-2.5, 2.5),
                    direction: vector(-1.0, 1.0),
                };
                if i % 5 == 0 {
                    ray.direction[i % 3] = 0.0;
                }
                let meet = |solid: usize, limit: f64| {
                    let (t, _) = solids[solid].meet(&ray, 1e-6, limit)?;
                    Some((t, solid))
                };
                let slow = (0..count)
                    .filter_map(|solid| meet(solid, 10.0))
                    .min_by(|a, b| a.0.total_cmp(&b.0));
                let mut fast = None;
                bvh.visit(&ray, &mut 10.0, |solid, limit| {
                    if let Some(hit) = meet(solid, *limit) {
                        *limit = hit.0;
                        fast = Some(hit);
                    }
                });
                assert_eq!(fast, slow);
                hits += usize::from(slow.is_some());
            }
            assert!(count < 60 || (100..400).contains(&hits), "{hits}");
        }
    }
}
