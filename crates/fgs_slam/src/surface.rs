//! How the surface around a pixel is measured from a depth image.
//!
//! One setting for tracking and seeding, so that the sparse map's disks are those that are tracked.

use fgs_geom::Camera;
use fgs_gicp::DepthGrid;

use crate::config::TrackingConfig;

/// A surface seen at a flatter angle than this cosine is too uncertain to use: a pixel's error
/// moves it by many times its size.
const MIN_COSINE: f64 = 0.2;

/// Distance between tracked pixels as a share of the focal length: 4 px at 525 px, which puts
/// points 2 cm apart at 2.5 m, within the distance at which points correspond.
const GRID_STRIDE: f64 = 4.0 / 525.0;

/// The tracking grid.
pub fn tracking_grid(config: &TrackingConfig, camera: &Camera) -> DepthGrid {
    let stride_px = (GRID_STRIDE * camera.intrinsics.fx).round().max(1.0) as usize;
    DepthGrid {
        stride_px: config.grid_stride_px.unwrap_or(stride_px),
        max_depth_m: config.max_depth_m as f32,
        max_fit_error: config.max_fit_error,
        min_cosine: MIN_COSINE,
        ..DepthGrid::default()
    }
}

/// The same measurement at any pixel and depth, for seeding.
pub fn seeding_surface(config: &TrackingConfig, camera: &Camera) -> DepthGrid {
    DepthGrid {
        max_depth_m: f32::INFINITY,
        ..tracking_grid(config, camera)
    }
}
