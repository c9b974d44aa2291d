//! Gaussians whose depth was inferred rather than measured yield to what is measured later.
//!
//! A guess in front of a measured surface hides it, and keeps it from being seeded, since the map is
//! opaque there. A guess on the surface is right, and optimised already. One behind it may belong to
//! something else, which the surface hides.

use fgs_geom::{Image, View, has_depth};

use crate::Gaussians;
use crate::cpu::ScreenCamera;
use crate::rendering::NEAR_M;

/// A guess is in front of a measured surface if its depth is below this share of the measured one:
/// well beyond a depth camera's noise.
pub(crate) const IN_FRONT: f32 = 0.95;

/// The opacity logit of gaussians that are never drawn.
pub(crate) const HIDDEN_LOGIT: f32 = -80.0;

/// Hides the inferred gaussians in front of the surface measured at their centre's pixel. `depth_m`
/// has the view's size; metres.
pub(crate) fn hide_contradicted(gaussians: &mut Gaussians, view: &View, depth_m: &Image<f32>) {
    let camera = ScreenCamera::<f32>::new(view);
    for i in 0..gaussians.len() {
        if gaussians.inferred[i] && is_contradicted(&gaussians.means[i], &camera, depth_m) {
            gaussians.opacity_logits[i] = HIDDEN_LOGIT;
        }
    }
}

fn is_contradicted(mean: &[f32; 3], camera: &ScreenCamera<f32>, depth_m: &Image<f32>) -> bool {
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
    has_depth(measured_m) && z < IN_FRONT * measured_m
}
