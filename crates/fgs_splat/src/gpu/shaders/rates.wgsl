// What the device can do at most: see `rates.rs`. The kernels do nothing else.

@group(0) @binding(0) var<storage, read> source: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> copied: array<vec4<f32>>;

// Four numbers of four a thread, so that enough of them are on their way.
@compute @workgroup_size(GROUP)
fn copy_rows(
    @builtin(workgroup_id) block: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let first = block.x * COPIED_ROWS * GROUP + thread;
    for (var row = 0u; row < COPIED_ROWS; row += 1u) {
        copied[first + row * GROUP] = source[first + row * GROUP];
    }
}

// Eight chains of four multiply-adds each hide the latency of one.
@compute @workgroup_size(GROUP)
fn multiply_add(@builtin(global_invocation_id) id: vec3<u32>) {
    // The source is zero, which the compiler cannot know.
    let factor = vec4(0.999) + source[0];
    let term = vec4(1e-3) + source[1];
    var a = vec4(f32(id.x));
    var b = a + 1.0;
    var c = a + 2.0;
    var d = a + 3.0;
    var e = a + 4.0;
    var f = a + 5.0;
    var g = a + 6.0;
    var h = a + 7.0;
    for (var round = 0u; round < MULTIPLY_ADD_ROUNDS; round += 1u) {
        a = fma(a, factor, term);
        b = fma(b, factor, term);
        c = fma(c, factor, term);
        d = fma(d, factor, term);
        e = fma(e, factor, term);
        f = fma(f, factor, term);
        g = fma(g, factor, term);
        h = fma(h, factor, term);
    }
    copied[id.x] = (a + b + c + d) + (e + f + g + h);
}

// Next to nothing, but each dispatch has to wait for the one before.
@compute @workgroup_size(1)
fn touch() {
    copied[0] += vec4(1.0);
}
