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
    let pixel = floor(view.focal * (center.xy / center.z) + view.center + 0.5);
    if pixel.x < 0.0 || pixel.y < 0.0 || pixel.x >= f32(view.width) || pixel.y >= f32(view.height) {
        return;
    }
    let measured_m = depth_m[u32(pixel.y) * view.width + u32(pixel.x)];
    if !is_sane(measured_m) || measured_m <= 0.0 {
        return;
    }
    if gaussians[id.x].sparse_id == INFERRED {
        if center.z < IN_FRONT * measured_m {
            gaussians[id.x].opacity_logit = HIDDEN_LOGIT;
        }
    } else if center.z < FAR_IN_FRONT * measured_m {
        gaussians[id.x].opacity_logit -= FADE_LOGIT;
    }
}
