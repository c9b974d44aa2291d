//! Projects a gaussian to the screen: its covariance by the local affine approximation plus a
//! low-pass, factored so that no digits cancel and no matrix is inverted, and the plane of its disk
//! for the depth. Branch-free: runs over lanes of gaussians.
//!
//! [`Projection`] keeps what the derivative needs; [`Splat`] is what blending reads.

use fgs_geom::View;

use super::real::Real;
use crate::Gaussians;
use crate::gaussians::SH0_FACTOR;
use crate::kernel::mul_add;
use crate::rendering::{
    ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS_PX2, MAX_MAGNITUDE, MAX_VARIANCE_PX2, MIN_QUAT_NORM2,
    NEAR_M,
};

/// sqrt(log2(e) / 2). Scaling the whitening by it turns `exp(-|y|^2 / 2)` into `2^-(p^2 + q^2)`.
pub(crate) const WHITEN_SCALE: f64 = 0.849_321_800_288_019_1;

/// A view in the rasteriser's number type.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScreenCamera<T> {
    pub width: usize,
    pub height: usize,
    /// Focal lengths x, y and principal point x, y, pixels.
    pub focal: [T; 2],
    pub center: [T; 2],
    /// Limits to which x/z and y/z are clamped where the projection is linearised.
    pub tangent_min: [T; 2],
    pub tangent_max: [T; 2],
    /// Row-major.
    pub camera_from_world: [[T; 3]; 3],
    /// The camera's position in the world, metres.
    pub position: [T; 3],
}

impl<T: Real> ScreenCamera<T> {
    pub fn new(view: &View) -> Self {
        let camera = &view.camera;
        let k = &camera.intrinsics;
        let rotation = view
            .world_from_camera
            .rotation
            .to_rotation_matrix()
            .transpose();
        let tangents = |size: usize, focal: f64, center: f64| {
            let middle = (0.5 * (size as f64 - 1.0) - center) / focal;
            let half = FRUSTUM_MARGIN * 0.5 * size as f64 / focal;
            (T::from_f64(middle - half), T::from_f64(middle + half))
        };
        let (x_min, x_max) = tangents(camera.width, k.fx, k.cx);
        let (y_min, y_max) = tangents(camera.height, k.fy, k.cy);
        let position = view.world_from_camera.translation;
        Self {
            width: camera.width,
            height: camera.height,
            focal: [k.fx, k.fy].map(T::from_f64),
            center: [k.cx, k.cy].map(T::from_f64),
            tangent_min: [x_min, y_min],
            tangent_max: [x_max, y_max],
            camera_from_world: std::array::from_fn(|row| {
                std::array::from_fn(|column| T::from_f64(rotation[(row, column)]))
            }),
            position: std::array::from_fn(|axis| T::from_f64(position[axis])),
        }
    }

    /// A point of the world in camera axes, metres.
    #[inline(always)]
    pub fn camera_axes<const FUSED: bool>(&self, point: &[T; 3]) -> [T; 3] {
        let relative = std::array::from_fn(|axis| point[axis] - self.position[axis]);
        std::array::from_fn(|row| dot::<FUSED, T>(&self.camera_from_world[row], &relative))
    }
}

/// Number of a gaussian's parameters.
pub(super) const PARAMETERS: usize = 14;

/// The parameters of a gaussian as they are stored.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parameters<T> {
    pub mean: [T; 3],
    pub quat: [T; 4],
    pub log_scales: [T; 3],
    pub opacity_logit: T,
    pub sh: [T; 3],
}

impl<T: Real> Parameters<T> {
    #[inline(always)]
    pub fn of(gaussians: &Gaussians<T>, index: usize) -> Self {
        Self {
            mean: gaussians.means[index],
            quat: gaussians.quats[index],
            log_scales: gaussians.log_scales[index],
            opacity_logit: gaussians.opacity_logits[index],
            sh: gaussians.sh[index],
        }
    }

    #[inline(always)]
    pub fn to_array(self) -> [T; PARAMETERS] {
        let [x, y, z] = self.mean;
        let [qw, qx, qy, qz] = self.quat;
        let [sx, sy, sz] = self.log_scales;
        let [r, g, b] = self.sh;
        [
            x,
            y,
            z,
            qw,
            qx,
            qy,
            qz,
            sx,
            sy,
            sz,
            self.opacity_logit,
            r,
            g,
            b,
        ]
    }

    #[inline(always)]
    pub fn from_array(values: [T; PARAMETERS]) -> Self {
        let [x, y, z, qw, qx, qy, qz, sx, sy, sz, opacity_logit, r, g, b] = values;
        Self {
            mean: [x, y, z],
            quat: [qw, qx, qy, qz],
            log_scales: [sx, sy, sz],
            opacity_logit,
            sh: [r, g, b],
        }
    }
}

/// Number of values of a splat.
pub(super) const SPLAT: usize = 14;

