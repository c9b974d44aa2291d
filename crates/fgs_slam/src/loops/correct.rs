//! What the graph makes of loops: how keyframes should move.

use fgs_geom::{KeyframeId, Se3};
use fgs_graph::{Edge, KeyframeGraph, OptimizeSettings, Optimized, RobustKernel};
use nalgebra::Matrix6;

use super::detect::way;
use super::verify::{MAYBE_NEWS, Revisit, with_errors};
use crate::submaps::Submaps;

/// Tracking drifts by about so much from one keyframe to the next, beside what its registration
/// knows of: standard deviations, of the way between the two (metres), and at least.
const DRIFT: f64 = 0.01;
const DRIFT_RAD_PER_M: f64 = 0.005;
const MIN_DRIFT_M: f64 = 0.001;
const MIN_DRIFT_RAD: f64 = 0.0005;

/// For what images say of each other. It loses weight from this squared error on: the 95 % quantile with six
/// degrees of freedom.
const ROBUST: RobustKernel = RobustKernel::DynamicCovarianceScaling { threshold: 12.6 };

/// A loop that is left with less weight contradicts the others.
const MIN_WEIGHT: f64 = 0.5;

/// Two revisits agree if the drift that they found differs by less.
const MAX_TURN_RAD: f64 = 0.015;
const MAX_SHIFT_M: f64 = 0.02;

/// Smaller corrections are not worth their trouble.
const MIN_MOVE_M: f64 = 1e-4;

/// The edge from a keyframe to the next, whose pose in the world is known with some information. Where
/// surfaces of long ago come into view that drift has left aside, they pull the camera to themselves, and the
/// registration knows nothing of it: the corners of both keyframes are believed if they say otherwise.
pub fn successive_edge(
    from: KeyframeId,
    to: KeyframeId,
    from_from_to: Se3,
    information: &Matrix6<f64>,
    by_corners: Option<Revisit>,
) -> Option<Edge> {
    let contradiction = by_corners.filter(|corners| corners.error_of(&from_from_to) > MAYBE_NEWS);
    if let Some(corners) = contradiction {
        return Some(corners.edge(ROBUST));
    }
    let way = way(&from_from_to);
    let drift = [
        MIN_DRIFT_RAD + DRIFT_RAD_PER_M * way,
        MIN_DRIFT_M + DRIFT * way,
    ];
    Some(Edge {
        from,
        to,
        from_from_to,
        information: with_errors(information, drift)?,
        kernel: RobustKernel::Quadratic,
    })
}

/// Whether two revisits would move the present alike.
pub fn agree(a: &Revisit, b: &Revisit, graph: &KeyframeGraph) -> bool {
    let moved = |revisit: &Revisit| {
        let world_from_new = *graph.pose(revisit.old)? * revisit.old_from_new;
        Some(world_from_new * motion_between(revisit.new, b.new, graph)?)
    };
    let (Some(by_a), Some(by_b)) = (moved(a), moved(b)) else {
        return false;
    };
    are_close(&by_a, &by_b)
}

/// Whether two measurements of a pose agree.
pub fn are_close(a: &Se3, b: &Se3) -> bool {
    let apart = a.inverse() * *b;
    apart.rotation.angle() <= MAX_TURN_RAD && apart.translation.norm() <= MAX_SHIFT_M
}

/// How a keyframe lies to one that was tracked from it, or from those that were: as the edges between them say,
/// which may know better than the poses. Of others, as the poses say.
fn motion_between(before: KeyframeId, after: KeyframeId, graph: &KeyframeGraph) -> Option<Se3> {
    let (mut id, mut id_from_after) = (after, Se3::identity());
    while id > before {
        let is_back = |edge: &&Edge| edge.to == id && edge.from >= before;
        let Some(edge) = graph.edges().iter().rfind(is_back) else {
            break;
        };
        (id, id_from_after) = (edge.from, edge.from_from_to * id_from_after);
    }
    if id == before {
        return Some(id_from_after);
    }
    Some(graph.pose(before)?.inverse() * *graph.pose(after)?)
}

