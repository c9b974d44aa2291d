// Marks and counts the gaussians in view, and clears the view's visibility set.
//
// Together with `project.wgsl` this is a stream compaction: indices come from prefix sums, not from
// an atomic counter, so that splats keep the order of the gaussians. `project` reads the marks
// instead of repeating the test, which could round differently in another pipeline.

@group(0) @binding(1) var<storage, read> gaussians: array<Gaussian>;
@group(0) @binding(2) var<storage, read_write> block_sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;
@group(0) @binding(4) var<storage, read_write> dispatches: array<u32>;
@group(0) @binding(5) var<storage, read_write> visible_sets: array<u32>;
// Per gaussian: 1 if it is in view, else 0.
@group(0) @binding(6) var<storage, read_write> in_view: array<u32>;

@compute @workgroup_size(GROUP)
fn count_in_view(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) block: vec3<u32>,
    lane: Lane,
) {
    let index = id.x;
    var seen = 0u;
    if index < view.count {
        seen = u32(is_in_view(gaussians[index]));
        in_view[index] = seen;
        if index % 32u == 0u && view.set_start != NONE {
            visible_sets[view.set_start + index / 32u] = 0u;
        }
    }
    count_in_block(seen, block.x, lane);
}

// Scans the block sums, resets the step's counts and sizes its indirect dispatches.
@compute @workgroup_size(GROUP)
fn place_in_view(lane: Lane) {
    let visible = scan_block_sums((view.count + GROUP - 1u) / GROUP, lane);
    if lane.thread == 0u {
        counts[VISIBLE] = visible;
        counts[TOUCHED] = 0u;
        counts[SKIPPED] = 0u;
        let groups = (visible + GROUP - 1u) / GROUP;
        dispatches[PER_VISIBLE] = groups;
        dispatches[PER_VISIBLE + 1u] = 1u;
        dispatches[PER_VISIBLE + 2u] = 1u;
        dispatches[SORT_VISIBLE] = (visible + SORT_BLOCK - 1u) / SORT_BLOCK;
        dispatches[SORT_VISIBLE + 1u] = 1u;
        dispatches[SORT_VISIBLE + 2u] = 1u;
    }
}
