use nalgebra::{Matrix6, Vector3, Vector6};

use super::*;
use crate::Kernel;

fn pose(x: f64) -> Se3 {
    Se3::exp(&Vector6::new(0.1 * x, -0.2, 0.3, x, 2.0, 3.0))
}

/// A measurement of one metre along x.
fn edge(from: u32, to: u32, kernel: Kernel) -> Edge {
    Edge {
        from: KeyframeId(from),
        to: KeyframeId(to),
        from_from_to: Se3::exp(&Vector6::new(0.0, 0.0, 0.1, 1.0, 0.0, 0.0)),
        information: Matrix6::identity() * 100.0,
        kernel,
    }
}

fn graph(keyframes: u32) -> KeyframeGraph {
    let mut graph = KeyframeGraph::new();
    for id in (0..keyframes).rev() {
        graph.add_keyframe(KeyframeId(id), pose(id.into()));
    }
    graph
}

fn optimized(graph: &KeyframeGraph) -> Optimized {
    graph.optimize(&OptimizeSettings::default()).unwrap()
}

#[test]
fn keyframes_are_kept_replaced_and_moved() {
    let mut graph = graph(3);
    let ids: Vec<u32> = graph.poses().map(|(id, _)| id.0).collect();
    assert_eq!(ids, [0, 1, 2]);
    graph.add_edge(edge(0, 1, Kernel::Quadratic)).unwrap();
    graph.add_keyframe(KeyframeId(1), pose(7.0));
    assert_eq!(graph.pose(KeyframeId(1)), Some(&pose(7.0)));
    assert_eq!(graph.edges().len(), 1);
    let motion = pose(-3.0);
    graph.move_keyframes(&[(KeyframeId(2), motion), (KeyframeId(9), motion)]);
    let expected = (motion * pose(2.0)).matrix();
    let moved = graph.pose(KeyframeId(2)).unwrap().matrix();
    assert!((moved - expected).amax() <= 1e-14);
    assert_eq!(graph.pose(KeyframeId(0)), Some(&pose(0.0)));
    assert_eq!(graph.pose(KeyframeId(9)), None);
}

#[test]
fn useless_edges_are_refused() {
    let mut graph = graph(2);
    let (from, to) = (KeyframeId(0), KeyframeId(1));
    let valid = edge(0, 1, Kernel::Quadratic);
    let unknown = GraphError::UnknownKeyframe { id: KeyframeId(5) };
    assert_eq!(graph.add_edge(edge(0, 5, Kernel::Quadratic)), Err(unknown));
    let itself = GraphError::SelfEdge { id: from };
    assert_eq!(graph.add_edge(edge(0, 0, Kernel::Quadratic)), Err(itself));
    for bad in [f64::NAN, f64::INFINITY] {
        let mut edge = valid.clone();
        edge.from_from_to.translation.y = bad;
        let error = GraphError::NonFiniteEdge { from, to };
        assert_eq!(graph.add_edge(edge), Err(error));
    }
    let mut asymmetric = valid.information;
    asymmetric[(0, 1)] = 1.0;
    let mut not_finite = valid.information;
    not_finite[(3, 3)] = f64::NAN;
    for information in [Matrix6::zeros(), -valid.information, asymmetric, not_finite] {
        let edge = Edge {
            information,
            ..valid.clone()
        };
        let error = GraphError::InvalidInformation { from, to };
        assert_eq!(graph.add_edge(edge), Err(error));
    }
    assert!(graph.edges().is_empty());
}

#[test]
fn nothing_to_do() {
    let empty = optimized(&KeyframeGraph::new());
    assert!(empty.converged && empty.corrections.is_empty());
    assert_eq!((empty.cost_before, empty.cost_after), (0.0, 0.0));
    let apart = optimized(&graph(3));
    assert!(apart.converged);
    assert!(
        apart
            .corrections
            .iter()
            .all(|(_, correction)| *correction == Se3::identity())
    );
}

/// Each part keeps its own first keyframe, and a chain without loops fulfils its edges.
#[test]
fn parts_are_optimised_one_by_one() {
    let mut graph = graph(6);
    for (from, to) in [(1, 2), (5, 3), (3, 4)] {
        graph
            .add_edge(edge(from, to, Kernel::TruncatedQuadratic))
            .unwrap();
    }
    let optimized = optimized(&graph);
    assert!(optimized.converged && optimized.rejected.is_empty());
    assert!(optimized.cost_after <= 1e-12);
    for (id, correction) in &optimized.corrections {
        let held = [0, 1, 3].contains(&id.0);
        assert_eq!(*correction == Se3::identity(), held, "{id:?}");
    }
    graph.move_keyframes(&optimized.corrections);
    let relative =
        graph.pose(KeyframeId(5)).unwrap().inverse() * *graph.pose(KeyframeId(3)).unwrap();
    let measured = graph.edges()[1].from_from_to;
    assert!((relative.matrix() - measured.matrix()).amax() <= 1e-9);
}

/// Two robust edges that exclude each other may leave a keyframe without any: it stays finite.
#[test]
fn contradicting_edges_leave_numbers() {
    let mut graph = graph(2);
    let mut other = edge(0, 1, Kernel::TruncatedQuadratic);
    other.from_from_to = Se3::exp(&Vector6::new(3.0, 0.0, 0.0, -50.0, 0.0, 0.0));
    graph
        .add_edge(edge(0, 1, Kernel::TruncatedQuadratic))
        .unwrap();
    graph.add_edge(other).unwrap();
    let optimized = optimized(&graph);
    assert!(!optimized.rejected.is_empty());
    graph.move_keyframes(&optimized.corrections);
    assert!(graph.poses().all(|(_, pose)| crate::edge::is_finite(pose)));
}

#[test]
fn what_cannot_be_computed_is_an_error() {
    let mut graph = graph(2);
    graph.add_edge(edge(0, 1, Kernel::Quadratic)).unwrap();
    for (settings, setting) in [
        (
            OptimizeSettings {
                max_squared_error: 0.0,
                ..OptimizeSettings::default()
            },
            "max_squared_error",
        ),
        (
            OptimizeSettings {
                rotation_epsilon_rad: f64::NAN,
                ..OptimizeSettings::default()
            },
            "rotation_epsilon_rad",
        ),
    ] {
        let error = graph.optimize(&settings).unwrap_err();
        assert!(matches!(error, GraphError::InvalidSetting { setting: s, .. } if s == setting));
    }
    let far = Se3::new(pose(0.0).rotation, Vector3::repeat(1e200));
    graph.add_keyframe(KeyframeId(1), far);
    let settings = OptimizeSettings::default();
    assert_eq!(
        graph.optimize(&settings),
        Err(GraphError::CostOverflow { edges: 1 })
    );
    graph.add_keyframe(
        KeyframeId(1),
        Se3::new(far.rotation, Vector3::repeat(f64::NAN)),
    );
    let id = KeyframeId(1);
    assert_eq!(
        graph.optimize(&settings),
        Err(GraphError::NonFinitePose { id })
    );
}
