//! The reference rasteriser, slow and obvious: each pixel blends all gaussians, and matrices are
//! multiplied and inverted as in the textbook. Runs on `f64` and on dual numbers. Shares only the
//! constants of `rendering.rs` with the CPU rasteriser.

use fgs_geom::View;
use num_dual::DualNum;

use crate::rendering::{
    ALPHA_MAX, ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS_PX2, MAX_MAGNITUDE, MAX_VARIANCE_PX2,
    MIN_QUAT_NORM2, NEAR_M, PLANE_MIN_COS, TRANSMITTANCE_MIN,
};
use crate::{Gaussians, SH0_FACTOR};

/// One pixel of a render.
#[derive(Clone, Copy, Debug)]
pub struct Pixel<D> {
    pub color: [D; 3],
    pub depth_m: D,
    pub alpha: D,
    /// Smallest relative distance of any comparison along the way from its threshold.
    pub margin: f64,
}

struct Projected<D> {
    center: [D; 3],
    mean2d: [D; 2],
    inverse_cov2d: [[D; 2]; 2],
    normal: [D; 3],
    opacity: D,
    color: [D; 3],
}

fn matmul<D: DualNum<Primitive = f64> + Copy, const R: usize, const K: usize, const C: usize>(
    a: &[[D; K]; R],
    b: &[[D; C]; K],
) -> [[D; C]; R] {
    std::array::from_fn(|r| {
        std::array::from_fn(|c| (0..K).fold(D::zero(), |sum, k| sum + a[r][k] * b[k][c]))
    })
}

fn transpose<D: Copy, const R: usize, const C: usize>(a: &[[D; C]; R]) -> [[D; R]; C] {
    std::array::from_fn(|c| std::array::from_fn(|r| a[r][c]))
}

