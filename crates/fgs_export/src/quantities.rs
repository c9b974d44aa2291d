//! Gaussians and colours in the quantities and axes that several formats share.

use fgs_splat::Gaussians;

/// Fainter gaussians correct colours rather than lie on a surface.
const MIN_OPACITY: f32 = 0.5;

/// Whether gaussian i lies on a measured surface: it is opaque, and its depth was not inferred.
pub(crate) fn is_surface(gaussians: &Gaussians, i: usize) -> bool {
    !gaussians.inferred[i] && gaussians.opacity(i) >= MIN_OPACITY
}

/// From the run's axes (x right, y down, z forward) to x right, y up, z backward, as in OpenGL: half a
/// turn about x.
pub(crate) fn y_up([x, y, z]: [f32; 3]) -> [f32; 3] {
    [x, -y, -z]
}

/// The rotation wxyz of a gaussian after [`y_up`]. The gaussian's own y and z axes are reversed too,
/// which does not change it.
pub(crate) fn y_up_quat([w, x, y, z]: [f32; 4]) -> [f32; 4] {
    [w, x, -y, -z]
}

/// The rotation wxyz of gaussian i, of length 1; none at all if the stored one cannot be normalised.
pub fn unit_quat(gaussians: &Gaussians, i: usize) -> [f32; 4] {
    let quat = gaussians.quats[i];
    let largest = quat.iter().fold(0.0_f32, |largest, q| largest.max(q.abs()));
    // Scaled first, so that no square overflows or vanishes.
    let scaled = quat.map(|q| q / largest);
    let length = scaled.iter().map(|q| q * q).sum::<f32>().sqrt();
    if length.is_finite() {
        scaled.map(|q| q / length)
    } else {
        [1.0, 0.0, 0.0, 0.0]
    }
}

/// 0..1 as 0..255, rounded; beyond is clamped.
pub(crate) fn byte(value: f32) -> u8 {
    (255.0 * value).round() as u8
}

/// An sRGB value 0..1 as linear light, 0..1, as glTF's vertex colours are (IEC 61966-2-1).
pub(crate) fn linear(srgb: f32) -> f32 {
    let srgb = srgb.clamp(0.0, 1.0);
    if srgb <= 0.04045 {
        srgb / 12.92
    } else {
        ((srgb + 0.055) / 1.055).powf(2.4)
    }
}

/// Which component of a quaternion is the largest in magnitude: packed rotations leave it out.
pub(crate) fn index_of_largest(quat: &[f32; 4]) -> usize {
    let larger = |a: usize, b: usize| if quat[b].abs() > quat[a].abs() { b } else { a };
    (1..4).fold(0, larger)
}
