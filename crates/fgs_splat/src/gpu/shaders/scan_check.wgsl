// Prefix sums of known values after the kinds of divergent control flow that occur in the stages,
// for the host to check: see `scan_check.rs`.

// [2][thread]: after a loop that threads leave at different times, and after a branch that only some
// threads take.
@group(0) @binding(0) var<storage, read_write> scanned: array<vec2<u32>>;
// Iterations per thread, read from memory so that no compiler can remove the divergence.
@group(0) @binding(1) var<storage, read> rounds: array<u32>;

@compute @workgroup_size(GROUP)
fn check_scan(lane: Lane) {
    // 3 thread + 1, by a loop as divergent as that of `project_vjp`.
    var value = 1u;
    for (var round = 0u; round < rounds[lane.thread]; round += 1u) {
        if round % 2u == 0u {
            value += 3u;
        } else {
            value += 5u;
            value -= 2u;
        }
    }
    scanned[lane.thread] = workgroup_scan(value, lane);
    // A branch like that of `cull` for threads past the last gaussian.
    var second = 0u;
    if rounds[lane.thread] % 3u == 0u {
        second = value;
    }
    scanned[GROUP + lane.thread] = workgroup_scan(second, lane);
}