fn dot<D: DualNum<Primitive = f64> + Copy>(a: &[D; 3], b: &[D; 3]) -> D {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn project<D: DualNum<Primitive = f64> + Copy>(
    gaussians: &Gaussians<D>,
    i: usize,
    view: &View,
) -> Option<Projected<D>> {
    let camera = &view.camera;
    let k = camera.intrinsics;
    let c = |value: f64| D::from(value);

    let stored = [
        &gaussians.means[i][..],
        &gaussians.quats[i],
        &gaussians.log_scales[i],
        &[gaussians.opacity_logits[i]],
        &gaussians.sh[i],
    ];
    if !stored
        .concat()
        .iter()
        .all(|v| v.re().abs() <= MAX_MAGNITUDE)
    {
        return None;
    }
    let scales = gaussians.log_scales[i].map(|s| s.exp());
    let opacity = (D::one() + (-gaussians.opacity_logits[i]).exp()).recip();
    let quat = gaussians.quats[i];
    let norm2 = quat.iter().fold(D::zero(), |sum, &q| sum + q * q);
    if scales.iter().any(|s| s.re() > MAX_MAGNITUDE)
        || opacity.re() < ALPHA_MIN
        || norm2.re() < MIN_QUAT_NORM2
    {
        return None;
    }

    let rotation = view.world_from_camera.rotation.to_rotation_matrix();
    let camera_from_world: [[D; 3]; 3] =
        std::array::from_fn(|r| std::array::from_fn(|col| c(rotation[(col, r)])));
    let position = view.world_from_camera.translation;
    let relative: [[D; 1]; 3] = std::array::from_fn(|a| [gaussians.means[i][a] - c(position[a])]);
    let [[x], [y], [z]] = matmul(&camera_from_world, &relative);
    if z.re() < NEAR_M {
        return None;
    }

    // R(q) v = v + 2 w (u x v) + 2 u x (u x v), column by column.
    let [w, ux, uy, uz] = quat.map(|q| q / norm2.sqrt());
    let cross = |a: [D; 3], b: [D; 3]| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let columns: [[D; 3]; 3] = std::array::from_fn(|axis| {
        let mut v = [D::zero(); 3];
        v[axis] = D::one();
        let once = cross([ux, uy, uz], v);
        let twice = cross([ux, uy, uz], once);
        std::array::from_fn(|r| v[r] + (once[r] * w + twice[r]) * c(2.0))
    });
    let world_from_gaussian = transpose(&columns);
    let mut squared_scales = [[D::zero(); 3]; 3];
    for (axis, s) in scales.iter().enumerate() {
        squared_scales[axis][axis] = *s * *s;
    }
    let covariance = matmul(&matmul(&world_from_gaussian, &squared_scales), &columns);
    let in_camera = matmul(
        &matmul(&camera_from_world, &covariance),
        &transpose(&camera_from_world),
    );

    // The image's middle and 1.3 times its half extent, as tangents.
    let clamp = |tangent: D, size: usize, focal: f64, center: f64| {
        let middle = ((size as f64 - 1.0) / 2.0 - center) / focal;
        let reach = FRUSTUM_MARGIN * size as f64 / 2.0 / focal;
        if tangent.re() < middle - reach {
            c(middle - reach)
        } else if tangent.re() > middle + reach {
            c(middle + reach)
        } else {
            tangent
        }
    };
    let tx = clamp(x / z, camera.width, k.fx, k.cx);
    let ty = clamp(y / z, camera.height, k.fy, k.cy);
    let zero = D::zero();
    let jacobian = [
        [c(k.fx) / z, zero, -c(k.fx) * tx / z],
        [zero, c(k.fy) / z, -c(k.fy) * ty / z],
    ];
    let mut cov2d = matmul(&matmul(&jacobian, &in_camera), &transpose(&jacobian));
    if !(cov2d[0][0].re() <= MAX_VARIANCE_PX2 && cov2d[1][1].re() <= MAX_VARIANCE_PX2) {
        return None;
    }
    cov2d[0][0] += c(LOW_PASS_PX2);
    cov2d[1][1] += c(LOW_PASS_PX2);
    let [[a, b], [b2, d]] = cov2d;
    let det = a * d - b * b2;
    let normal = matmul(&camera_from_world, &columns[2].map(|value| [value])).map(|[value]| value);
    Some(Projected {
        center: [x, y, z],
        mean2d: [c(k.fx) * x / z + c(k.cx), c(k.fy) * y / z + c(k.cy)],
        inverse_cov2d: [[d / det, -b / det], [-b2 / det, a / det]],
        normal,
        opacity,
        color: gaussians.sh[i].map(|sh| {
            let value = sh * c(SH0_FACTOR) + c(0.5);
            if value.re() > 0.0 { value } else { D::zero() }
        }),
    })
}

/// Row-major pixels of a view.
pub fn render<D: DualNum<Primitive = f64> + Copy>(
    gaussians: &Gaussians<D>,
    view: &View,
) -> Vec<Pixel<D>> {
    let mut projected: Vec<_> = (0..gaussians.len())
        .filter_map(|i| project(gaussians, i, view))
        .collect();
    projected.sort_by(|a, b| a.center[2].re().total_cmp(&b.center[2].re()));
    let pixels = (0..view.camera.height).flat_map(|v| (0..view.camera.width).map(move |u| (u, v)));
    pixels
        .map(|(u, v)| blend(&projected, view, u as f64, v as f64))
        .collect()
}

fn blend<D: DualNum<Primitive = f64> + Copy>(
    projected: &[Projected<D>],
    view: &View,
    u: f64,
    v: f64,
) -> Pixel<D> {
    let ray = view.camera.ray(u, v);
    let ray_length = ray.norm();
    let ray: [D; 3] = std::array::from_fn(|axis| D::from(ray[axis]));
    let mut pixel = Pixel {
        color: [D::zero(); 3],
        depth_m: D::zero(),
        alpha: D::zero(),
        margin: f64::INFINITY,
    };
    let mut transmittance = D::one();
    for gaussian in projected {
        pixel.near(transmittance.re(), TRANSMITTANCE_MIN);
        if transmittance.re() < TRANSMITTANCE_MIN {
            break;
        }
        let offset = [
            D::from(u) - gaussian.mean2d[0],
            D::from(v) - gaussian.mean2d[1],
        ];
        let column = offset.map(|o| [o]);
        let [[mahalanobis2]] = matmul(&matmul(&[offset], &gaussian.inverse_cov2d), &column);
        let mut alpha = gaussian.opacity * (mahalanobis2 * D::from(-0.5)).exp();
        pixel.near(alpha.re(), ALPHA_MIN);
        if alpha.re() < ALPHA_MIN {
            continue;
        }
        pixel.near(alpha.re(), ALPHA_MAX);
        if alpha.re() > ALPHA_MAX {
            alpha = D::from(ALPHA_MAX);
        }
        let n_ray = dot(&gaussian.normal, &ray);
        let plane_depth = dot(&gaussian.normal, &gaussian.center) / n_ray;
        let cosine = n_ray.re().abs() / ray_length;
        pixel.near(cosine, PLANE_MIN_COS);
        let depth = if cosine >= PLANE_MIN_COS && plane_depth.re() > 0.0 {
            plane_depth
        } else {
            gaussian.center[2]
        };
        let weight = transmittance * alpha;
        for (sum, color) in pixel.color.iter_mut().zip(gaussian.color) {
            *sum += weight * color;
        }
        pixel.depth_m += weight * depth;
        pixel.alpha += weight;
        transmittance *= D::one() - alpha;
    }
    pixel
}

impl<D> Pixel<D> {
    fn near(&mut self, value: f64, threshold: f64) {
        self.margin = self.margin.min((value / threshold - 1.0).abs());
    }
}
