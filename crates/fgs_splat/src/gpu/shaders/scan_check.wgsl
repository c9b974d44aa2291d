// The prefix sums of known values, for the host to look at: see `scan_check.rs`.

@group(0) @binding(0) var<storage, read_write> scanned: array<vec2<u32>>;

@compute @workgroup_size(GROUP)
fn check_scan(@builtin(local_invocation_index) thread: u32) {
    scanned[thread] = workgroup_scan(3u * thread + 1u, thread);
}
