// Blends each tile's list front to back; counterpart of `cpu/forward.rs`. One workgroup per tile,
// one thread per pixel.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read> slot_splats: array<u32>;
@group(0) @binding(4) var<storage, read> splats: array<Splat>;
// RGB, and the sum of weight times depth, metres.
@group(0) @binding(5) var<storage, read_write> rendered: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> pixel_states: array<PixelState>;

var<workgroup> batch: array<Splat, TILE_PIXELS>;
// 1 if any pixel is not saturated yet, by the parity of the batch.
var<workgroup> open_pixels: array<atomic<u32>, 2>;

@compute @workgroup_size(TILE_PIXELS)
fn forward(
    @builtin(workgroup_id) tile: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let column = tile.x * u32(TILE) + thread % u32(TILE);
    let row = tile.y * u32(TILE) + thread / u32(TILE);
    let inside = column < view.width && row < view.height;
    let pixel = vec2(f32(column), f32(row));
    let min_n_ray = min_n_ray_at(pixel);
    let range = ranges[tile.y * view.tile_columns + tile.x];

    var color = vec3(0.0);
    var depth = 0.0;
    var transmittance = 1.0;
    var used = 0u;
    var open = inside;
    for (var start = range.x; start < range.y; start += TILE_PIXELS) {
        let parity = ((start - range.x) / TILE_PIXELS) % 2u;
        if start + thread < range.y {
            batch[thread] = splats[slot_splats[slots[start + thread]]];
        }
        if open {
            atomicStore(&open_pixels[parity], 1u);
        }
        // Has a barrier before and after the load; they also cover `batch`.
        if workgroupUniformLoad(&open_pixels[parity]) == 0u {
            break;
        }
        atomicStore(&open_pixels[1u - parity], 0u);
        let len = min(range.y - start, TILE_PIXELS);
        for (var i = 0u; i < len && open; i += 1u) {
            let splat = batch[i];
            let sample = sample_of(splat, pixel - splat.mean2d, min_n_ray);
            if sample.alpha < ALPHA_MIN {
                continue;
            }
            let alpha = min(sample.alpha, ALPHA_MAX);
            let weight = transmittance * alpha;
            color = fma(vec3(weight), splat.color, color);
            let plane_depth = splat.plane_offset / sample.n_ray;
            depth = fma(weight, select(splat.center_depth, plane_depth, sample.on_plane), depth);
            transmittance *= 1.0 - alpha;
            used = start - range.x + i + 1u;
            open = transmittance >= TRANSMITTANCE_MIN;
        }
        workgroupBarrier();
    }
    if inside {
        let at = row * view.width + column;
        rendered[at] = vec4(color, depth);
        pixel_states[at] = PixelState(transmittance, used);
    }
}
