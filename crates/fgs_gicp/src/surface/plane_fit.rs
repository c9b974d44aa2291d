//! Plane fits around several pixels of a row at once, one per SIMD lane: least squares of `1/z =
//! slope_u du + slope_v dv + center` over a window around each pixel.
//!
//! Invariant: the plane of a lane does not depend on the other lanes or on their number.

use fgs_geom::{Image, has_depth};

use super::DepthGrid;

/// `1/z = slope_u (u - u0) + slope_v (v - v0) + center` around pixel (u0, v0).
#[derive(Clone, Copy, Debug)]
pub(super) struct InverseDepthPlane {
    pub slope_u: f64,
    pub slope_v: f64,
    /// Positive.
    pub center: f64,
    /// Measured depth of pixel (u0, v0) itself.
    pub measured_depth_m: f32,
}

/// The planes around the pixels of row `v` in the given columns; `None` where a pixel has no depth
/// or lies outside the image, or where the fit is rejected.
#[inline(always)]
pub(super) fn fit_planes<const N: usize>(
    grid: &DepthGrid,
    depth_m: &Image<f32>,
    columns: [usize; N],
    v: usize,
) -> [Option<InverseDepthPlane>; N] {
    let step = grid.window_step_px.max(1);
    // The window is centred, so that the normal equations of a full window are diagonal.
    let radius = grid.window_radius_px / step * step;
    let usable = |depth: f32| has_depth(depth) && depth <= grid.max_depth_m;
    // Lanes without depth are NaN, for which every comparison is false.
    let depths: [f32; N] = columns.map(|u| match depth_m.get(u, v) {
        Some(depth) if usable(depth) => depth,
        _ => f32::NAN,
    });
    let nearest = depths.map(|depth| depth * (1.0 - grid.max_depth_step));
    let farthest = depths.map(|depth| depth * (1.0 + grid.max_depth_step));
    let centers = depths.map(|depth| 1.0 / depth);
    let mut sums = WindowSums::<N>::ZERO;
    let first_row = v - (v.min(radius) / step) * step;
    for row in (first_row..depth_m.height().min(v + radius + 1)).step_by(step) {
        let pixels = depth_m.row(row);
        let dv = row as i32 - v as i32;
        for i in 0..=2 * radius / step {
            let du = (i * step) as i32 - radius as i32;
            let column = |u: usize| u.wrapping_add_signed(du as isize);
            let depth = columns.map(|u| pixels.get(column(u)).copied().unwrap_or(f32::NAN));
            for lane in 0..N {
                let z = depth[lane];
                let inside = (z >= nearest[lane]) & (z <= farthest[lane]);
                let r = if inside { 1.0 / z - centers[lane] } else { 0.0 };
                sums.add(lane, i32::from(inside), du, dv, r);
            }
        }
    }
    let side = (2 * radius / step + 1) as f64;
    let min_count = (grid.min_support * side * side).max(3.0);
    let mut planes = [None; N];
    for lane in 0..N {
        let (plane, squared_error) = sums.solve(lane, centers[lane], depths[lane]);
        // The relative errors of inverse depth and of depth are the same. A failed fit has a NaN
        // centre and so does not pass the last test.
        let error = squared_error.max(0.0).sqrt() * f64::from(depths[lane]);
        if f64::from(sums.n[lane]) >= min_count && error <= grid.max_fit_error && plane.center > 0.0
        {
            planes[lane] = Some(plane);
        }
    }
    planes
}

/// Sums of du, dv, their products, and the inverse depth relative to that of the centre, which
/// avoids cancellation.
struct WindowSums<const N: usize> {
    n: [i32; N],
    u: [i32; N],
    v: [i32; N],
    uu: [i32; N],
    uv: [i32; N],
    vv: [i32; N],
    r: [f32; N],
    ru: [f32; N],
    rv: [f32; N],
    rr: [f32; N],
}

impl<const N: usize> WindowSums<N> {
    const ZERO: Self = Self {
        n: [0; N],
        u: [0; N],
        v: [0; N],
        uu: [0; N],
        uv: [0; N],
        vv: [0; N],
        r: [0.0; N],
        ru: [0.0; N],
        rv: [0.0; N],
        rr: [0.0; N],
    };

    /// Adds `count` (0 or 1) pixels. `r` is the inverse depth relative to the centre, 0 if `count`
    /// is 0.
    #[inline(always)]
    fn add(&mut self, lane: usize, count: i32, du: i32, dv: i32, r: f32) {
        self.n[lane] += count;
        self.u[lane] += count * du;
        self.v[lane] += count * dv;
        self.uu[lane] += count * (du * du);
        self.uv[lane] += count * (du * dv);
        self.vv[lane] += count * (dv * dv);
        self.r[lane] += r;
        self.ru[lane] += r * du as f32;
        self.rv[lane] += r * dv as f32;
        self.rr[lane] += r * r;
    }

    /// The plane and its mean squared error, from the normal equations by cofactors; NaN if the
    /// pixels are collinear.
    #[inline(always)]
    fn solve(&self, lane: usize, center: f32, measured_depth_m: f32) -> (InverseDepthPlane, f64) {
        let count = |sums: &[i32; N]| f64::from(sums[lane]);
        let [n, u, v] = [&self.n, &self.u, &self.v].map(count);
        let [uu, uv, vv] = [&self.uu, &self.uv, &self.vv].map(count);
        let [r, ru, rv, rr] = [&self.r, &self.ru, &self.rv, &self.rr].map(|x| f64::from(x[lane]));
        let c_uu = vv * n - v * v;
        let c_uv = u * v - uv * n;
        let c_u = uv * v - vv * u;
        let determinant = uu * c_uu + uv * c_uv + u * c_u;
        let inverse = if determinant > 0.0 {
            1.0 / determinant
        } else {
            f64::NAN
        };
        let c_vv = uu * n - u * u;
        let c_v = uv * u - uu * v;
        let c_n = uu * vv - uv * uv;
        let slope_u = (c_uu * ru + c_uv * rv + c_u * r) * inverse;
        let slope_v = (c_uv * ru + c_vv * rv + c_v * r) * inverse;
        let offset = (c_u * ru + c_v * rv + c_n * r) * inverse;
        let squared_error = (rr - slope_u * ru - slope_v * rv - offset * r) / n;
        let plane = InverseDepthPlane {
            slope_u,
            slope_v,
            center: offset + f64::from(center),
            measured_depth_m,
        };
        (plane, squared_error)
    }
}

#[cfg(test)]
#[path = "plane_fit_tests.rs"]
mod tests;
