// Bit mask of the pixels where the accumulated alpha is below a limit. One thread per 32 pixels.

@group(0) @binding(0) var<uniform> see_through_: SeeThrough;
@group(0) @binding(1) var<storage, read> pixel_states: array<PixelState>;
@group(0) @binding(2) var<storage, read_write> see_through_words: array<u32>;

@compute @workgroup_size(GROUP)
fn see_through(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = 32u * id.x;
    if first >= see_through_.pixels {
        return;
    }
    var word = 0u;
    for (var bit = 0u; bit < min(32u, see_through_.pixels - first); bit += 1u) {
        let alpha = 1.0 - pixel_states[first + bit].transmittance;
        word |= u32(alpha < see_through_.min_alpha) << bit;
    }
    see_through_words[id.x] = word;
}
