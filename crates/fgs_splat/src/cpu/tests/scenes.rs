//! Random scenes and views, and number types to run them in.

use fgs_geom::{Camera, Intrinsics, Se3, View};
use nalgebra::Vector6;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::cpu::Real;
use crate::{Gaussians, SH0_FACTOR};

/// A view of that size from a random place, the principal point off the middle.
pub fn random_view(rng: &mut Pcg64Mcg, width: usize, height: usize) -> View {
    let focal = width.max(height) as f64 * rng.random_range(0.6..1.5);
    let intrinsics = Intrinsics {
        fx: focal,
        fy: focal * rng.random_range(0.9..1.1),
        cx: (width as f64 - 1.0) * rng.random_range(0.3..0.7),
        cy: (height as f64 - 1.0) * rng.random_range(0.3..0.7),
    };
    let tangent = Vector6::from_fn(|_, _| rng.random_range(-1.5..1.5));
    View {
        camera: Camera::new(width, height, intrinsics).unwrap(),
        world_from_camera: Se3::exp(&tangent),
    }
}

/// Gaussians in front of the view, of many sizes, some out of view; disks, needles and balls.
pub fn random_gaussians(rng: &mut Pcg64Mcg, view: &View, count: usize) -> Gaussians<f64> {
    let mut gaussians = Gaussians::default();
    let (width, height) = (view.camera.width as f64, view.camera.height as f64);
    for _ in 0..count {
        let depth = rng.random_range(0.5..4.0);
        let u = rng.random_range(-0.3 * width..1.3 * width);
        let v = rng.random_range(-0.3 * height..1.3 * height);
        let mean = view
            .world_from_camera
            .transform(&view.camera.unproject(u, v, depth));
        let pixel = depth / view.camera.intrinsics.fx;
        gaussians.means.push(mean.into());
        let quat = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        gaussians.quats.push(quat);
        let log_pixel = pixel.ln();
        let scales = std::array::from_fn(|_| log_pixel + rng.random_range(-1.5..1.8));
        gaussians.log_scales.push(scales);
        gaussians.opacity_logits.push(rng.random_range(-3.0..8.0));
        let sh = std::array::from_fn(|_| (rng.random_range(-0.1..1.0) - 0.5) / SH0_FACTOR);
        gaussians.sh.push(sh);
        gaussians.inferred.push(false);
    }
    gaussians
}

/// Larger and more opaque, so that many pixels are saturated.
pub fn thicken(gaussians: &mut Gaussians<f64>) {
    for (scales, logit) in (gaussians.log_scales.iter_mut()).zip(&mut gaussians.opacity_logits) {
        *scales = scales.map(|s| s + 1.0);
        *logit += 2.0;
    }
}

pub fn rng(seed: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed)
}

/// The same gaussians in another number type.
pub fn convert<A: Copy, B>(gaussians: &Gaussians<A>, to: impl Fn(A) -> B + Copy) -> Gaussians<B> {
    Gaussians {
        means: gaussians.means.iter().map(|v| v.map(to)).collect(),
        quats: gaussians.quats.iter().map(|v| v.map(to)).collect(),
        log_scales: gaussians.log_scales.iter().map(|v| v.map(to)).collect(),
        opacity_logits: gaussians.opacity_logits.iter().map(|&v| to(v)).collect(),
        sh: gaussians.sh.iter().map(|v| v.map(to)).collect(),
        inferred: gaussians.inferred.clone(),
    }
}

pub fn to_f32(gaussians: &Gaussians<f64>) -> Gaussians<f32> {
    convert(gaussians, f32::from_f64)
}
