// Prefix sums over the GROUP threads of a workgroup with subgroup operations. Relies on threads
// filling subgroups in order, which `scan_check.rs` verifies.

// A thread's index in its workgroup, and the subgroup size.
struct Lane {
    @builtin(local_invocation_index) thread: u32,
    @builtin(subgroup_size) subgroup_size: u32,
}

var<workgroup> subgroup_sums: array<u32, GROUP>;

// The sum of the values of the threads before this one, and the total. Call in uniform control flow.
fn workgroup_scan(value: u32, lane: Lane) -> vec2<u32> {
    let thread = lane.thread;
    let inclusive = subgroupInclusiveAdd(value);
    let size = lane.subgroup_size;
    let own = thread / size;
    if thread % size == size - 1u {
        subgroup_sums[own] = inclusive;
    }
    workgroupBarrier();
    var before = 0u;
    var total = 0u;
    for (var subgroup = 0u; subgroup < GROUP / size; subgroup += 1u) {
        if subgroup == own {
            before = total;
        }
        total += subgroup_sums[subgroup];
    }
    workgroupBarrier();
    return vec2(before + inclusive - value, total);
}
