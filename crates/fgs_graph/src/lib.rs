//! The keyframe graph: poses of keyframes, measured relative poses between them, and the poses that
//! fit all measurements best. Usable alone.
//!
//! [`KeyframeGraph`] owns the poses `world_from_keyframe`. An [`Edge`] says how two keyframes were
//! found to lie to each other, and how sure that is. [`KeyframeGraph::optimize`] minimises
//! `sum over edges of rho(r^T I r)`, with `r = log(measured^-1 * from^-1 * to)`, over all poses.
//!
//! The optimisation is ours because the kept crates for it bring more than they save here (an
//! optimiser for any manifold and any factor, a dense algebra library of their own); the sparse
//! Cholesky decomposition is nalgebra's.

mod components;
mod edge;
mod graph;
mod kernel;
mod normal_equations;
mod optimize;
mod ordering;
mod tangent;

pub use edge::Edge;
pub use graph::{GraphError, KeyframeGraph};
pub use kernel::RobustKernel;
pub use optimize::{OptimizeSettings, Optimized};