/// Closes loops.
pub struct Correction {
    /// The edges to add to the graph.
    pub edges: Vec<Edge>,
    /// The motions of keyframes, `new_world_from_old_world`; none if all are tiny.
    pub moves: Vec<(KeyframeId, Se3)>,
}

impl Correction {
    /// Keyframes that joined the graph while the correction was worked out move with the one that they were
    /// tracked from.
    pub fn extend_to(&mut self, graph: &KeyframeGraph) {
        let Some(&(newest, _)) = self.moves.last() else {
            return;
        };
        for (id, _) in graph.poses().filter(|(id, _)| *id > newest) {
            let edge = graph.edges().iter().rfind(|edge| edge.to == id);
            let moved = edge.and_then(|edge| self.moves.iter().find(|(id, _)| *id == edge.from));
            if let Some(&(_, motion)) = moved {
                self.moves.push((id, motion));
            }
        }
    }
}

/// What revisits mean for a graph; `None` if they contradict its other edges. If they are of two sub-maps, the
/// newer comes to the older.
pub fn correction(
    graph: &KeyframeGraph,
    submaps: &Submaps,
    revisits: &[Revisit; 2],
) -> Option<Correction> {
    let edges = |kernel: RobustKernel| revisits.each_ref().map(|revisit| revisit.edge(kernel));
    // A robust edge far from its minimum has no pull. So loops are closed first, and then asked
    // whether they fit.
    let mut start = graph.clone();
    start.move_keyframes(&meeting(graph, submaps, &revisits[1])?);
    let closed = optimized(&start, &edges(RobustKernel::Quadratic))?;
    start.move_keyframes(&closed.corrections);
    let edges = edges(ROBUST);
    let settled = optimized(&start, &edges)?;
    let fits = settled
        .weights
        .iter()
        .rev()
        .take(edges.len())
        .all(|weight| *weight >= MIN_WEIGHT);
    fits.then_some(())?;
    start.move_keyframes(&settled.corrections);
    let moves: Vec<(KeyframeId, Se3)> = graph
        .poses()
        .filter_map(|(id, old)| Some((id, (*start.pose(id)? * old.inverse()).renormalized())))
        .collect();
    let largest = graph
        .poses()
        .filter_map(|(id, old)| Some((start.pose(id)?.translation - old.translation).norm()));
    let is_worth_it = largest.fold(0.0, f64::max) >= MIN_MOVE_M;
    Some(Correction {
        edges: edges.to_vec(),
        moves: if is_worth_it { moves } else { Vec::new() },
    })
}

/// The rigid motion by which a sub-map comes to an older one, as a revisit says; none within a sub-map.
fn meeting(
    graph: &KeyframeGraph,
    submaps: &Submaps,
    revisit: &Revisit,
) -> Option<Vec<(KeyframeId, Se3)>> {
    let (old, new) = (submaps.of(revisit.old)?, submaps.of(revisit.new)?);
    if old == new {
        return Some(Vec::new());
    }
    let (world_from_old, world_from_new) = (graph.pose(revisit.old)?, graph.pose(revisit.new)?);
    let old_from_new = *world_from_old * revisit.old_from_new * world_from_new.inverse();
    let (moved, motion) = if old < new {
        (new, old_from_new)
    } else {
        (old, old_from_new.inverse())
    };
    let ids = graph.poses().map(|(id, _)| id);
    let ids = ids.filter(|id| submaps.of(*id) == Some(moved));
    Some(ids.map(|id| (id, motion)).collect())
}

