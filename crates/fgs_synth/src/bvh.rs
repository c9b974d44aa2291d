//! A tree of bounding boxes over solids: the nearest one that a ray meets.
//!
//! Split by the surface-area heuristic, since a room holds both walls and teacups.

use nalgebra::Vector3;

use crate::shape::{Ray, Solid};

/// Where a ray first meets a solid.
#[derive(Clone, Copy)]
pub(crate) struct Hit {
    /// Distance in units of the ray's direction.
    pub t: f64,
    /// Index of the solid.
    pub solid: usize,
    /// Its face.
    pub face: usize,
}

#[derive(Clone, Copy)]
struct Bounds([Vector3<f64>; 2]);

impl Bounds {
    fn union(&self, other: &Self) -> Self {
        Self([self.0[0].inf(&other.0[0]), self.0[1].sup(&other.0[1])])
    }

    fn half_area(&self) -> f64 {
        let size = self.0[1] - self.0[0];
        size.x * size.y + size.y * size.z + size.z * size.x
    }

    /// Where a ray enters the box, infinity if it misses it or enters beyond `t_max`.
    #[inline]
    fn entry(&self, origin: &Vector3<f64>, inverse: &Vector3<f64>, t_max: f64) -> f64 {
        let a = (self.0[0] - origin).component_mul(inverse);
        let b = (self.0[1] - origin).component_mul(inverse);
        let enter = a.x.min(b.x).max(a.y.min(b.y)).max(a.z.min(b.z)).max(0.0);
        let leave = a.x.max(b.x).min(a.y.max(b.y)).min(a.z.max(b.z));
        if enter <= leave && enter < t_max {
            enter
        } else {
            f64::INFINITY
        }
    }
}

enum Node {
    Leaf(usize),
    Split {
        bounds: [Bounds; 2],
        children: [usize; 2],
    },
}

/// The tree. Node 0 is the root.
pub(crate) struct Bvh {
    nodes: Vec<Node>,
}

impl Bvh {
    pub fn new(solids: &[Solid]) -> Self {
        let mut items: Vec<(usize, Bounds)> = (solids.iter().enumerate())
            .map(|(index, solid)| (index, Bounds(solid.bounds())))
            .collect();
        let mut nodes = Vec::new();
        if !items.is_empty() {
            build(&mut items, &mut nodes);
        }
        Self { nodes }
    }

    /// The nearest crossing with t in (`t_min`, `t_max`) of a solid that `counts`. `likely` is a
    /// guess, which only saves time.
    #[inline]
    pub fn nearest(
        &self,
        solids: &[Solid],
        ray: &Ray,
        (t_min, t_max): (f64, f64),
        likely: Option<usize>,
        counts: impl Fn(usize) -> bool,
    ) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        let mut t_best = t_max;
        let mut meet = |solid: usize, t_best: &mut f64| {
            if let Some((t, face)) = solids[solid].meet(ray, t_min, *t_best)
                && counts(solid)
            {
                *t_best = t;
                best = Some(Hit { t, solid, face });
            }
        };
        if let Some(solid) = likely {
            meet(solid, &mut t_best);
        }
        let inverse = ray.direction.map(|d| 1.0 / d);
        // Deeper than any tree over less than 2^32 solids that halves now and then; pushing
        // beyond it would panic, and a room has some hundred solids.
        let mut stack = [(0, 0.0); 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let (node, entry) = stack[depth];
            if entry >= t_best {
                continue;
            }
            match &self.nodes[node] {
                Node::Leaf(solid) => meet(*solid, &mut t_best),
                Node::Split { bounds, children } => {
                    let entries = [0, 1].map(|i| bounds[i].entry(&ray.origin, &inverse, t_best));
                    let far = usize::from(entries[0] <= entries[1]);
                    for i in [far, 1 - far] {
                        if entries[i] < t_best {
                            stack[depth] = (children[i], entries[i]);
                            depth += 1;
                        }
                    }
                }
            }
        }
        best
    }
}

/// Appends the tree over `items` (not empty) and returns its root and bounds.
fn build(items: &mut [(usize, Bounds)], nodes: &mut Vec<Node>) -> (usize, Bounds) {
    let node = nodes.len();
    if let [(solid, bounds)] = items {
        nodes.push(Node::Leaf(*solid));
        return (node, *bounds);
    }
    let (axis, count) = cheapest_split(items);
    sort_along(items, axis);
    nodes.push(Node::Leaf(0)); // holds the place until the children are known
    let (left, right) = items.split_at_mut(count);
    let (left, left_bounds) = build(left, nodes);
    let (right, right_bounds) = build(right, nodes);
    nodes[node] = Node::Split {
        bounds: [left_bounds, right_bounds],
        children: [left, right],
    };
    (node, left_bounds.union(&right_bounds))
}

fn sort_along(items: &mut [(usize, Bounds)], axis: usize) {
    let center = |bounds: &Bounds| bounds.0[0][axis] + bounds.0[1][axis];
    items.sort_by(|a, b| center(&a.1).total_cmp(&center(&b.1)));
}

/// The axis to sort along and the number of items in the first part with the least sum of
/// surface area times items.
fn cheapest_split(items: &mut [(usize, Bounds)]) -> (usize, usize) {
    let mut best = (f64::INFINITY, 0, items.len() / 2);
    for axis in 0..3 {
        sort_along(items, axis);
        let running = |bounds: &mut Option<Bounds>, next: &Bounds| {
            let union = bounds.map_or(*next, |b| b.union(next));
            *bounds = Some(union);
            Some(union.half_area())
        };
        let left: Vec<f64> = (items.iter().map(|(_, bounds)| bounds))
            .scan(None, running)
            .collect();
        let right: Vec<f64> = (items.iter().rev().map(|(_, bounds)| bounds))
            .scan(None, running)
            .collect();
        for count in 1..items.len() {
            let rest = items.len() - count;
            let cost = left[count - 1] * count as f64 + right[rest - 1] * rest as f64;
            if cost < best.0 {
                best = (cost, axis, count);
            }
        }
    }
    (best.1, best.2)
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
        let solids: Vec<Solid> = (0..60)
            .map(|i| {
                let form = [Form::Block, Form::Ball][i % 2];
                let turn = Rotation3::new(vector(-1.0, 1.0));
                Solid::new(form, vector(0.05, 0.4), vector(-2.0, 2.0), turn)
            })
            .collect();
        let bvh = Bvh::new(&solids);
        let mut hits = 0;
        for i in 0..500 {
            let ray = Ray {
                origin: vector(-2.5, 2.5),
                direction: vector(-1.0, 1.0),
            };
            let slow = (solids.iter().enumerate())
                .filter_map(|(solid, s)| Some((s.meet(&ray, 1e-6, 10.0)?.0, solid)))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let likely = (i % 2 == 0).then_some(i % 60);
            let fast = bvh.nearest(&solids, &ray, (1e-6, 10.0), likely, |_| true);
            assert_eq!(fast.map(|hit| (hit.t, hit.solid)), slow);
            hits += usize::from(slow.is_some());
        }
        assert!((100..400).contains(&hits), "{hits}");
    }

    #[test]
    fn nothing_is_met_where_nothing_is() {
        let ray = Ray {
            origin: Vector3::zeros(),
            direction: Vector3::x(),
        };
        let hit = Bvh::new(&[]).nearest(&[], &ray, (0.0, 1.0), None, |_| true);
        assert!(hit.is_none());
    }
}
