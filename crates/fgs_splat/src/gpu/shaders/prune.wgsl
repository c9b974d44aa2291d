// Pruning as a stable partition of the gaussians and all of their state: survivors first.

@group(0) @binding(0) var<uniform> rule: Prune;
@group(0) @binding(1) var<storage, read> gaussians: array<Gaussian>;
@group(0) @binding(2) var<storage, read_write> block_sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;
// 1 for survivors, else 0; after `move_survivors` the new index, NONE for removed gaussians.
@group(0) @binding(4) var<storage, read_write> new_from_old: array<u32>;
@group(0) @binding(5) var<storage, read_write> moved_gaussians: array<Gaussian>;
// Sparse ids of the removed gaussians, in order; NONE or INFERRED for those without.
@group(0) @binding(6) var<storage, read_write> removed_ids: array<u32>;
// One of Adam's two moments, before and after.
@group(0) @binding(7) var<storage, read> rows: array<array<vec4<f32>, 4>>;
@group(0) @binding(8) var<storage, read_write> moved_rows: array<array<vec4<f32>, 4>>;
@group(0) @binding(9) var<storage, read> visible_sets: array<u32>;
@group(0) @binding(10) var<storage, read_write> moved_sets: array<atomic<u32>>;
@group(0) @binding(11) var<storage, read> anchors: array<u32>;
@group(0) @binding(12) var<storage, read_write> moved_anchors: array<u32>;

// Compares bits: shader compilers may assume that there is no NaN.
fn is_number(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7fffffffu) <= 0x7f800000u;
}

// A NaN among opacity and scales does not survive.
fn survives(gaussian: Gaussian) -> bool {
    let logs = gaussian.log_scales;
    if !(is_number(gaussian.opacity_logit) && is_number(logs.x) && is_number(logs.y)
        && is_number(logs.z)) {
        return false;
    }
    let opacity = 1.0 / (1.0 + exp(clamp(-gaussian.opacity_logit, -80.0, 80.0)));
    let longest = max(max(logs.x, logs.y), logs.z);
    let middle = max(min(logs.x, logs.y), min(max(logs.x, logs.y), logs.z));
    return opacity >= rule.min_opacity && longest <= rule.max_log_scale
        && longest - middle <= rule.max_log_aspect;
}

@compute @workgroup_size(GROUP)
fn count_survivors(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) block: vec3<u32>,
    lane: Lane,
) {
    let index = id.x;
    // After a void step nothing may change: the host will resubmit the pruning.
    let is_void = counts[OVERFLOWED] != 0u || counts[OUT_OF_RANGE] != 0u;
    var kept = 0u;
    if index < rule.count {
        // Without an anchor: removed by an earlier pruning that the host has not read back yet.
        kept = u32(is_void || (anchors[index] != NONE && survives(gaussians[index])));
        new_from_old[index] = kept;
    }
    count_in_block(kept, block.x, lane);
}

@compute @workgroup_size(GROUP)
fn place_survivors(lane: Lane) {
    let kept = scan_block_sums((rule.count + GROUP - 1u) / GROUP, lane);
    if lane.thread == 0u {
        counts[KEPT] = kept;
    }
}

// Removed gaussians go behind the survivors, too transparent to be drawn: the host includes them in
// its count until it has read back how many survived.
@compute @workgroup_size(GROUP)
fn move_survivors(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) block: vec3<u32>,
    lane: Lane,
) {
    let index = id.x;
    var kept = false;
    if index < rule.count {
        kept = new_from_old[index] == 1u;
    }
    let place = place_in_block(u32(kept), block.x, lane);
    if index >= rule.count {
        return;
    }
    var gaussian = gaussians[index];
    if kept {
        moved_gaussians[place] = gaussian;
        moved_anchors[place] = anchors[index];
        new_from_old[index] = place;
    } else {
        let behind = index - place;
        removed_ids[behind] = gaussian.sparse_id;
        gaussian.sparse_id = NONE;
        gaussian.opacity_logit = HIDDEN_LOGIT;
        moved_gaussians[counts[KEPT] + behind] = gaussian;
        moved_anchors[counts[KEPT] + behind] = NONE;
        new_from_old[index] = NONE;
    }
}

@compute @workgroup_size(GROUP)
fn move_rows(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < rule.count && new_from_old[id.x] != NONE {
        moved_rows[new_from_old[id.x]] = rows[id.x];
    }
}

// One thread per word of each set; `moved_sets` starts out as zeros.
@compute @workgroup_size(GROUP)
fn move_sets(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x * 32u >= rule.count {
        return;
    }
    let set_start = id.y * rule.set_words;
    var rest = visible_sets[set_start + id.x];
    while rest != 0u {
        let place = new_from_old[id.x * 32u + countTrailingZeros(rest)];
        rest &= rest - 1u;
        if place != NONE {
            atomicOr(&moved_sets[set_start + place / 32u], 1u << (place % 32u));
        }
    }
}
