//! What can be wrong with a graph.

use fgs_geom::KeyframeId;
use thiserror::Error;

/// Why an edge is refused or a graph cannot be optimised.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum GraphError {
    /// An edge at a keyframe that is not in the graph.
    #[error("keyframe {} is not in the graph", id.0)]
    UnknownKeyframe {
        /// The keyframe.
        id: KeyframeId,
    },
    /// An edge from a keyframe to itself.
    #[error("an edge leads from keyframe {} to itself", id.0)]
    SelfEdge {
        /// The keyframe.
        id: KeyframeId,
    },
    /// A relative pose that is no number.
    #[error("the relative pose from keyframe {} to {} is not finite", from.0, to.0)]
    NonFiniteEdge {
        /// Where the edge begins.
        from: KeyframeId,
        /// Where it ends.
        to: KeyframeId,
    },
    /// An information matrix that is not finite, symmetric and positive definite.
    #[error(
        "the information matrix from keyframe {} to {} is not symmetric and positive definite",
        from.0,
        to.0
    )]
    InvalidInformation {
        /// Where the edge begins.
        from: KeyframeId,
        /// Where it ends.
        to: KeyframeId,
    },
    /// A keyframe's pose that is no number.
    #[error("the pose of keyframe {} is not finite", id.0)]
    NonFinitePose {
        /// The keyframe.
        id: KeyframeId,
    },
    /// Finite poses and information too large to compute with.
    #[error("the cost of {edges} edges overflows")]
    CostOverflow {
        /// Number of edges.
        edges: usize,
    },
    /// Settings that are not finite and positive.
    #[error("{setting} must be finite and positive, not {value}")]
    InvalidSetting {
        /// Its name.
        setting: &'static str,
        /// Its value.
        value: f64,
    },
}
