//! Extraction of points and their covariances.

mod depth_grid;
mod neighbors;
mod plane_fit;

pub use depth_grid::{DepthGrid, SurfacePoint};
pub use neighbors::{covariances_from_neighbors, points_from_neighbors};
