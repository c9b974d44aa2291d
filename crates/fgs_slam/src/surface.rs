//! How the surface around a pixel is measured from a depth image.
//!
//! One setting for tracking and seeding, so that the sparse map's disks are those that are tracked.

use fgs_gicp::DepthGrid;

use crate::config::TrackingConfig;

/// The tracking grid.
pub fn tracking_grid(config: &TrackingConfig) -> DepthGrid {
    DepthGrid {
        stride_px: config.grid_stride_px,
        max_depth_m: config.max_depth_m as f32,
        ..DepthGrid::default()
    }
}

/// The same measurement for seeding, which uses all depth there is.
pub fn seeding_surface() -> DepthGrid {
    DepthGrid {
        max_depth_m: f32::INFINITY,
        ..DepthGrid::default()
    }
}
