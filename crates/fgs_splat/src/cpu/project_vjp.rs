//! The derivative of `project.rs`: from sums over a gaussian's pixels to its parameters.
//!
//! The sums are taken in whitened coordinates, where they are well scaled for gaussians of any
//! size and elongation.

use super::project::{Parameters, Projection, ScreenCamera, WHITEN_SCALE, dot};
use super::real::Real;
use crate::gaussians::SH0_FACTOR;

/// Sums over a gaussian's pixels. `g` is the loss's derivative by the exponent of alpha,
/// `h = weight * d_depth` at pixels that see the disk's plane, `t = 1 / (normal . ray)`; `p`, `q`,
/// `dx`, `dy` as in [`super::project::Splat`]. Padded to a cache line in `f32`.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(super) struct PixelSums<T>(pub [T; SUMS]);

impl<T: Real> PixelSums<T> {
    /// Adds the sums of more pixels.
    #[inline(always)]
    pub fn add(&mut self, other: &Self) {
        for (total, value) in self.0.iter_mut().zip(&other.0) {
            *total += *value;
        }
    }
}

/// Number of places in [`PixelSums`].
pub(super) const SUMS: usize = 16;

/// Positions in [`PixelSums`].
pub(super) mod sum {
    pub const COLOR: usize = 0; // to 2
    pub const G: usize = 3;
    pub const GP: usize = 4;
    pub const GQ: usize = 5;
    pub const GPP: usize = 6;
    pub const GPQ: usize = 7;
    pub const GQQ: usize = 8;
    /// From here on what comes by the depth.
    pub const OF_DEPTH: usize = 9;
    /// weight * d_depth at pixels that take the centre's depth.
    pub const CENTER: usize = 9;
    pub const HT: usize = 10;
    pub const HTT: usize = 11;
    pub const HTT_DX: usize = 12;
    pub const HTT_DY: usize = 13;
    /// Sums a pixel contributes to.
    pub const OF_PIXELS: usize = 14;
    /// In how many tiles a pixel took the gaussian.
    pub const TILES: usize = 14;
}

