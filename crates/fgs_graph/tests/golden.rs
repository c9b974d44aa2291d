//! Optima against GTSAM's (golden/make_golden.py), and false loops against the graph without them.

#![allow(clippy::unwrap_used)]

use std::str::FromStr;

use fgs_geom::{KeyframeId, Se3};
use fgs_graph::{Edge, Kernel, KeyframeGraph, OptimizeSettings, Optimized};
use nalgebra::{Matrix6, Vector6};

/// Steps of Gauss-Newton shrink by a constant factor: stopping early shows in the eighth digit.
fn precise() -> OptimizeSettings {
    OptimizeSettings {
        rotation_epsilon_rad: 1e-10,
        translation_epsilon_m: 1e-10,
        ..OptimizeSettings::default()
    }
}

/// A noisy graph, its optimum, and the cost there.
struct Golden {
    graph: KeyframeGraph,
    optimum: Vec<(KeyframeId, Se3)>,
    cost: f64,
}

fn numbers<T: FromStr<Err: std::fmt::Debug>>(words: &[&str]) -> Vec<T> {
    words.iter().map(|word| word.parse().unwrap()).collect()
}

fn pose(words: &[&str]) -> Se3 {
    let [w, x, y, z, a, b, c] = numbers::<f64>(words)[..7] else {
        panic!("seven numbers expected")
    };
    Se3::from_wxyz([w, x, y, z], [a, b, c]).unwrap()
}

fn golden(text: &str) -> Golden {
    let mut golden = Golden {
        graph: KeyframeGraph::new(),
        optimum: Vec::new(),
        cost: f64::NAN,
    };
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let id = |word: usize| KeyframeId(words[word].parse().unwrap());
        match words[0] {
            "pose" => golden.graph.add_keyframe(id(1), pose(&words[2..9])),
            "optimum" => golden.optimum.push((id(1), pose(&words[2..9]))),
            "cost" => golden.cost = words[1].parse().unwrap(),
            _ => {
                let mut upper = numbers::<f64>(&words[10..31]).into_iter();
                let mut information = Matrix6::zeros();
                for row in 0..6 {
                    for column in row..6 {
                        let value = upper.next().unwrap();
                        information[(row, column)] = value;
                        information[(column, row)] = value;
                    }
                }
                let edge = Edge {
                    from: id(1),
                    to: id(2),
                    from_from_to: pose(&words[3..10]),
                    information,
                    kernel: Kernel::Quadratic,
                };
                golden.graph.add_edge(edge).unwrap();
            }
        }
    }
    golden
}

fn circle() -> Golden {
    golden(include_str!("golden/circle.txt"))
}

fn sphere() -> Golden {
    golden(include_str!("golden/sphere.txt"))
}

/// The poses of a graph after an optimisation.
fn corrected(graph: &KeyframeGraph, optimized: &Optimized) -> Vec<(KeyframeId, Se3)> {
    let mut graph = graph.clone();
    graph.move_keyframes(&optimized.corrections);
    graph.poses().map(|(id, pose)| (id, *pose)).collect()
}

/// Largest tangent entry between two lists of poses of the same keyframes.
fn difference(a: &[(KeyframeId, Se3)], b: &[(KeyframeId, Se3)]) -> f64 {
    assert_eq!(a.len(), b.len());
    let pairs = a.iter().zip(b);
    pairs
        .map(|((id_a, a), (id_b, b))| {
            assert_eq!(id_a, id_b);
            (a.inverse() * *b).log().amax()
        })
        .fold(0.0, f64::max)
}

#[test]
fn optima_are_those_of_gtsam() {
    for golden in [circle(), sphere()] {
        let start: Vec<_> = golden.graph.poses().map(|(id, pose)| (id, *pose)).collect();
        let off = difference(&start, &golden.optimum);
        assert!(off > 0.1, "{off}");
        let settings = precise();
        let optimized = golden.graph.optimize(&settings).unwrap();
        let error = difference(&corrected(&golden.graph, &optimized), &golden.optimum);
        assert!(optimized.converged && optimized.rejected.is_empty());
        assert!(optimized.iterations <= 15, "{}", optimized.iterations);
        assert!(error <= 1e-8, "{error}");
        assert!((optimized.cost_after - golden.cost).abs() <= 1e-7 * golden.cost);
        assert!(optimized.cost_before > 5.0 * optimized.cost_after);
        assert_eq!(optimized.corrections[0], (KeyframeId(0), Se3::identity()));
    }
}

/// A loop that claims a place two metres and half a turn off.
fn false_loop(from: u32, to: u32) -> Edge {
    Edge {
        from: KeyframeId(from),
        to: KeyframeId(to),
        from_from_to: Se3::exp(&Vector6::new(0.2, -1.5, 0.9, 1.2, -1.0, 0.8)),
        information: Matrix6::from_diagonal(&Vector6::new(900.0, 900.0, 900.0, 100.0, 90.0, 80.0)),
        kernel: Kernel::TruncatedQuadratic,
    }
}

#[test]
fn a_false_loop_changes_nothing() {
    let golden = circle();
    let settings = precise();
    let without = golden.graph.optimize(&settings).unwrap();
    for (from, to) in [(3, 17), (0, 39), (25, 8)] {
        let mut graph = golden.graph.clone();
        graph.add_edge(false_loop(from, to)).unwrap();
        let with = graph.optimize(&settings).unwrap();
        assert!(with.converged);
        assert_eq!(with.rejected, [golden.graph.edges().len()]);
        let error = difference(&corrected(&graph, &with), &golden.optimum);
        assert!(error <= 1e-8, "{from} {to} {error}");
        let cost = without.cost_after + settings.max_squared_error;
        assert!((with.cost_after - cost).abs() <= 1e-6);
    }
}

/// All edges but those of consecutive keyframes robust, three false ones among them, from a start
/// that drifted until true loops were off by far more than the truncation.
#[test]
fn true_loops_correct_drift_beside_false_ones() {
    let golden = circle();
    let mut graph = KeyframeGraph::new();
    let mut drifted = Se3::identity();
    for (index, edge) in golden.graph.edges().iter().enumerate() {
        graph.add_keyframe(edge.from, drifted);
        if edge.to.0 != edge.from.0 + 1 {
            continue;
        }
        let error = Vector6::new(0.003, -0.002, 0.02, 0.01, -0.01, 0.005) * (index % 3) as f64;
        drifted = drifted * edge.from_from_to * Se3::exp(&error);
        graph.add_keyframe(edge.to, drifted);
    }
    graph.move_keyframes(&[(KeyframeId(0), *golden.graph.pose(KeyframeId(0)).unwrap())]);
    for edge in golden.graph.edges() {
        let consecutive = edge.to.0 == edge.from.0 + 1;
        let kernel = if consecutive {
            Kernel::Quadratic
        } else {
            Kernel::TruncatedQuadratic
        };
        graph
            .add_edge(Edge {
                kernel,
                ..edge.clone()
            })
            .unwrap();
    }
    let count = graph.edges().len();
    for (from, to) in [(2, 22), (33, 9), (15, 31)] {
        graph.add_edge(false_loop(from, to)).unwrap();
    }
    let optimized = graph.optimize(&precise()).unwrap();
    assert!(optimized.converged);
    assert_eq!(optimized.rejected, [count, count + 1, count + 2]);
    let error = difference(&corrected(&graph, &optimized), &golden.optimum);
    assert!(error <= 1e-8, "{error}");
}
