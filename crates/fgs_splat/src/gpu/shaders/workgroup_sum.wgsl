// Sum over the GROUP threads of a workgroup, in a fixed order.

var<workgroup> sum_values: array<f32, GROUP>;

// Only thread 0 gets the sum. Call in uniform control flow.
fn workgroup_sum(value: f32, thread: u32) -> f32 {
    sum_values[thread] = value;
    for (var half = GROUP / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if thread < half {
            sum_values[thread] += sum_values[thread + half];
        }
    }
    let sum = sum_values[thread];
    workgroupBarrier();
    return sum;
}