/// What a graph's poses become once edges are added.
fn optimized(graph: &KeyframeGraph, edges: &[Edge]) -> Option<Optimized> {
    let mut graph = graph.clone();
    for edge in edges {
        graph.add_edge(edge.clone()).ok()?;
    }
    graph.optimize(&OptimizeSettings::default()).ok()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Vector3, Vector6};

    use super::*;

    const STEP_M: f64 = 0.2;

    /// All keyframes are of one sub-map.
    fn one() -> Submaps {
        let mut submaps = Submaps::default();
        submaps.add(KeyframeId(0), None, Vector3::zeros());
        submaps
    }

    fn at(x: f64, y: f64) -> Se3 {
        Se3::exp(&Vector6::new(0.0, 0.0, 0.0, x, y, 0.0))
    }

    /// A way of 20 keyframes ahead that seems to lead 1 % aside.
    fn drifted() -> KeyframeGraph {
        let mut graph = KeyframeGraph::new();
        for i in 0..20 {
            let ahead = STEP_M * f64::from(i);
            let id = KeyframeId(i);
            graph.add_keyframe(id, at(ahead, 0.01 * ahead));
            if let Some(from) = i.checked_sub(1).map(KeyframeId) {
                let step = at(STEP_M, 0.01 * STEP_M);
                let information = Matrix6::identity() * 1e6;
                let edge = successive_edge(from, id, step, &information, None);
                graph.add_edge(edge.unwrap()).unwrap();
            }
        }
        graph
    }

    fn revisit(old: u32, new: u32, old_from_new: Se3) -> Revisit {
        Revisit {
            old: KeyframeId(old),
            new: KeyframeId(new),
            old_from_new,
            information: Matrix6::identity() * 1e5,
        }
    }

    /// As it would be without drift.
    fn right(old: u32, new: u32) -> Revisit {
        revisit(old, new, at(STEP_M * f64::from(new - old), 0.0))
    }

    #[test]
    fn drift_is_spread_over_the_way() {
        let graph = drifted();
        let correction = correction(&graph, &one(), &[right(0, 18), right(1, 19)]).unwrap();
        let mut aside = vec![0.0];
        for (id, motion) in &correction.moves[1..] {
            let pose = *motion * *graph.pose(*id).unwrap();
            aside.push(pose.translation.y - graph.pose(*id).unwrap().translation.y);
        }
        let whole = -0.01 * STEP_M * 19.0;
        assert!((aside[19] - whole).abs() <= 0.1 * whole.abs(), "{aside:?}");
        assert!(
            aside.windows(2).all(|pair| pair[1] <= pair[0] + 1e-4),
            "{aside:?}"
        );
        assert!((0.2..0.8).contains(&(aside[10] / whole)), "{aside:?}");
    }

    #[test]
    fn what_joined_meanwhile_moves_with_what_it_was_tracked_from() {
        let mut graph = drifted();
        let mut correction = correction(&graph, &one(), &[right(0, 18), right(1, 19)]).unwrap();
        for (from, to) in [(19, 20), (20, 21), (3, 22)] {
            let (from, to) = (KeyframeId(from), KeyframeId(to));
            let pose = *graph.pose(from).unwrap() * at(STEP_M, 0.0);
            graph.add_keyframe(to, pose);
            let information = Matrix6::identity() * 1e6;
            let edge = successive_edge(from, to, at(STEP_M, 0.0), &information, None);
            graph.add_edge(edge.unwrap()).unwrap();
        }
        // Nothing says where it hangs.
        graph.add_keyframe(KeyframeId(23), at(0.0, 0.0));
        correction.extend_to(&graph);
        let motions: Vec<Se3> = correction.moves.iter().map(|(_, motion)| *motion).collect();
        assert_eq!(motions.len(), 23);
        assert_eq!(motions[20..], [motions[19], motions[19], motions[3]]);
    }

    #[test]
    fn corners_are_believed_where_tracking_was_pulled_aside() {
        let (from, to) = (KeyframeId(17), KeyframeId(18));
        let edge = |pulled_m: f64| {
            let tracked = at(STEP_M, pulled_m);
            let information = Matrix6::identity() * 1e6;
            let corners = revisit(17, 18, at(STEP_M, 0.001));
            successive_edge(from, to, tracked, &information, Some(corners)).unwrap()
        };
        let (whole, torn) = (edge(0.004), edge(0.05));
        assert_eq!(whole.from_from_to, at(STEP_M, 0.004));
        assert_eq!(whole.kernel, RobustKernel::Quadratic);
        assert_eq!(torn.from_from_to, at(STEP_M, 0.001));
        assert_eq!(torn.kernel, ROBUST);
        // Two revisits agree although the pose of the keyframe between them is torn.
        let mut graph = KeyframeGraph::new();
        graph.add_keyframe(KeyframeId(0), at(0.0, 0.0));
        graph.add_keyframe(from, at(17.0 * STEP_M, 0.1));
        graph.add_keyframe(to, at(18.0 * STEP_M, 0.15));
        let revisits = [right(0, 17), right(0, 18)];
        assert!(!agree(&revisits[0], &revisits[1], &graph));
        graph.add_edge(torn).unwrap();
        assert!(agree(&revisits[0], &revisits[1], &graph));
    }

    #[test]
    fn loops_that_contradict_the_others_are_refused() {
        let mut graph = drifted();
        let first = correction(&graph, &one(), &[right(0, 18), right(1, 19)]).unwrap();
        graph.move_keyframes(&first.moves);
        for edge in first.edges {
            graph.add_edge(edge).unwrap();
        }
        let wrong = |old: u32, new: u32| revisit(old, new, at(STEP_M * f64::from(new - old), 0.5));
        assert!(correction(&graph, &one(), &[wrong(0, 17), wrong(1, 16)]).is_none());
    }

    #[test]
    fn what_moves_nothing_is_only_noted() {
        let graph = drifted();
        let known = |old: u32, new: u32| {
            let ahead = STEP_M * f64::from(new - old);
            revisit(old, new, at(ahead, 0.01 * ahead))
        };
        let correction = correction(&graph, &one(), &[known(0, 18), known(1, 19)]).unwrap();
        assert!(correction.edges.len() == 2 && correction.moves.is_empty());
    }

    #[test]
    fn revisits_agree_by_how_they_move_the_present() {
        let graph = drifted();
        assert!(agree(&right(0, 18), &right(3, 19), &graph));
        let other = revisit(3, 19, at(STEP_M * 16.0, 0.1));
        assert!(!agree(&right(0, 18), &other, &graph));
    }

    /// Keyframes 0 to 9 of a straight way in the first sub-map, the next ten in the second, which lies far
    /// above and turned, and two more in the first.
    fn apart() -> (KeyframeGraph, Submaps) {
        let mut graph = KeyframeGraph::new();
        let mut submaps = Submaps::default();
        let far = Se3::exp(&Vector6::new(0.0, 0.0, 0.3, 5.0, -100.0, 2.0));
        for i in 0..22 {
            let in_second = (10..20).contains(&i);
            let place = if i < 20 { i } else { i - 10 };
            let way = at(STEP_M * f64::from(place), 0.0);
            let pose = if in_second { far * way } else { way };
            let previous = match i {
                0 | 10 => None,
                20 => Some(9),
                _ => Some(i - 1),
            };
            graph.add_keyframe(KeyframeId(i), pose);
            submaps.add(KeyframeId(i), previous.map(KeyframeId), pose.translation);
            if let Some(from) = previous.map(KeyframeId) {
                let step = at(STEP_M, 0.0);
                let information = Matrix6::identity() * 1e6;
                let edge = successive_edge(from, KeyframeId(i), step, &information, None);
                graph.add_edge(edge.unwrap()).unwrap();
            }
        }
        (graph, submaps)
    }

    #[test]
    fn the_newer_submap_comes_to_the_older_whichever_the_camera_is_in() {
        let (graph, submaps) = apart();
        let met = |old: u32, new: u32, ahead: f64| revisit(old, new, at(STEP_M * ahead, 0.0));
        // From the second back to the first, and from the first into the second.
        for revisits in [
            [met(8, 18, 10.0), met(9, 19, 10.0)],
            [met(12, 20, -2.0), met(12, 21, -1.0)],
        ] {
            assert!(agree(&revisits[0], &revisits[1], &graph));
            let joined = correction(&graph, &submaps, &revisits).unwrap();
            let mut moved = graph.clone();
            moved.move_keyframes(&joined.moves);
            for (id, pose) in moved.poses() {
                let place = if id.0 < 20 { id.0 } else { id.0 - 10 };
                let error = pose.inverse() * at(STEP_M * f64::from(place), 0.0);
                assert!(error.log().norm() <= 1e-6, "{id:?}: {error:?}");
            }
        }
    }
}
