//! Where points and their covariances come from.

mod depth_grid;
mod neighbors;
mod plane_fit;

pub use depth_grid::{DepthGrid, SurfacePoint};
pub use neighbors::covariances_from_neighbors;
