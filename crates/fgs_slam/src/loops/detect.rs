//! Which old keyframes a new one may show again.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use fgs_geom::{KeyframeId, Se3};
use fgs_graph::{KeyframeGraph, RobustKernel};
use fgs_place::Similar;

use super::Memory;
use crate::submaps::Submaps;

/// A turn by a radian makes as much drift as a way of so many metres: about the distance of what is
/// seen.
const METRES_PER_RADIAN: f64 = 1.0;

/// A keyframe is old when the camera has come farther since, metres. A shorter way drifts by less than
/// what tracking takes out by itself.
const MIN_WAY_M: f64 = 3.0;

/// Different places are less alike than this.
const MIN_SIMILARITY: f64 = 0.15;

/// So many old keyframes are tried by their likeness, and so many by where they are.
const MOST_ALIKE: usize = 3;
const NEAREST: usize = 1;

/// Two cameras that look in directions farther apart hardly see the same.
const MAX_ANGLE_RAD: f64 = 0.6;

/// Nor do two that are farther apart, metres, drift aside.
const MAX_DISTANCE_M: f64 = 1.0;

/// How much of the way the camera may have drifted: positions by a share of it, directions by so many
/// radians a metre. Ten times what tracking does on recordings with drift.
const MAX_DRIFT: f64 = 0.03;
const MAX_DRIFT_RAD_PER_M: f64 = 0.01;

/// The way that the camera has come between a keyframe and others.
pub struct Ways {
    /// Ascending.
    ids: Vec<KeyframeId>,
    /// To each of them.
    metres: Vec<f64>,
}

impl Ways {
    /// The shortest ways over the graph's edges. A loop leaves out the way round: what it connects
    /// has been measured.
    pub fn from(graph: &KeyframeGraph, start: KeyframeId) -> Self {
        let ids: Vec<KeyframeId> = graph.poses().map(|(id, _)| id).collect();
        let mut metres = vec![f64::INFINITY; ids.len()];
        let mut edges = vec![Vec::new(); ids.len()];
        let place_of = |id: &KeyframeId| ids.binary_search(id).ok();
        for edge in graph.edges() {
            let (Some(from), Some(to)) = (place_of(&edge.from), place_of(&edge.to)) else {
                continue;
            };
            let way = match edge.kernel {
                RobustKernel::Quadratic => way(&edge.from_from_to),
                RobustKernel::DynamicCovarianceScaling { .. } => 0.0,
            };
            edges[from].push((to, way));
            edges[to].push((from, way));
        }
        // Dijkstra's algorithm. Of numbers that are not negative, the bits are in their order.
        let start = place_of(&start).map(|place| Reverse((0.0_f64.to_bits(), place)));
        let mut open: BinaryHeap<_> = start.into_iter().collect();
        while let Some(Reverse((bits, place))) = open.pop() {
            if metres[place].is_finite() {
                continue;
            }
            let so_far = f64::from_bits(bits);
            metres[place] = so_far;
            for (next, way) in &edges[place] {
                open.push(Reverse(((so_far + way).to_bits(), *next)));
            }
        }
        Self { ids, metres }
    }

    /// The way to a keyframe, metres; infinite if nothing connects the two.
    pub fn to(&self, id: KeyframeId) -> f64 {
        let place = self.ids.binary_search(&id);
        place.map_or(f64::INFINITY, |place| self.metres[place])
    }

    /// Whether a keyframe was left long ago. One that nothing connects is not: how it lies cannot be
    /// told from drift.
    pub fn is_old(&self, id: KeyframeId) -> bool {
        (MIN_WAY_M..f64::INFINITY).contains(&self.to(id))
    }

    /// Whether the camera may have drifted by this much since a keyframe.
    pub fn allows(&self, id: KeyframeId, drift: &Se3) -> bool {
        let way = self.to(id);
        drift.translation.norm() <= MAX_DRIFT * way + 0.05
            && drift.rotation.angle() <= MAX_DRIFT_RAD_PER_M * way + 0.02
    }
}

/// The way of a motion, metres.
pub fn way(motion: &Se3) -> f64 {
    motion.translation.norm() + METRES_PER_RADIAN * motion.rotation.angle()
}

/// The keyframes of other sub-maps that look most like the newest, given how all do.
pub fn candidates_apart(
    newest: KeyframeId,
    similar: &[Similar],
    submaps: &Submaps,
) -> Vec<KeyframeId> {
    most_alike(similar, |id| submaps.are_apart(newest, id))
}

