//! Keyframes with their poses, and the edges between them.

use std::collections::BTreeMap;

use fgs_geom::{KeyframeId, Se3};

use crate::optimize::{self, OptimizeSettings, Optimized};
use crate::{Edge, GraphError};

/// The keyframes' poses and the relative motions measured between them.
#[derive(Clone, Debug, Default)]
pub struct KeyframeGraph {
    poses: BTreeMap<KeyframeId, Se3>,
    edges: Vec<Edge>,
}

impl KeyframeGraph {
    /// A graph without keyframes.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a keyframe. One that is there already gets the new pose and keeps its edges.
    pub fn add_keyframe(&mut self, id: KeyframeId, world_from_keyframe: Se3) {
        self.poses.insert(id, world_from_keyframe);
    }

    /// `world_from_keyframe` of a keyframe, if there is such a one.
    pub fn pose(&self, id: KeyframeId) -> Option<&Se3> {
        self.poses.get(&id)
    }

    /// Every keyframe with its `world_from_keyframe`, ascending by id.
    pub fn poses(&self) -> impl Iterator<Item = (KeyframeId, &Se3)> {
        self.poses.iter().map(|(id, pose)| (*id, pose))
    }

    /// Moves keyframes, each by a `new_world_from_old_world` that acts from the left. Keyframes that
    /// are not in the graph are passed over. Edges stay: they are relative.
    pub fn move_keyframes(&mut self, moves: &[(KeyframeId, Se3)]) {
        for (id, new_world_from_old_world) in moves {
            if let Some(pose) = self.poses.get_mut(id) {
                *pose = (*new_world_from_old_world * *pose).renormalized();
            }
        }
    }

    /// Adds an edge. Several between the same two keyframes all count.
    ///
    /// # Errors
    /// Unknown keyframes, an edge from a keyframe to itself, values that are not finite, and
    /// information that is not symmetric and positive definite. The graph is then unchanged.
    pub fn add_edge(&mut self, edge: Edge) -> Result<(), GraphError> {
        for id in [edge.from, edge.to] {
            if !self.poses.contains_key(&id) {
                return Err(GraphError::UnknownKeyframe { id });
            }
        }
        edge.check()?;
        self.edges.push(edge);
        Ok(())
    }

    /// The edges in the order in which they were added.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// The poses that agree best with the edges, as corrections to be given to
    /// [`move_keyframes`](Self::move_keyframes); the graph itself is not changed. In each part of
    /// the graph that edges connect, the keyframe of lowest id stays where it is. An empty graph
    /// has no corrections. Running out of iterations is no error: see [`Optimized::converged`].
    ///
    /// # Errors
    /// A pose that is not finite, values that overflow, and settings that are not positive.
    pub fn optimize(&self, settings: &OptimizeSettings) -> Result<Optimized, GraphError> {
        optimize::optimize(&self.poses, &self.edges, settings)
    }
}

#[cfg(test)]
#[path = "graph_tests.rs"]
mod tests;
