// Adds up the loss of a step, in a single workgroup and a fixed order.

@group(0) @binding(0) var<uniform> loss: Loss;
@group(0) @binding(1) var<storage, read_write> counts: array<u32>;
@group(0) @binding(2) var<storage, read> loss_sums: array<f32>;
@group(0) @binding(3) var<storage, read> regularizer_sums: array<f32>;

@compute @workgroup_size(GROUP)
fn step_stats(@builtin(local_invocation_index) thread: u32) {
    let workgroups = loss.columns * loss.rows;
    var sum = 0.0;
    for (var i = thread; i < workgroups; i += GROUP) {
        sum += loss.ssim * loss_sums[i] + loss.l1 * loss_sums[workgroups + i]
            + loss.depth * loss_sums[2u * workgroups + i];
    }
    let blocks = (counts[VISIBLE] + GROUP - 1u) / GROUP;
    let weight = loss.scale / f32(max(counts[TOUCHED], 1u));
    for (var i = thread; i < blocks; i += GROUP) {
        sum += weight * regularizer_sums[i];
    }
    let total = workgroup_sum(sum, thread);
    if thread == 0u {
        counts[LOSS] = bitcast<u32>(total);
    }
}