/// A projected gaussian as blending reads it. 64 bytes in `f32`: one cache line.
///
/// With `dx = u - mean2d[0]`, `dy = v - mean2d[1]`, `p = whiten_xx dx + whiten_xy dy` and
/// `q = whiten_yy dy`, its alpha is `opacity 2^-(p^2 + q^2)`.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(super) struct Splat<T> {
    /// Pixels.
    pub mean2d: [T; 2],
    pub whiten_xx: T,
    pub whiten_xy: T,
    pub whiten_yy: T,
    pub opacity: T,
    /// RGB, not negative.
    pub color: [T; 3],
    /// z of the centre, metres.
    pub center_depth: T,
    /// `normal . ray(u, v) = plane[0] + plane[1] dx + plane[2] dy`, the normal oriented so that
    /// `plane_offset` is positive. `[-1, 0, 0]` if `plane_offset` is 0 either way.
    pub plane: [T; 3],
    /// `normal . center`, metres: depth = plane_offset / (normal . ray).
    pub plane_offset: T,
}

impl<T: Real> Splat<T> {
    /// p and q at an offset from the centre, pixels.
    #[inline(always)]
    pub fn whitened<const FUSED: bool>(&self, dx: T, dy: T) -> [T; 2] {
        let p = mul_add::<FUSED, T>(self.whiten_xx, dx, self.whiten_xy * dy);
        [p, self.whiten_yy * dy]
    }

    #[inline(always)]
    pub fn to_array(self) -> [T; SPLAT] {
        let [u, v] = self.mean2d;
        let [r, g, b] = self.color;
        let [p0, p1, p2] = self.plane;
        [
            u,
            v,
            self.whiten_xx,
            self.whiten_xy,
            self.whiten_yy,
            self.opacity,
            r,
            g,
            b,
            self.center_depth,
            p0,
            p1,
            p2,
            self.plane_offset,
        ]
    }

    #[inline(always)]
    pub fn from_array(values: [T; SPLAT]) -> Self {
        let [
            u,
            v,
            whiten_xx,
            whiten_xy,
            whiten_yy,
            opacity,
            r,
            g,
            b,
            center_depth,
            p0,
            p1,
            p2,
            plane_offset,
        ] = values;
        Self {
            mean2d: [u, v],
            whiten_xx,
            whiten_xy,
            whiten_yy,
            opacity,
            color: [r, g, b],
            center_depth,
            plane: [p0, p1, p2],
            plane_offset,
        }
    }
}

/// A projected gaussian with what its derivative needs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Projection<T> {
    /// False if the gaussian is too near, too faint or damaged (limits in `rendering.rs`); the
    /// other fields are then meaningless.
    pub drawn: bool,
    /// Centre in camera axes, metres.
    pub center: [T; 3],
    /// x/z and y/z of the centre, and the same clamped, where the projection is linearised.
    pub tangent: [T; 2],
    pub clamped_tangent: [T; 2],
    pub quat_norm: T,
    /// Unit quaternion wxyz.
    pub unit_quat: [T; 4],
    pub scales: [T; 3],
    /// Row-major.
    pub camera_from_gaussian: [[T; 3]; 3],
    /// J camera_from_gaussian diag(scales): `cov2d = half half^T + LOW_PASS_PX2 I`.
    pub half_cov: [[T; 3]; 2],
    /// xx, xy, yy, px^2.
    pub cov2d: [T; 3],
    pub det: T,
    pub opacity: T,
    /// Before clamping at 0.
    pub raw_color: [T; 3],
}

#[inline(always)]
pub(super) fn dot<const FUSED: bool, T: Real>(a: &[T; 3], b: &[T; 3]) -> T {
    let sum = mul_add::<FUSED, T>(a[1], b[1], a[0] * b[0]);
    mul_add::<FUSED, T>(a[2], b[2], sum)
}

/// The rotation matrix of a unit quaternion wxyz, row-major.
#[inline(always)]
fn rotation_matrix<T: Real>([w, x, y, z]: [T; 4]) -> [[T; 3]; 3] {
    let one = T::ONE;
    let two = one + one;
    [
        [
            one - two * (y * y + z * z),
            two * (x * y - w * z),
            two * (x * z + w * y),
        ],
        [
            two * (x * y + w * z),
            one - two * (x * x + z * z),
            two * (y * z - w * x),
        ],
        [
            two * (x * z - w * y),
            two * (y * z + w * x),
            one - two * (x * x + y * y),
        ],
    ]
}