/// The derivatives by the parameters of a gaussian from the sums over its pixels. Branch-free: runs
/// over lanes of gaussians.
#[inline(always)]
pub(super) fn project_vjp<const FUSED: bool, T: Real>(
    projection: &Projection<T>,
    camera: &ScreenCamera<T>,
    sums: &[T; SUMS],
) -> Parameters<T> {
    let [x, y, z] = projection.center;
    let m = &projection.camera_from_gaussian;
    let half_cov = &projection.half_cov;

    // Whitened first and second moments of g, freed of the blending's scale.
    let unscale = T::from_f64(1.0 / WHITEN_SCALE);
    let (gp, gq) = (sums[sum::GP] * unscale, sums[sum::GQ] * unscale);
    let unscale2 = unscale * unscale;
    let gpp = sums[sum::GPP] * unscale2;
    let gpq = sums[sum::GPQ] * unscale2;
    let gqq = sums[sum::GQQ] * unscale2;

    // exponent = -|y|^2 / 2, y = L^T d, cov2d^-1 = L L^T, L = [[l0, 0], [l1, l2]]:
    // d_mean2d = L sum(g y); d_cov2d = L sum(g y y^T) L^T / 2; d_half_cov = 2 d_cov2d half_cov.
    let [l0, l1, l2] = projection.whitening();
    let d_mean2d = [l0 * gp, l1 * gp + l2 * gq];
    let cov_xx = l0 * l0 * gpp;
    let cov_xy = l0 * (l1 * gpp + l2 * gpq);
    let cov_yy = l1 * (l1 * gpp + l2 * gpq) + l2 * (l1 * gpq + l2 * gqq);
    let d_half_cov: [[T; 3]; 2] = [
        std::array::from_fn(|k| cov_xx * half_cov[0][k] + cov_xy * half_cov[1][k]),
        std::array::from_fn(|k| cov_xy * half_cov[0][k] + cov_yy * half_cov[1][k]),
    ];
    let d_log_scales = std::array::from_fn(|k| {
        d_half_cov[0][k] * half_cov[0][k] + d_half_cov[1][k] * half_cov[1][k]
    });

    // half_cov[r][k] = j[r] (m[r][k] - t[r] m[2][k]) scales[k], j = focal / z, t clamped x/z, y/z.
    let j = [camera.focal[0] / z, camera.focal[1] / z];
    let t = &projection.clamped_tangent;
    let mut d_m = [[T::ZERO; 3]; 3];
    let mut d_tangent = [T::ZERO; 2];
    let mut d_z = T::ZERO;
    for r in 0..2 {
        let d_unscaled: [T; 3] = std::array::from_fn(|k| d_half_cov[r][k] * projection.scales[k]);
        for k in 0..3 {
            d_m[r][k] = j[r] * d_unscaled[k];
            d_m[2][k] += -j[r] * t[r] * d_unscaled[k];
        }
        // j falls with z: d_j j' = -d_j j / z, and d_j j = <d_half_cov, half_cov> of the row.
        d_z += -dot::<FUSED, T>(&d_half_cov[r], &half_cov[r]) / z;
        let d_free = -j[r] * dot::<FUSED, T>(&d_unscaled, &m[2]);
        let free = projection.tangent[r] == t[r];
        d_tangent[r] = if free { d_free } else { T::ZERO };
        // mean2d = focal tangent + center.
        d_tangent[r] += camera.focal[r] * d_mean2d[r];
    }
    d_z += sums[sum::CENTER];
    let mut d_center = [
        d_tangent[0] / z,
        d_tangent[1] / z,
        d_z - (d_tangent[0] * x + d_tangent[1] * y) / (z * z),
    ];

    // depth = (n . center) / (n . ray).
    let (normal, sign, offset) = projection.normal::<FUSED>();
    let d_offset = sums[sum::HT];
    let d_n_ray = -offset * sums[sum::HTT];
    let slope = [
        -offset * sums[sum::HTT_DX] / camera.focal[0],
        -offset * sums[sum::HTT_DY] / camera.focal[1],
    ];
    let d_normal = [
        d_offset * x + d_n_ray * projection.tangent[0] + slope[0],
        d_offset * y + d_n_ray * projection.tangent[1] + slope[1],
        d_offset * z + d_n_ray,
    ];
    for row in 0..3 {
        d_center[row] += d_offset * normal[row];
        d_m[row][2] += sign * d_normal[row];
    }

    let to_world = |v: [T; 3]| -> [T; 3] {
        let rotation = &camera.camera_from_world;
        std::array::from_fn(|column| {
            rotation[0][column] * v[0] + rotation[1][column] * v[1] + rotation[2][column] * v[2]
        })
    };
    // Columns of the derivative by world_from_gaussian.
    let d_rotation: [[T; 3]; 3] =
        std::array::from_fn(|k| to_world([d_m[0][k], d_m[1][k], d_m[2][k]]));

    let g = sums[sum::G];
    let sh_factor = T::from_f64(SH0_FACTOR);
    Parameters {
        mean: to_world(d_center),
        quat: quat_vjp(projection.unit_quat, projection.quat_norm, &d_rotation),
        log_scales: d_log_scales,
        // alpha = opacity e^exponent: d_opacity opacity = g, and opacity' = opacity (1 - opacity).
        opacity_logit: g * (T::ONE - projection.opacity),
        sh: std::array::from_fn(|channel| {
            let d = sh_factor * sums[sum::COLOR + channel];
            let positive = projection.raw_color[channel] > T::ZERO;
            if positive { d } else { T::ZERO }
        }),
    }
}

/// The derivative by a stored quaternion wxyz of that norm, from the columns of the derivative by
/// its rotation matrix.
#[inline(always)]
fn quat_vjp<T: Real>([w, x, y, z]: [T; 4], norm: T, d_columns: &[[T; 3]; 3]) -> [T; 4] {
    let d = |row: usize, column: usize| d_columns[column][row];
    let two = T::ONE + T::ONE;
    let d_unit = [
        two * (x * (d(2, 1) - d(1, 2)) + y * (d(0, 2) - d(2, 0)) + z * (d(1, 0) - d(0, 1))),
        two * (y * (d(0, 1) + d(1, 0)) + z * (d(0, 2) + d(2, 0)) + w * (d(2, 1) - d(1, 2))
            - two * x * (d(1, 1) + d(2, 2))),
        two * (x * (d(0, 1) + d(1, 0)) + z * (d(1, 2) + d(2, 1)) + w * (d(0, 2) - d(2, 0))
            - two * y * (d(0, 0) + d(2, 2))),
        two * (x * (d(0, 2) + d(2, 0)) + y * (d(1, 2) + d(2, 1)) + w * (d(1, 0) - d(0, 1))
            - two * z * (d(0, 0) + d(1, 1))),
    ];
    // Through q / |q|.
    let along = d_unit[0] * w + d_unit[1] * x + d_unit[2] * y + d_unit[3] * z;
    let unit = [w, x, y, z];
    std::array::from_fn(|i| (d_unit[i] - unit[i] * along) / norm)
}
