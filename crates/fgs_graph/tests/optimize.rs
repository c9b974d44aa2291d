//! Whole graphs: GTSAM's answers, false edges, graphs that make no sense.

#![allow(clippy::unwrap_used)]

use std::path::Path;

use fgs_geom::{KeyframeId, Se3};
use fgs_graph::{Edge, GraphError, KeyframeGraph, OptimizeSettings, Optimized, RobustKernel};
use nalgebra::{Matrix6, Vector6};

const ROBUST: RobustKernel = RobustKernel::DynamicCovarianceScaling { threshold: 12.6 };

/// A graph and GTSAM's poses for it; see `golden/make.py`.
fn golden(name: &str) -> (KeyframeGraph, Vec<Se3>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    let text = std::fs::read_to_string(path.join(name)).unwrap();
    let (mut graph, mut best) = (KeyframeGraph::new(), Vec::new());
    for line in text.lines() {
        let (kind, rest) = line.split_once(' ').unwrap();
        let numbers: Vec<f64> = rest.split(' ').map(|x| x.parse().unwrap()).collect();
        let pose =
            |n: &[f64]| Se3::from_wxyz([n[3], n[4], n[5], n[6]], [n[0], n[1], n[2]]).unwrap();
        let id = |i: usize| KeyframeId(numbers[i] as u32);
        match kind {
            "pose" => graph.add_keyframe(id(0), pose(&numbers[1..])),
            "best" => best.push(pose(&numbers[1..])),
            _ => {
                let mut information = Matrix6::zeros();
                let mut upper = numbers[9..].iter();
                for i in 0..6 {
                    for j in i..6 {
                        let value = *upper.next().unwrap();
                        (information[(i, j)], information[(j, i)]) = (value, value);
                    }
                }
                let from_from_to = pose(&numbers[2..]);
                let edge = edge(id(0), id(1), from_from_to, information);
                graph.add_edge(edge).unwrap();
            }
        }
    }
    (graph, best)
}

fn edge(from: KeyframeId, to: KeyframeId, from_from_to: Se3, information: Matrix6<f64>) -> Edge {
    Edge {
        from,
        to,
        from_from_to,
        information,
        kernel: RobustKernel::Quadratic,
    }
}

fn optimized(graph: &KeyframeGraph) -> (Vec<Se3>, Optimized) {
    let settings = OptimizeSettings {
        min_step: 1e-9,
        ..OptimizeSettings::default()
    };
    let result = graph.optimize(&settings).unwrap();
    let mut moved = graph.clone();
    moved.move_keyframes(&result.corrections);
    (moved.poses().map(|(_, pose)| *pose).collect(), result)
}

/// The largest distance between two poses of the same keyframe (rad, m).
fn difference(a: &[Se3], b: &[Se3]) -> f64 {
    assert_eq!(a.len(), b.len());
    let pairs = a.iter().zip(b);
    pairs
        .map(|(a, b)| (a.inverse() * *b).log().amax())
        .fold(0.0, f64::max)
}

fn poses(graph: &KeyframeGraph) -> Vec<Se3> {
    graph.poses().map(|(_, pose)| *pose).collect()
}

#[test]
fn gtsam_finds_the_same_poses() {
    for (name, chi2) in [
        ("circle.txt", 17.372_786_715_918),
        ("sphere.txt", 295.020_323_444_201),
    ] {
        let (graph, best) = golden(name);
        assert!(
            difference(&poses(&graph), &best) >= 0.1,
            "{name} starts off"
        );
        let (found, result) = optimized(&graph);
        let error = difference(&found, &best);
        assert!(error <= 1e-6, "{name}: {error}");
        assert!(
            (result.cost / chi2 - 1.0).abs() <= 1e-7,
            "{name}: {}",
            result.cost
        );
        assert!(result.converged && result.iterations <= 10, "{result:?}");
        assert!(result.initial_cost > 10.0 * result.cost);
    }
}

#[test]
fn one_false_edge_among_right_ones_is_ignored() {
    let (graph, best) = golden("sphere.txt");
    let (from, to) = (KeyframeId(4), KeyframeId(47));
    let wrong = Se3::exp(&Vector6::new(0.9, -0.3, 0.4, 1.0, 0.5, -0.7));
    let with_false_edge = |kernel| {
        let mut graph = graph.clone();
        let false_edge = edge(from, to, wrong, 1e4 * Matrix6::identity());
        graph
            .add_edge(Edge {
                kernel,
                ..false_edge
            })
            .unwrap();
        optimized(&graph)
    };
    let (bent, _) = with_false_edge(RobustKernel::Quadratic);
    assert!(difference(&bent, &best) >= 0.3, "it would bend the sphere");
    let (found, result) = with_false_edge(ROBUST);
    let error = difference(&found, &best);
    assert!(error <= 0.003, "{error}");
    let (false_weight, right_weights) = result.weights.split_last().unwrap();
    assert!(*false_weight <= 1e-4, "{false_weight}");
    assert!(right_weights.iter().all(|weight| *weight == 1.0));
}

#[test]
fn a_right_loop_counts_fully_however_far_poses_have_drifted() {
    let (graph, best) = golden("circle.txt");
    let mut robust = KeyframeGraph::new();
    for (id, pose) in graph.poses() {
        robust.add_keyframe(id, *pose);
    }
    for edge in graph.edges() {
        let is_loop = edge.to.0 != edge.from.0 + 1;
        let kernel = if is_loop {
            ROBUST
        } else {
            RobustKernel::Quadratic
        };
        robust
            .add_edge(Edge {
                kernel,
                ..edge.clone()
            })
            .unwrap();
    }
    let (found, result) = optimized(&robust);
    assert!(
        result.weights.iter().all(|weight| *weight >= 0.9),
        "{:?}",
        result.weights
    );
    assert!(difference(&found, &best) <= 0.02);
}

