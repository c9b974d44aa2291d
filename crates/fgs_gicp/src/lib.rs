//! Generalised ICP (Segal et al. 2009) of points with covariances against an incremental map, as in
//! the paper's tracker (Sec. III-B). Can be used on its own.
//!
//! A [`DepthGrid`] extracts points and surface normals from a depth image, a [`PointMap`] holds the
//! target points, and [`align`] estimates the pose. `target_from_source` maps source points to the
//! target frame, in metres.

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
pub use surface::{DepthGrid, SurfacePoint, covariances_from_neighbors, points_from_neighbors};
pub use target::{Neighbor, PointMap};
