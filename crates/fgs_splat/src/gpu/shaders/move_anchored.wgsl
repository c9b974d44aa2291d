// Moves the gaussians anchored to some keyframes and transforms Adam's moments with them; see
// `rigid_motion.rs`. One thread per gaussian. Threads past the last gaussian need no check: buffers
// hold whole workgroups, and what lies behind the last gaussian is unused.

@group(0) @binding(0) var<storage, read> counts: array<u32>;
@group(0) @binding(1) var<storage, read> anchors: array<u32>;
// Sorted by anchor.
@group(0) @binding(2) var<storage, read> motions: array<Motion>;
@group(0) @binding(3) var<storage, read_write> gaussians: array<Gaussian>;
@group(0) @binding(4) var<storage, read_write> first_moments: array<array<vec4<f32>, 4>>;
@group(0) @binding(5) var<storage, read_write> second_moments: array<array<vec4<f32>, 4>>;

@compute @workgroup_size(GROUP)
fn move_anchored(@builtin(global_invocation_id) id: vec3<u32>) {
    // After a void step: the host will resubmit the motion.
    if counts[OVERFLOWED] != 0u || counts[OUT_OF_RANGE] != 0u {
        return;
    }
    let index = id.x;
    let anchor = anchors[index];
    var first = 0u;
    var end = arrayLength(&motions);
    while first < end {
        let middle = (first + end) / 2u;
        if motions[middle].anchor < anchor {
            first = middle + 1u;
        } else {
            end = middle;
        }
    }
    if first == arrayLength(&motions) || motions[first].anchor != anchor {
        return;
    }
    let motion = motions[first];
    let rotation = transpose(mat3x3(motion.row_x, motion.row_y, motion.row_z));
    let q = motion.quat;
    let left = mat4x4(
        q,
        vec4(-q.y, q.x, q.w, -q.z),
        vec4(-q.z, -q.w, q.x, q.y),
        vec4(-q.w, q.z, -q.y, q.x),
    );
    gaussians[index].mean = rotation * gaussians[index].mean + motion.translation;
    gaussians[index].quat = left * gaussians[index].quat;
    first_moments[index][0] = vec4(rotation * first_moments[index][0].xyz, first_moments[index][0].w);
    first_moments[index][1] = left * first_moments[index][1];
    let rotation2 = mat3x3(
        rotation[0] * rotation[0], rotation[1] * rotation[1], rotation[2] * rotation[2],
    );
    let left2 = mat4x4(left[0] * left[0], left[1] * left[1], left[2] * left[2], left[3] * left[3]);
    second_moments[index][0] =
        vec4(rotation2 * second_moments[index][0].xyz, second_moments[index][0].w);
    second_moments[index][1] = left2 * second_moments[index][1];
}
