//! Gaussians yield to what is measured behind them later.
//!
//! One that was measured may have been a flying pixel, something that has moved, or right where this
//! measurement is wrong: it fades a little, and vanishes if it is contradicted again and again.
//!
//! Those whose depth was inferred vanish at once. A guess in front of a measured surface hides it, and keeps
//! it from being seeded, since the map is opaque there. A guess on the surface is right, and optimised already.
//! One behind it may belong to something else, which the surface hides. Guesses that the camera has come near
//! are asked for in all of their image: in a doorway they would hang before it like fog.

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

/// A guess that looks wider than this is near: standard deviation in pixels, three times that of a large seed.
/// It hides much, and its centre may be where nothing is measured, or outside of the image.
pub(crate) const WIDE_PX: f32 = 5.0;

/// Hides the inferred gaussians in front of the surface measured where they are, and fades measured ones
/// far in front of it. `depth_m` has the view's size; metres.
pub(crate) fn fade_contradicted(gaussians: &mut Gaussians, view: &View, depth_m: &Image<f32>) {
    let camera = ScreenCamera::<f32>::new(view);
    for i in 0..gaussians.len() {
        let center = camera.camera_axes::<false>(&gaussians.means[i]);
        if center[2] < NEAR_M as f32 {
            continue;
        }
        let pixel = [0, 1]
            .map(|axis| camera.focal[axis] * (center[axis] / center[2]) + camera.center[axis]);
        let is_before =
            |limit: f32, pixel: [f32; 2]| Some(center[2] < limit * measured_at(depth_m, pixel)?);
        let logit = &mut gaussians.opacity_logits[i];
        if !gaussians.inferred[i] {
            if is_before(FAR_IN_FRONT, pixel) == Some(true) {
                *logit -= FADE_LOGIT;
            }
            continue;
        }
        let [x, y, z] = gaussians.log_scales[i];
        let width_px = camera.focal[0] * x.max(y).max(z).exp() / center[2];
        // Of what is measured around the centre of a wide one, most decides.
        let is_wide = width_px > WIDE_PX;
        let (reach, reach_px) = if is_wide { (1, width_px) } else { (0, 0.0) };
        let steps = (-reach..=reach).map(|step| step as f32 * reach_px);
        let (mut before, mut measured) = (0, 0);
        for (du, dv) in steps
            .clone()
            .flat_map(|du| steps.clone().map(move |dv| (du, dv)))
        {
            let around = [pixel[0] + du, pixel[1] + dv];
            if let Some(is_before) = is_before(IN_FRONT, around) {
                measured += 1;
                before += i32::from(is_before);
            }
        }
        if 2 * before > measured {
            *logit = HIDDEN_LOGIT;
        }
    }
}

/// The depth of the pixel that holds a point of the image; `None` where none was measured.
fn measured_at(depth_m: &Image<f32>, pixel: [f32; 2]) -> Option<f32> {
    let [u, v] = pixel.map(|at| (at + 0.5).floor());
    let is_inside = |x: f32, size: usize| x >= 0.0 && x < size as f32;
    if !is_inside(u, depth_m.width()) || !is_inside(v, depth_m.height()) {
        return None;
    }
    let measured_m = depth_m.at(u as usize, v as usize);
    has_depth(measured_m).then_some(measured_m)
}
