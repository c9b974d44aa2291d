// Prefix sums over the GROUP threads of a workgroup, which fill its subgroups in order.

var<workgroup> subgroup_sums: array<u32, GROUP>;

// The sum of the values of the threads before this one, and of all. To be called by all threads.
fn workgroup_scan(value: u32, thread: u32) -> vec2<u32> {
    let inclusive = subgroupInclusiveAdd(value);
    let size = subgroupAdd(1u);
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
