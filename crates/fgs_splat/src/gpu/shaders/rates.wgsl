// Kernels that measure a device's peak rates; see `rates.rs`.

@group(0) @binding(0) var<storage, read> source: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> copied: array<vec4<f32>>;

// Several rows per thread keep enough loads in flight.
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

// Eight independent chains of four multiply-adds per round hide their latency.
@compute @workgroup_size(GROUP)
fn multiply_add(@builtin(global_invocation_id) id: vec3<u32>) {
    // `source` holds zeros, unknown to the compiler.
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

// Almost no work, but each dispatch depends on the previous one.
@compute @workgroup_size(1)
fn touch() {
    copied[0] += vec4(1.0);
}