impl<T: Real> Projection<T> {
    /// Projects a gaussian.
    #[inline(always)]
    pub fn new<const FUSED: bool>(parameters: &Parameters<T>, camera: &ScreenCamera<T>) -> Self {
        let Parameters {
            mean,
            quat,
            log_scales,
            opacity_logit,
            sh,
        } = *parameters;
        let rotation = &camera.camera_from_world;
        let center = camera.camera_axes::<FUSED>(&mean);
        let z = center[2];
        let max = T::from_f64(MAX_MAGNITUDE);
        let sane = |values: &[T]| values.iter().fold(true, |all, x| all & (x.abs() <= max));
        let quat_norm2 =
            quat[0] * quat[0] + quat[1] * quat[1] + quat[2] * quat[2] + quat[3] * quat[3];
        let scales = log_scales.map(T::exp::<FUSED>);
        let opacity = T::ONE / (T::ONE + T::exp::<FUSED>(-opacity_logit));
        let quat_norm = quat_norm2.sqrt();
        let unit_quat = quat.map(|q| q / quat_norm);
        let world_from_gaussian = rotation_matrix(unit_quat);
        let camera_from_gaussian: [[T; 3]; 3] = std::array::from_fn(|row| {
            std::array::from_fn(|column| {
                let axis: [T; 3] = std::array::from_fn(|k| world_from_gaussian[k][column]);
                dot::<FUSED, T>(&rotation[row], &axis)
            })
        });
        let tangent = [center[0] / z, center[1] / z];
        let clamped_tangent: [T; 2] = std::array::from_fn(|axis| {
            tangent[axis]
                .max(camera.tangent_min[axis])
                .min(camera.tangent_max[axis])
        });
        let half_cov: [[T; 3]; 2] = std::array::from_fn(|row| {
            let focal = camera.focal[row] / z;
            std::array::from_fn(|k| {
                focal
                    * (camera_from_gaussian[row][k]
                        - clamped_tangent[row] * camera_from_gaussian[2][k])
                    * scales[k]
            })
        });
        let low_pass = T::from_f64(LOW_PASS_PX2);
        let [bx, by] = &half_cov;
        let xx = dot::<FUSED, T>(bx, bx);
        let xy = dot::<FUSED, T>(bx, by);
        let yy = dot::<FUSED, T>(by, by);
        let cross = [
            bx[1] * by[2] - bx[2] * by[1],
            bx[2] * by[0] - bx[0] * by[2],
            bx[0] * by[1] - bx[1] * by[0],
        ];
        // det(half half^T + l I) as a sum of positive terms: xx yy - xy^2 would cancel.
        let det = dot::<FUSED, T>(&cross, &cross) + low_pass * (xx + yy + low_pass);
        let max_variance = T::from_f64(MAX_VARIANCE_PX2);
        let drawn = (z >= T::from_f64(NEAR_M))
            & sane(&mean)
            & sane(&quat)
            & sane(&log_scales)
            & sane(&scales)
            & sane(&sh)
            & sane(&[opacity_logit])
            & (quat_norm2 >= T::from_f64(MIN_QUAT_NORM2))
            & (opacity >= T::from_f64(ALPHA_MIN))
            & (xx <= max_variance)
            & (yy <= max_variance);
        let raw_color =
            sh.map(|coefficient| T::from_f64(0.5) + T::from_f64(SH0_FACTOR) * coefficient);
        Self {
            drawn,
            center,
            tangent,
            clamped_tangent,
            quat_norm,
            unit_quat,
            scales,
            camera_from_gaussian,
            half_cov,
            cov2d: [xx + low_pass, xy, yy + low_pass],
            det,
            opacity,
            raw_color,
        }
    }

    /// The Cholesky factor L^T of the inverse covariance: rows (xx, xy), (0, yy).
    #[inline(always)]
    pub fn whitening(&self) -> [T; 3] {
        let [_, xy, yy] = self.cov2d;
        let whiten_xx = (yy / self.det).sqrt();
        [whiten_xx, -whiten_xx * xy / yy, T::ONE / yy.sqrt()]
    }

    /// The disk's normal (third axis) in camera axes, flipped if needed so that `normal . center`
    /// is not negative; the sign applied; and `normal . center`.
    #[inline(always)]
    pub fn normal<const FUSED: bool>(&self) -> ([T; 3], T, T) {
        let normal: [T; 3] = std::array::from_fn(|row| self.camera_from_gaussian[row][2]);
        let offset = dot::<FUSED, T>(&normal, &self.center);
        let sign = if offset < T::ZERO { -T::ONE } else { T::ONE };
        (normal.map(|n| sign * n), sign, sign * offset)
    }

    #[inline(always)]
    pub fn splat<const FUSED: bool>(&self, camera: &ScreenCamera<T>) -> Splat<T> {
        let scale = T::from_f64(WHITEN_SCALE);
        let [whiten_xx, whiten_xy, whiten_yy] = self.whitening();
        let (normal, _, plane_offset) = self.normal::<FUSED>();
        let z = self.center[2];
        let faces = plane_offset > T::ZERO;
        let or = |value: T, otherwise: T| if faces { value } else { otherwise };
        Splat {
            mean2d: std::array::from_fn(|axis| {
                camera.focal[axis] * self.tangent[axis] + camera.center[axis]
            }),
            whiten_xx: whiten_xx * scale,
            whiten_xy: whiten_xy * scale,
            whiten_yy: whiten_yy * scale,
            opacity: self.opacity,
            color: self.raw_color.map(|c| c.max(T::ZERO)),
            center_depth: z,
            plane: [
                or(plane_offset / z, -T::ONE),
                or(normal[0] / camera.focal[0], T::ZERO),
                or(normal[1] / camera.focal[1], T::ZERO),
            ],
            plane_offset,
        }
    }
}
