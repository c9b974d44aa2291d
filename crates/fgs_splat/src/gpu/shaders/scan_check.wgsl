// The prefix sums of known values after the kinds of divergence that callers have, for the host to look
// at: see `scan_check.rs`.

// Two for each thread: after threads left a loop at different times, and after a branch that some
// threads took.
@group(0) @binding(0) var<storage, read_write> scanned: array<vec2<u32>>;
// How often each thread goes round. Read from memory, so that no compiler can straighten it out.
@group(0) @binding(1) var<storage, read> rounds: array<u32>;

@compute @workgroup_size(GROUP)
fn check_scan(lane: Lane) {
    // 3 thread + 1, reached as `project_vjp` reaches its sums.
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
    // As `cull` leaves out what lies past the last gaussian.
    var second = 0u;
    if rounds[lane.thread] % 3u == 0u {
        second = value;
    }
    scanned[GROUP + lane.thread] = workgroup_scan(second, lane);
}
