//! How the surface around a pixel is measured from a depth image.
//!
//! One setting for tracking and seeding, so that the sparse map's disks are those that are tracked.

use fgs_gicp::DepthGrid;

use crate::config::TrackingConfig;

/// A surface seen at a flatter angle than this cosine is too uncertain to use: a pixel's error
/// moves it by many times its size.
const MIN_COSINE: f64 = 0.2;

/// The tracking grid.
pub fn tracking_grid(config: &TrackingConfig) -> DepthGrid {
    DepthGrid {
        stride_px: config.grid_stride_px,
        max_depth_m: config.max_depth_m as f32,
        max_fit_error: config.max_fit_error,
        min_cosine: MIN_COSINE,
        ..DepthGrid::default()
    }
}

/// The same measurement at any pixel and depth, for seeding.
pub fn seeding_surface(config: &TrackingConfig) -> DepthGrid {
    DepthGrid {
        max_depth_m: f32::INFINITY,
        ..tracking_grid(config)
    }
}
