//! Generalised ICP (Segal et al. 2009) of points with covariances against an incremental map, as
//! the paper's tracker uses it (Sec. III-B). Usable alone.
//!
//! A [`DepthGrid`] takes points and surfaces from a depth image; a [`PointMap`] holds the target;
//! [`align`] finds the motion. `target_from_source` maps source to target, metres.

mod covariance;
mod point;
mod registration;
mod surface;
mod target;

pub use covariance::{Covariance, MIN_EIGENVALUE};
pub use point::Point;
pub use registration::{
    AlignError, Alignment, Conditioning, Factor, Kernel, LinearSystem, Settings, align,
};
pub use surface::{DepthGrid, SurfacePoint, covariances_from_neighbors};
pub use target::{Neighbor, PointMap};
