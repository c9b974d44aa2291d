// Prefix sums over the GROUP threads of a workgroup, without subgroup operations.

// A thread's index in its workgroup.
struct Lane {
    @builtin(local_invocation_index) thread: u32,
}

var<workgroup> scan_values: array<u32, GROUP>;

// The sum of the values of the threads before this one, and the total. Call in uniform control flow.
fn workgroup_scan(value: u32, lane: Lane) -> vec2<u32> {
    let thread = lane.thread;
    scan_values[thread] = value;
    workgroupBarrier();
    for (var reach = 1u; reach < GROUP; reach *= 2u) {
        var sum = scan_values[thread];
        if thread >= reach {
            sum += scan_values[thread - reach];
        }
        workgroupBarrier();
        scan_values[thread] = sum;
        workgroupBarrier();
    }
    let sums = vec2(scan_values[thread] - value, scan_values[GROUP - 1u]);
    workgroupBarrier();
    return sums;
}
