//! Gaussians yield to what is measured behind them later.
//!
//! One that was measured may have been a flying pixel, something that has moved, or right where this
//! measurement is wrong: it fades a little, and vanishes if it is contradicted again and again.
//!
//! Those whose depth was inferred vanish at once. A guess in front of a measured surface hides it, and keeps it from being seeded, since the map is
//! opaque there. A guess on the surface is right, and optimised already. One behind it may belong to
//! something else, which the surface hides.

use fgs_geom::{Image, View, has_depth};

use crate::Gaussians;
use crate::cpu::ScreenCamera;
use crate::rendering::NEAR_M;

/// A guess is in front of a measured surface if its depth is below this share of the measured one:
/// well beyond a depth camera's noise.
pub(crate) const IN_FRONT: f32 = 0.95;

/// A measured gaussian is contradicted only if its depth is below this share of the measured one: edges
/// are a few pixels off in depth images.
pub(crate) const FAR_IN_FRONT: f32 = 0.8;

/// By so much it fades: an opacity of 0.9 becomes 0.55, 0.14 and 0.02, unless optimisation needs it.
pub(crate) const FADE_LOGIT: f32 = 2.0;

/// The opacity logit of gaussians that are never drawn.
pub(crate) const HIDDEN_LOGIT: f32 = -80.0;

/// Hides the inferred gaussians in front of the surface measured at their centre's pixel, and fades
/// measured ones far in front of it. `depth_m` has the view's size; metres.
pub(crate) fn fade_contradicted(gaussians: &mut Gaussians, view: &View, depth_m: &Image<f32>) {
    let camera = ScreenCamera::<f32>::new(view);
    for i in 0..gaussians.len() {
        let inferred = gaussians.inferred[i];
        let limit = if inferred { IN_FRONT } else { FAR_IN_FRONT };
        if is_in_front(&gaussians.means[i], limit, &camera, depth_m) {
            let logit = &mut gaussians.opacity_logits[i];
            *logit = if inferred {
                HIDDEN_LOGIT
            } else {
                *logit - FADE_LOGIT
            };
        }
    }
}

fn is_in_front(
    mean: &[f32; 3],
    limit: f32,
    camera: &ScreenCamera<f32>,
    depth_m: &Image<f32>,
) -> bool {
    let [x, y, z] = camera.camera_axes::<false>(mean);
    let pixel = [x, y].map(|x| x / z);
    let [u, v] = [0, 1].map(|axis| {
        let pixel = camera.focal[axis] * pixel[axis] + camera.center[axis];
        (pixel + 0.5).floor()
    });
    let is_inside = |x: f32, size: usize| x >= 0.0 && x < size as f32;
    if z < NEAR_M as f32 || !is_inside(u, depth_m.width()) || !is_inside(v, depth_m.height()) {
        return false;
    }
    let measured_m = depth_m.at(u as usize, v as usize);
    has_depth(measured_m) && z < limit * measured_m
}