#[test]
fn parts_that_are_not_connected_keep_their_own_first_keyframe() {
    let step = Se3::exp(&Vector6::new(0.0, 0.1, 0.0, 1.0, 0.0, 0.0));
    let mut graph = KeyframeGraph::new();
    for id in [9, 4, 7, 2, 5] {
        graph.add_keyframe(
            KeyframeId(id),
            Se3::exp(&(f64::from(id) * Vector6::repeat(0.01))),
        );
    }
    for (from, to) in [(7, 2), (9, 4)] {
        let measured = edge(KeyframeId(from), KeyframeId(to), step, Matrix6::identity());
        graph.add_edge(measured).unwrap();
    }
    let before = graph.clone();
    let result = graph.optimize(&OptimizeSettings::default()).unwrap();
    let moved: Vec<u32> = result.corrections.iter().map(|(id, _)| id.0).collect();
    assert_eq!(moved, [7, 9]);
    graph.move_keyframes(&result.corrections);
    for id in [2, 4, 5] {
        assert_eq!(graph.pose(KeyframeId(id)), before.pose(KeyframeId(id)));
    }
    for edge in graph.edges() {
        let [from, to] = [edge.from, edge.to].map(|id| graph.pose(id).unwrap());
        assert!(edge.chi2(from, to) <= 1e-15);
    }
}

#[test]
fn edges_follow_keyframes_that_are_measured_anew_unless_they_are_robust() {
    let at = |x: f64| Se3::exp(&Vector6::new(0.0, 0.0, 0.0, x, 0.0, 0.0));
    let mut graph = KeyframeGraph::new();
    let [first, second] = [0, 1].map(KeyframeId);
    graph.add_keyframe(first, at(0.0));
    graph.add_keyframe(second, at(1.0));
    let tracked = edge(first, second, at(1.0), Matrix6::identity());
    let seen = Edge {
        kernel: ROBUST,
        ..tracked.clone()
    };
    graph.add_edge(tracked).unwrap();
    graph.add_edge(seen).unwrap();
    graph.remeasure_keyframes(&[(second, at(0.5))]);
    let measured = |i: usize| graph.edges()[i].from_from_to;
    assert_eq!((measured(0), measured(1)), (at(1.5), at(1.0)));
}

#[test]
fn what_is_no_measurement_is_refused() {
    let (a, b) = (KeyframeId(0), KeyframeId(1));
    let mut graph = KeyframeGraph::new();
    assert!(graph.is_empty());
    let nothing = graph.optimize(&OptimizeSettings::default()).unwrap();
    assert!(nothing.converged && nothing.corrections.is_empty());
    graph.add_keyframe(a, Se3::identity());
    let good = edge(a, b, Se3::identity(), Matrix6::identity());
    assert_eq!(
        graph.add_edge(good.clone()),
        Err(GraphError::NoSuchKeyframe(b))
    );
    graph.add_keyframe(b, Se3::identity());
    assert_eq!(
        graph.add_edge(Edge {
            to: a,
            ..good.clone()
        }),
        Err(GraphError::SelfEdge(a))
    );
    let mut lopsided = Matrix6::identity();
    lopsided[(0, 3)] = 0.1;
    for information in [
        Matrix6::zeros(),
        -Matrix6::identity(),
        Matrix6::repeat(f64::NAN),
        lopsided,
    ] {
        let bad = Edge {
            information,
            ..good.clone()
        };
        let refused = Err(GraphError::InvalidEdge { from: a, to: b });
        assert_eq!(graph.add_edge(bad), refused);
    }
    let kernel = RobustKernel::DynamicCovarianceScaling { threshold: 0.0 };
    assert!(
        graph
            .add_edge(Edge {
                kernel,
                ..good.clone()
            })
            .is_err()
    );
    let far = Se3::new(
        Se3::identity().rotation,
        nalgebra::Vector3::repeat(f64::INFINITY),
    );
    assert!(
        graph
            .add_edge(Edge {
                from_from_to: far,
                ..good.clone()
            })
            .is_err()
    );
    graph.add_edge(good).unwrap();
    assert_eq!(graph.len(), 2);
    graph.add_keyframe(b, far);
    assert_eq!(
        graph.optimize(&OptimizeSettings::default()),
        Err(GraphError::NotFinite)
    );
}

/// A graph that was saved is read whole, or not at all.
#[test]
fn edges_that_are_read_are_checked_like_any_others() {
    let mut graph = KeyframeGraph::new();
    for (id, x) in [(4, 0.0), (7, 1.0)] {
        let pose = Se3::exp(&Vector6::new(0.1, 0.2, 0.0, x, 0.0, 0.3));
        graph.add_keyframe(KeyframeId(id), pose);
    }
    let tie = |from, to| {
        edge(
            KeyframeId(from),
            KeyframeId(to),
            Se3::identity(),
            Matrix6::identity(),
        )
    };
    graph.add_edge(tie(4, 7)).unwrap();
    let read = |edges: &[Edge]| {
        let poses: Vec<_> = graph.poses().map(|(id, pose)| (id, *pose)).collect();
        let bytes = postcard::to_stdvec(&(poses, edges)).unwrap();
        postcard::from_bytes::<KeyframeGraph>(&bytes)
    };
    let again = read(graph.edges()).unwrap();
    assert!(again.poses().eq(graph.poses()) && again.edges() == graph.edges());
    for bad in [tie(4, 5), tie(7, 7)] {
        assert!(read(&[tie(4, 7), bad]).is_err());
    }
    let mut unsure = tie(7, 4);
    unsure.information[(0, 0)] = -1.0;
    assert!(read(&[unsure]).is_err());
}
