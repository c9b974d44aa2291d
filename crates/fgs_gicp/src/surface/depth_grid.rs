//! Points and surface normals from a grid of pixels of a depth image.
//!
//! Around each grid pixel a plane is fitted to the full-resolution depth. A plane's inverse depth
//! is linear in pixel coordinates, `1/z = a du + b dv + c`, and the error of structured-light and
//! stereo sensors is constant in inverse depth, so plain least squares is both exact on planes and
//! the best estimate on real sensors. Pixels across a depth step are left out.
//! Invariant: a normal has unit length and faces the camera.

use fgs_geom::{Camera, Image, Kernel, dispatch};
use nalgebra::Vector3;

use super::plane_fit::{InverseDepthPlane, fit_planes};
use crate::{Covariance, Point};

/// Which pixels to take and how to fit their surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthGrid {
    /// Distance between grid pixels, in both directions.
    pub stride_px: usize,
    /// The plane is fitted to the pixels at most this far away in each direction.
    pub window_radius_px: usize,
    /// Only every so many pixels of the window are read.
    pub window_step_px: usize,
    /// Depth beyond this is ignored.
    pub max_depth_m: f32,
    /// A window pixel whose depth differs from the centre's by more than this share of it lies
    /// across a depth step.
    pub max_depth_step: f32,
    /// The fit is refused when its root mean square error, as a share of the depth, exceeds this.
    pub max_fit_error: f64,
    /// The fit is refused when the cosine between normal and viewing ray is below this.
    pub min_cosine: f64,
    /// The fit is refused when fewer than this share of the window's pixels lie on the surface.
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

/// A point of the depth image with its surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Column of the pixel.
    pub u: usize,
    /// Row of the pixel.
    pub v: usize,
    /// The measured point, camera axes, metres.
    pub measured: Vector3<f64>,
    /// Where the pixel's ray meets the fitted plane: the same point with the window's noise
    /// averaged out.
    pub fitted: Vector3<f64>,
    /// Unit normal of the fitted plane, facing the camera.
    pub normal: Vector3<f64>,
}

impl SurfacePoint {
    /// As a point of a registration: the fitted position, with the plane's disk as covariance.
    ///
    /// `thickness` is the variance along the normal relative to the tangent plane, [`MIN_EIGENVALUE`]
    /// in GICP; exact depth allows far less. The standard deviation grows with `depth^noise_power`,
    /// as the sensor's does: power 2 for structured light and stereo, 0 for depth that is equally
    /// exact everywhere.
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
    /// The points with a reliable surface, row by row.
    pub fn surface_points(&self, depth_m: &Image<f32>, camera: &Camera) -> Vec<SurfacePoint> {
        dispatch(AllPoints {
            grid: self,
            depth_m,
            camera,
        })
    }

    /// The point of pixel (u, v); `None` where there is no depth or no reliable surface.
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
        // From 1/z = a (u - u0) + b (v - v0) + c with u = fx x/z + cx: the plane m.p = 1.
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

/// Every point of a grid, compiled for each instruction set.
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
                // Those beyond the image have no depth.
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
