// Collects the gaussians of the sparse map that steps touched since they were last asked for, in
// the order of the gaussians.

@group(0) @binding(0) var<uniform> rule: Prune;
@group(0) @binding(1) var<storage, read> gaussians: array<Gaussian>;
@group(0) @binding(2) var<storage, read_write> block_sums: array<u32>;
@group(0) @binding(4) var<storage, read> visible_sets: array<u32>;
@group(0) @binding(5) var<storage, read_write> moved_gaussians: array<Gaussian>;

fn has_moved(index: u32) -> bool {
    return index < rule.count && gaussians[index].sparse_id != NONE
        && (visible_sets[index / 32u] >> (index % 32u) & 1u) == 1u;
}

@compute @workgroup_size(GROUP)
fn count_moved(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) block: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    count_in_block(u32(has_moved(id.x)), block.x, thread);
}

@compute @workgroup_size(GROUP)
fn write_moved(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) block: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let moved = has_moved(id.x);
    let place = place_in_block(u32(moved), block.x, thread);
    if moved {
        moved_gaussians[place] = gaussians[id.x];
    }
}
