//! Points and surface normals from a grid of pixels of a depth image.
//!
//! Around each grid pixel a plane is fitted to the full-resolution depth. A plane's inverse depth
//! is linear in pixel coordinates, `1/z = a du + b dv + c`, and the error of structured-light and
//! stereo sensors is constant in inverse depth, so plain least squares is both exact on planes and
//! the best estimate on real sensors. Pixels across a depth step are left out.
//! Invariant: a normal has unit length and faces the camera.

use fgs_geom::{Camera, Image, has_depth};
use nalgebra::{Matrix3, Vector3};

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
    /// `thickness` is the variance along the normal relative to that across, [`MIN_EIGENVALUE`]
    /// in GICP; exact depth is served by far less. The covariance grows with the square of
    /// `depth^noise_power`, as the sensor's variance does: power 2 for structured light and stereo,
    /// 0 for depth that is equally exact everywhere.
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
        let stride = self.stride_px.max(1);
        let mut points = Vec::new();
        for v in (stride / 2..depth_m.height()).step_by(stride) {
            for u in (stride / 2..depth_m.width()).step_by(stride) {
                points.extend(self.surface_point(depth_m, camera, u, v));
            }
        }
        points
    }

    /// The point of pixel (u, v); `None` where there is no depth or no reliable surface.
    pub fn surface_point(
        &self,
        depth_m: &Image<f32>,
        camera: &Camera,
        u: usize,
        v: usize,
    ) -> Option<SurfacePoint> {
        let depth = depth_m.get(u, v).filter(|&depth| has_depth(depth))?;
        if depth > self.max_depth_m {
            return None;
        }
        let fit = self.fit_inverse_depth(depth_m, u, v, depth)?;
        let (u0, v0) = (u as f64, v as f64);
        let ray = camera.ray(u0, v0);
        let k = camera.intrinsics;
        // From 1/z = a (u - u0) + b (v - v0) + c with u = fx x/z + cx: the plane m.p = 1.
        let m = Vector3::new(
            fit.slope_u * k.fx,
            fit.slope_v * k.fy,
            fit.center + fit.slope_u * (k.cx - u0) + fit.slope_v * (k.cy - v0),
        );
        let normal = -m.normalize();
        let cosine = -normal.dot(&ray) / ray.norm();
        (cosine >= self.min_cosine).then(|| SurfacePoint {
            u,
            v,
            measured: ray * f64::from(depth),
            fitted: ray / fit.center,
            normal,
        })
    }

    /// Least squares of `1/z = slope_u du + slope_v dv + center` over the window.
    fn fit_inverse_depth(
        &self,
        depth_m: &Image<f32>,
        u: usize,
        v: usize,
        depth: f32,
    ) -> Option<InverseDepthPlane> {
        let step = self.window_step_px.max(1);
        // The window is centred, so that a full one gives a diagonal system.
        let radius = self.window_radius_px / step * step;
        let lowest = |x: usize| x - (x.min(radius) / step) * step;
        let (nearest, farthest) = (
            depth * (1.0 - self.max_depth_step),
            depth * (1.0 + self.max_depth_step),
        );
        let center = 1.0 / depth;
        // Sums of du, dv, their products, and of the inverse depth relative to the centre's, which
        // keeps the digits.
        let [mut n, mut su, mut sv, mut suu, mut suv, mut svv] = [0i32; 6];
        let [mut sr, mut sru, mut srv, mut srr] = [0f32; 4];
        for row in (lowest(v)..depth_m.height().min(v + radius + 1)).step_by(step) {
            let pixels = depth_m.row(row);
            let dv = row as i32 - v as i32;
            for column in (lowest(u)..depth_m.width().min(u + radius + 1)).step_by(step) {
                let z = pixels[column];
                if !(z >= nearest && z <= farthest) {
                    continue;
                }
                let du = column as i32 - u as i32;
                let r = 1.0 / z - center;
                n += 1;
                su += du;
                sv += dv;
                suu += du * du;
                suv += du * dv;
                svv += dv * dv;
                sr += r;
                sru += r * du as f32;
                srv += r * dv as f32;
                srr += r * r;
            }
        }
        let side = (2 * radius / step + 1) as f64;
        if n < 3 || f64::from(n) < self.min_support * side * side {
            return None;
        }
        let [n, su, sv, suu, suv, svv] = [n, su, sv, suu, suv, svv].map(f64::from);
        let [sr, sru, srv, srr] = [sr, sru, srv, srr].map(f64::from);
        let normal_matrix = Matrix3::new(suu, suv, su, suv, svv, sv, su, sv, n);
        let right = Vector3::new(sru, srv, sr);
        let solution = normal_matrix.cholesky()?.solve(&right);
        let squared_error = (srr - solution.dot(&right)).max(0.0) / n;
        let plane = InverseDepthPlane {
            slope_u: solution.x,
            slope_v: solution.y,
            center: solution.z + f64::from(center),
        };
        // A relative error of inverse depth is one of depth.
        let error = squared_error.sqrt() * f64::from(depth);
        (error <= self.max_fit_error && plane.center > 0.0).then_some(plane)
    }
}

/// `1/z = slope_u (u - u0) + slope_v (v - v0) + center`.
struct InverseDepthPlane {
    slope_u: f64,
    slope_v: f64,
    center: f64,
}

#[cfg(test)]
#[path = "depth_grid_tests.rs"]
mod tests;
