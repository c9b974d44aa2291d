//! The keyframe graph: the one owner of keyframe poses, the relative motions measured between
//! them, and robust SE(3) pose-graph optimisation. Usable alone.
//!
//! Poses are `world_from_keyframe`, metres. Tangents are `[omega, v]`, perturbations act from the
//! right. Costs are in units of the edges' information, so a true edge costs about six.
//! Invariant: the solve is sequential, so its bits do not depend on the number of threads.

mod block_system;
mod edge;
mod elimination;
mod error;
mod graph;
mod optimize;
mod residual;
mod robust;

pub use edge::{Edge, Kernel};
pub use error::GraphError;
pub use graph::KeyframeGraph;
pub use optimize::{OptimizeSettings, Optimized};
