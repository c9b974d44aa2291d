//! The graph itself: who owns the poses of keyframes, and what was measured between them.

use std::collections::BTreeMap;

use fgs_geom::{KeyframeId, Se3};
use serde::{Deserialize, Serialize};

use crate::edge::Edge;
use crate::kernel::RobustKernel;

/// Keyframes with their poses, and edges between them.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(try_from = "Parts")]
pub struct KeyframeGraph {
    pub(crate) poses: BTreeMap<KeyframeId, Se3>,
    pub(crate) edges: Vec<Edge>,
}

/// A graph as it is read, before its edges have been checked.
#[derive(Deserialize)]
struct Parts {
    poses: BTreeMap<KeyframeId, Se3>,
    edges: Vec<Edge>,
}

impl TryFrom<Parts> for KeyframeGraph {
    type Error = GraphError;

    fn try_from(parts: Parts) -> Result<Self, GraphError> {
        let mut graph = Self {
            poses: parts.poses,
            edges: Vec::new(),
        };
        for edge in parts.edges {
            graph.add_edge(edge)?;
        }
        Ok(graph)
    }
}

/// Why a graph refuses a call.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GraphError {
    /// An edge's end is no keyframe of the graph.
    #[error("there is no keyframe {0:?}")]
    NoSuchKeyframe(KeyframeId),
    /// An edge from a keyframe to itself.
    #[error("an edge from keyframe {0:?} to itself")]
    SelfEdge(KeyframeId),
    /// An edge whose numbers are not finite, whose information is not symmetric and positive
    /// definite, or whose kernel's threshold is not positive.
    #[error("the edge from keyframe {from:?} to {to:?} is no measurement")]
    InvalidEdge {
        /// One end.
        from: KeyframeId,
        /// The other end.
        to: KeyframeId,
    },
    /// Poses that are not finite, or so far apart that their errors are not.
    #[error("the poses' errors are not finite")]
    NotFinite,
}

impl KeyframeGraph {
    /// No keyframes.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a keyframe at `world_from_keyframe`. One that is there already gets this pose.
    pub fn add_keyframe(&mut self, id: KeyframeId, world_from_keyframe: Se3) {
        self.poses.insert(id, world_from_keyframe);
    }

    /// `world_from_keyframe`.
    pub fn pose(&self, id: KeyframeId) -> Option<&Se3> {
        self.poses.get(&id)
    }

    /// All keyframes with their poses, ascending by id.
    pub fn poses(&self) -> impl Iterator<Item = (KeyframeId, &Se3)> {
        self.poses.iter().map(|(id, pose)| (*id, pose))
    }

    /// Number of keyframes.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there are no keyframes.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Moves keyframes, each by its `new_world_from_old_world`. Unknown ones are ignored.
    pub fn move_keyframes(&mut self, moves: &[(KeyframeId, Se3)]) {
        for (id, new_from_old) in moves {
            if let Some(pose) = self.poses.get_mut(id) {
                *pose = *new_from_old * *pose;
            }
        }
    }

    /// Moves keyframes as [`move_keyframes`](Self::move_keyframes) does, and their edges with them:
    /// for keyframes that were measured anew against what their edges were measured against. Edges with a
    /// robust kernel stay: what was measured between two keyframes does not depend on their poses.
    pub fn remeasure_keyframes(&mut self, moves: &[(KeyframeId, Se3)]) {
        self.move_keyframes(moves);
        for edge in &mut self.edges {
            let is_moved = |end| moves.iter().any(|(id, _)| *id == end);
            if edge.kernel == RobustKernel::Quadratic
                && (is_moved(edge.from) || is_moved(edge.to))
                && let (Some(from), Some(to)) =
                    (self.poses.get(&edge.from), self.poses.get(&edge.to))
            {
                edge.from_from_to = from.inverse() * *to;
            }
        }
    }

    /// Adds a measurement.
    ///
    /// # Errors
    /// If an end is unknown, both ends are the same, or the edge is no valid measurement.
    pub fn add_edge(&mut self, edge: Edge) -> Result<(), GraphError> {
        for id in [edge.from, edge.to] {
            if !self.poses.contains_key(&id) {
                return Err(GraphError::NoSuchKeyframe(id));
            }
        }
        if edge.from == edge.to {
            return Err(GraphError::SelfEdge(edge.from));
        }
        if !edge.is_valid() {
            return Err(GraphError::InvalidEdge {
                from: edge.from,
                to: edge.to,
            });
        }
        self.edges.push(edge);
        Ok(())
    }

    /// All measurements, in the order they came.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }
}
