//! How the surface around a pixel is measured from a depth image.
//!
//! Tracking and seeding measure alike, so that the disks of the sparse map are the ones that are
//! tracked.

use fgs_geom::Camera;
use fgs_gicp::DepthGrid;

use crate::config::SlamConfig;

/// A surface seen at a more grazing angle (cosine to the normal) is not used: an error of one pixel
/// moves the point along it by many times its size.
const MIN_COSINE: f64 = 0.2;

/// Spacing of tracked pixels as a share of the focal length: 4 px at 525 px, which puts points 2 cm
/// apart at 2.5 m, within the correspondence distance.
const GRID_STRIDE: f64 = 4.0 / 525.0;

/// The tracking grid.
pub fn tracking_grid(config: &SlamConfig, camera: &Camera) -> DepthGrid {
    let stride_px = (GRID_STRIDE * camera.intrinsics.fx).round().max(1.0) as usize;
    DepthGrid {
        stride_px: config.tracking.grid_stride_px.unwrap_or(stride_px),
        max_depth_m: config.tracking.max_depth_m as f32,
        max_fit_error: config.surface.max_fit_error,
        min_cosine: MIN_COSINE,
        ..DepthGrid::default()
    }
}

/// The same measurement at any pixel and depth, for seeding.
pub fn seeding_surface(config: &SlamConfig, camera: &Camera) -> DepthGrid {
    DepthGrid {
        max_depth_m: f32::INFINITY,
        ..tracking_grid(config, camera)
    }
}
