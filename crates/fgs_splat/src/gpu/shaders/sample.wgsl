// A splat's alpha and depth at a pixel; counterpart of `cpu/sample.rs`. Forward and backward pass
// call the same function. Its multiply-adds are explicit, so that no compiler fuses them in one
// pipeline and not in the other.

struct Sample {
    // The pixel's offset in whitened coordinates.
    p: f32,
    q: f32,
    // Not clamped.
    alpha: f32,
    // normal . ray where `on_plane`, elsewhere some positive value.
    n_ray: f32,
    // Whether the depth is the plane's, plane_offset / n_ray, not the centre's.
    on_plane: bool,
}

fn sample_of(splat: Splat, d: vec2<f32>, min_n_ray: f32) -> Sample {
    var sample: Sample;
    sample.p = fma(splat.whiten_xx, d.x, splat.whiten_xy * d.y);
    sample.q = splat.whiten_yy * d.y;
    let exponent = fma(sample.p, sample.p, sample.q * sample.q);
    sample.alpha = splat.opacity * exp2(-min(exponent, 100.0));
    let n_ray = fma(splat.plane.z, d.y, fma(splat.plane.y, d.x, splat.plane.x));
    sample.n_ray = max(n_ray, min_n_ray);
    sample.on_plane = n_ray >= min_n_ray;
    return sample;
}

// PLANE_MIN_COS times the length of a pixel's ray (z = 1).
fn min_n_ray_at(pixel: vec2<f32>) -> f32 {
    return PLANE_MIN_COS * length(vec3((pixel - view.center) / view.focal, 1.0));
}
