//! Points and surface normals on a regular grid of pixels of a depth image.
//!
//! A plane is fitted to the full-resolution depth around each grid pixel. The inverse depth of a
//! plane is linear in pixel coordinates, `1/z = a du + b dv + c`, and the error of structured-light
//! and stereo sensors is constant in inverse depth. Unweighted least squares is therefore exact on
//! planes and optimal for real sensors. Pixels across a depth discontinuity are excluded.
//! Invariant: normals have unit length and face the camera.

use fgs_geom::{Camera, Image, Kernel, dispatch};
use nalgebra::Vector3;

use super::plane_fit::{InverseDepthPlane, fit_planes};
use crate::{Covariance, Point};

/// Which pixels to sample and how to fit the surface around them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthGrid {
    /// Spacing of the grid pixels in both directions.
    pub stride_px: usize,
    /// Half-width of the window to whose pixels the plane is fitted.
    pub window_radius_px: usize,
    /// Sampling step within the window.
    pub window_step_px: usize,
    /// Larger depths are ignored.
    pub max_depth_m: f32,
    /// A window pixel is taken to lie across a depth discontinuity when its depth differs from that
    /// of the centre by more than this fraction.
    pub max_depth_step: f32,
    /// The fit is rejected if its RMS error, as a fraction of the depth, exceeds this.
    pub max_fit_error: f64,
    /// The fit is rejected if the cosine between normal and viewing ray is below this.
    pub min_cosine: f64,
    /// The fit is rejected if less than this fraction of the window's pixels lies on the surface.
    pub min_support: f64,
}

impl Default for DepthGrid {
    fn default() -> Self {
        Self {
            stride_px: 5,
            window_radius_px: 4,
            window_step_px: 2,
            max_depth_m: f32::INFINITY,
            max_depth_step: 0.05,
            max_fit_error: 0.01,
            min_cosine: 0.1,
            min_support: 0.5,
        }
    }
}

/// A point of the depth image with its surface normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Column of the pixel.
    pub u: usize,
    /// Row of the pixel.
    pub v: usize,
    /// The measured point, camera frame, metres.
    pub measured: Vector3<f64>,
    /// Intersection of the pixel's ray with the fitted plane: the same point with the noise
    /// averaged over the window.
    pub fitted: Vector3<f64>,
    /// Unit normal of the fitted plane, facing the camera.
    pub normal: Vector3<f64>,
}

impl SurfacePoint {
    /// Converts to a point for registration: the fitted position, with a disk in the plane as
    /// covariance.
    ///
    /// `thickness` is the variance along the normal relative to that in the tangent plane:
    /// [`MIN_EIGENVALUE`] in GICP; exact depth allows far less. The standard deviation scales with
    /// `depth^noise_power`, like the sensor noise: power 2 for structured light and stereo, 0 if
    /// the accuracy does not depend on depth.
    ///
    /// [`MIN_EIGENVALUE`]: crate::MIN_EIGENVALUE
    pub fn disk(&self, thickness: f64, noise_power: f64) -> Point {
        let variance = self.fitted.z.powf(2.0 * noise_power);
        Point {
            position: self.fitted.cast(),
            covariance: Covariance::disk(&self.normal, thickness).scaled(variance),
        }
    }
}

impl DepthGrid {
    /// The points with a reliable surface normal, row by row.
    pub fn surface_points(&self, depth_m: &Image<f32>, camera: &Camera) -> Vec<SurfacePoint> {
        dispatch(AllPoints {
            grid: self,
            depth_m,
            camera,
        })
    }

    /// The point at pixel (u, v); `None` if there is no depth or no reliable surface normal.
    pub fn surface_point(
        &self,
        depth_m: &Image<f32>,
        camera: &Camera,
        u: usize,
        v: usize,
    ) -> Option<SurfacePoint> {
        let [plane] = fit_planes(self, depth_m, [u], v);
        self.point_on_plane(&plane?, camera, u, v)
    }

    #[inline(always)]
    fn point_on_plane(
        &self,
        plane: &InverseDepthPlane,
        camera: &Camera,
        u: usize,
        v: usize,
    ) -> Option<SurfacePoint> {
        let (u0, v0) = (u as f64, v as f64);
        let ray = camera.ray(u0, v0);
        let k = camera.intrinsics;
        // Insert u = fx x/z + cx, and likewise v, into 1/z = a (u - u0) + b (v - v0) + c: this
        // gives the plane m.p = 1.
        let m = Vector3::new(
            plane.slope_u * k.fx,
            plane.slope_v * k.fy,
            plane.center + plane.slope_u * (k.cx - u0) + plane.slope_v * (k.cy - v0),
        );
        let normal = -m.normalize();
        let cosine = -normal.dot(&ray) / ray.norm();
        (cosine >= self.min_cosine).then(|| SurfacePoint {
            u,
            v,
            measured: ray * f64::from(plane.measured_depth_m),
            fitted: ray / plane.center,
            normal,
        })
    }
}

/// All points of a grid, compiled for each instruction set.
struct AllPoints<'a> {
    grid: &'a DepthGrid,
    depth_m: &'a Image<f32>,
    camera: &'a Camera,
}

impl Kernel for AllPoints<'_> {
    type Output = Vec<SurfacePoint>;

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) -> Vec<SurfacePoint> {
        let Self {
            grid,
            depth_m,
            camera,
        } = self;
        let stride = grid.stride_px.max(1);
        let first = stride / 2;
        let mut points = Vec::with_capacity(
            depth_m.width().div_ceil(stride) * depth_m.height().div_ceil(stride),
        );
        for v in (first..depth_m.height()).step_by(stride) {
            for first in (first..depth_m.width()).step_by(WIDTH * stride) {
                // Columns beyond the image yield no depth.
                let columns: [usize; WIDTH] = std::array::from_fn(|i| first + i * stride);
                let planes = fit_planes(grid, depth_m, columns, v);
                for (u, plane) in columns.into_iter().zip(planes) {
                    points
                        .extend(plane.and_then(|plane| grid.point_on_plane(&plane, camera, u, v)));
                }
            }
        }
        points
    }
}

#[cfg(test)]
#[path = "depth_grid_tests.rs"]
mod tests;