/// The old keyframes that look most like the newest, given how all do, then those that should see most of
/// the same.
pub fn candidates(
    newest: KeyframeId,
    similar: &[Similar],
    ways: &Ways,
    graph: &KeyframeGraph,
    memory: &Memory,
) -> Vec<KeyframeId> {
    let mut found = most_alike(similar, |id| ways.is_old(id));
    let Some(world_from_newest) = graph.pose(newest) else {
        return found;
    };
    let mut near: Vec<(f64, KeyframeId)> = graph
        .poses()
        .filter(|(id, _)| ways.is_old(*id) && !found.contains(id) && memory.places.knows(*id))
        .filter_map(|(id, pose)| {
            let apart = pose.inverse() * *world_from_newest;
            let is_near = apart.rotation.angle()
                <= MAX_ANGLE_RAD + MAX_DRIFT_RAD_PER_M * ways.to(id)
                && apart.translation.norm() <= MAX_DISTANCE_M + MAX_DRIFT * ways.to(id);
            is_near.then_some((way(&apart), id))
        })
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.extend(near.iter().take(NEAREST).map(|(_, id)| *id));
    found
}

/// Of the keyframes that are wanted, those that come first.
fn most_alike(similar: &[Similar], is_wanted: impl Fn(KeyframeId) -> bool) -> Vec<KeyframeId> {
    similar
        .iter()
        .take_while(|similar| similar.similarity >= MIN_SIMILARITY)
        .map(|similar| similar.id)
        .filter(|id| is_wanted(*id))
        .take(MOST_ALIKE)
        .collect()
}

#[cfg(test)]
mod tests {
    use fgs_graph::Edge;
    use nalgebra::{Matrix6, Vector6};

    use super::*;

    /// Keyframes one metre apart, in a row.
    fn row(count: u32) -> KeyframeGraph {
        let mut graph = KeyframeGraph::new();
        for i in 0..count {
            let pose = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, f64::from(i), 0.0, 0.0));
            graph.add_keyframe(KeyframeId(i), pose);
            if i > 0 {
                tie(&mut graph, i - 1, i, RobustKernel::Quadratic);
            }
        }
        graph
    }

    fn tie(graph: &mut KeyframeGraph, from: u32, to: u32, kernel: RobustKernel) {
        let (from, to) = (KeyframeId(from), KeyframeId(to));
        let from_from_to = graph.pose(from).unwrap().inverse() * *graph.pose(to).unwrap();
        let edge = Edge {
            from,
            to,
            from_from_to,
            information: Matrix6::identity(),
            kernel,
        };
        graph.add_edge(edge).unwrap();
    }

    #[test]
    fn a_keyframe_is_old_when_the_way_since_is_long() {
        let mut graph = row(10);
        graph.add_keyframe(KeyframeId(10), Se3::identity());
        let ways = Ways::from(&graph, KeyframeId(9));
        assert!((ways.to(KeyframeId(0)) - 9.0).abs() <= 1e-9);
        let old: Vec<u32> = (0..11).filter(|id| ways.is_old(KeyframeId(*id))).collect();
        // Nothing is known of the one that nothing connects.
        assert_eq!(old, [0, 1, 2, 3, 4, 5, 6]);
    }

    #[test]
    fn a_loop_leaves_out_the_way_round() {
        let mut graph = row(10);
        let robust = RobustKernel::DynamicCovarianceScaling { threshold: 12.6 };
        tie(&mut graph, 1, 9, robust);
        let ways = Ways::from(&graph, KeyframeId(9));
        assert!((ways.to(KeyframeId(0)) - 1.0).abs() <= 1e-9);
        let old: Vec<u32> = (0..10).filter(|id| ways.is_old(KeyframeId(*id))).collect();
        assert_eq!(old, [4, 5, 6]);
    }

    #[test]
    fn drift_is_believed_up_to_a_share_of_the_way() {
        let ways = Ways::from(&row(11), KeyframeId(10));
        let shifted = |by| Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, by, 0.0));
        assert!(ways.allows(KeyframeId(0), &shifted(0.3)));
        assert!(!ways.allows(KeyframeId(0), &shifted(0.5)));
        assert!(!ways.allows(KeyframeId(9), &shifted(0.3)));
    }
}
