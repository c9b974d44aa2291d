// Frustum culling: first by a gaussian's centre and longest axis, as in `cpu/cull.rs`, then by the
// pixel rows of its support.

fn is_in_view(gaussian: Gaussian) -> bool {
    let center = camera_axes(gaussian.mean);
    let logs = gaussian.log_scales;
    let longest = exp(clamp(max(max(logs.x, logs.y), logs.z), -80.0, 80.0));
    let off = abs(center.xy - view.frustum_middle * center.z);
    let limit = view.frustum_half * center.z + view.frustum_reach * longest;
    if center.z < NEAR_M || off.x > limit.x || off.y > limit.y {
        return false;
    }
    let p = projection(gaussian);
    if !p.drawn {
        return false;
    }
    let support = support_of(splat_of(p));
    return support.first_row <= support.last_row;
}
