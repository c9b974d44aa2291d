// The sum over the GROUP threads of a workgroup, in a fixed order.

var<workgroup> sum_values: array<f32, GROUP>;

// To be called by all threads; only the first gets the sum.
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
