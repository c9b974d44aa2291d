// An Adam step of each touched gaussian; counterpart of `adam.rs`. Adds the regulariser's
// derivative, as in `losses/regularizer.rs`.

@group(0) @binding(0) var<uniform> optimizer: Optimizer;
@group(0) @binding(1) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(2) var<storage, read_write> gaussians: array<Gaussian>;
@group(0) @binding(3) var<storage, read> gaussian_of: array<u32>;
@group(0) @binding(4) var<storage, read> gradients: array<Gradient>;
@group(0) @binding(5) var<storage, read_write> first_moments: array<array<vec4<f32>, 4>>;
@group(0) @binding(6) var<storage, read_write> second_moments: array<array<vec4<f32>, 4>>;
// Bias corrections 1 / (1 - beta_1^t) and 1 / sqrt(1 - beta_2^t), indexed by t - 1.
@group(0) @binding(7) var<storage, read> corrections: array<vec2<f32>>;
// Sum of the regulariser, per workgroup.
@group(0) @binding(8) var<storage, read_write> regularizer_sums: array<f32>;

// Whether all components have finite squares: magnitudes below 2^64. Compares bits: shader compilers
// may assume that neither operands nor results are NaN or infinite.
fn are_usable(v: vec4<f32>) -> bool {
    return all((bitcast<vec4<u32>>(v) & vec4(0x7fffffffu)) < vec4(0x5f800000u));
}

@compute @workgroup_size(GROUP)
fn adam(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) block: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let index = id.x;
    let is_void = atomicLoad(&counts[OVERFLOWED]) != 0u
        || atomicLoad(&counts[OUT_OF_RANGE]) != 0u;
    var regularizer = 0.0;
    if index < atomicLoad(&counts[VISIBLE]) && !is_void && gradients[index].touched == 1u {
        regularizer = move_gaussian(gaussian_of[index], gradients[index]);
    }
    let sum = workgroup_sum(regularizer, thread);
    if thread == 0u {
        regularizer_sums[block.x] = sum;
    }
}

// Returns the gaussian's share of the regulariser.
fn move_gaussian(index: u32, gradient: Gradient) -> f32 {
    let gaussian = gaussians[index];
    let scales = exp(min(gaussian.log_scales, vec3(MAX_LOG_SCALE)));
    let in_plane = scales.x - scales.y;
    let across = scales.z - FLAT_SCALE_M;
    let weight = optimizer.scale_weight / f32(atomicLoad(&counts[TOUCHED]));
    let d_log_scales = gradient.log_scales
        + weight * scales * vec3(sign(in_plane), -sign(in_plane), sign(across));

    let d = array(
        vec4(gradient.mean, gradient.opacity_logit),
        gradient.quat,
        vec4(d_log_scales, 0.0),
        vec4(gradient.sh, 0.0),
    );
    if !(are_usable(d[0]) && are_usable(d[1]) && are_usable(d[2]) && are_usable(d[3])) {
        atomicAdd(&counts[SKIPPED], 1u);
        return abs(in_plane) + abs(across);
    }
    let steps = gaussian.steps;
    let correction = corrections[min(steps, arrayLength(&corrections) - 1u)];
    let decay = inverseSqrt(1.0 + f32(steps) / DECAY_STEPS);
    let rates = array(
        vec4(vec3(optimizer.means * decay), optimizer.opacity_logits),
        vec4(optimizer.quats),
        vec4(optimizer.log_scales),
        vec4(optimizer.sh),
    );
    var moves: array<vec4<f32>, 4>;
    for (var row = 0u; row < 4u; row += 1u) {
        let first = BETA_1 * first_moments[index][row] + (1.0 - BETA_1) * d[row];
        let second = BETA_2 * second_moments[index][row] + (1.0 - BETA_2) * d[row] * d[row];
        first_moments[index][row] = first;
        second_moments[index][row] = second;
        let root = sqrt(second) * correction.y;
        moves[row] = rates[row] * decay * correction.x * first / (root + EPSILON);
    }
    gaussians[index].mean = gaussian.mean - moves[0].xyz;
    gaussians[index].opacity_logit = gaussian.opacity_logit - moves[0].w;
    gaussians[index].quat = gaussian.quat - moves[1];
    gaussians[index].log_scales = gaussian.log_scales - moves[2].xyz;
    gaussians[index].sh = gaussian.sh - moves[3].xyz;
    gaussians[index].steps = min(steps, MAX_STEPS) + 1u;
    return abs(in_plane) + abs(across);
}
