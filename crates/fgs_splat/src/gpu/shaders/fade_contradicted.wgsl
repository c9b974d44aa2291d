// Hides or fades the gaussians that a measured depth image contradicts; see `contradicted.rs`. One thread
// per gaussian.

@group(0) @binding(1) var<storage, read> depth_m: array<f32>;
@group(0) @binding(2) var<storage, read_write> gaussians: array<Gaussian>;

@compute @workgroup_size(GROUP)
fn fade_contradicted(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= view.count {
        return;
    }
    let center = camera_axes(gaussians[id.x].mean);
    if !are_sane(center) || center.z < NEAR_M {
        return;
    }
    let pixel = view.focal * (center.xy / center.z) + view.center;
    if gaussians[id.x].sparse_id != INFERRED {
        let measured_m = measured_at(pixel);
        if measured_m > 0.0 && center.z < FAR_IN_FRONT * measured_m {
            gaussians[id.x].opacity_logit -= FADE_LOGIT;
        }
        return;
    }
    let log_scales = gaussians[id.x].log_scales;
    let width_px = view.focal.x * exp(max(max(log_scales.x, log_scales.y), log_scales.z)) / center.z;
    // Of what is measured around the centre of a wide one, most decides.
    let reach = select(0, 1, width_px > WIDE_PX);
    let reach_px = select(0.0, width_px, width_px > WIDE_PX);
    var before = 0;
    var measured = 0;
    for (var du = -reach; du <= reach; du++) {
        for (var dv = -reach; dv <= reach; dv++) {
            let measured_m = measured_at(pixel + reach_px * vec2(f32(du), f32(dv)));
            measured += select(0, 1, measured_m > 0.0);
            before += select(0, 1, measured_m > 0.0 && center.z < IN_FRONT * measured_m);
        }
    }
    if 2 * before > measured {
        gaussians[id.x].opacity_logit = HIDDEN_LOGIT;
    }
}

// The depth of the pixel that holds a point of the image; zero where none was measured.
fn measured_at(point: vec2<f32>) -> f32 {
    let pixel = floor(point + 0.5);
    if !(pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < f32(view.width) && pixel.y < f32(view.height)) {
        return 0.0;
    }
    let measured_m = depth_m[u32(pixel.y) * view.width + u32(pixel.x)];
    if !is_sane(measured_m) || measured_m <= 0.0 {
        return 0.0;
    }
    return measured_m;
}
