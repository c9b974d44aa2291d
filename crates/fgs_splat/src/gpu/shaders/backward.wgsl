// The derivative of `forward.wgsl`; counterpart of `cpu/backward.rs`. Walks a tile's list back to
// front in batches of two phases. First each thread takes a pixel and computes each entry's weight
// there and d loss / d exponent. Then each thread takes an entry and sums over a quarter of the
// pixels. Only the final sum of four quarters crosses threads, in a fixed order.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read> slot_splats: array<u32>;
@group(0) @binding(4) var<storage, read> splats: array<Splat>;
@group(0) @binding(5) var<storage, read> pixel_states: array<PixelState>;
// The loss's derivatives with respect to colour and depth, and to alpha.
@group(0) @binding(6) var<storage, read> cotangents: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> d_alpha: array<f32>;
// Per slot, the sums over its tile's pixels; see `add_up`.
@group(0) @binding(8) var<storage, read_write> sums: array<array<vec4<f32>, 4>>;

// Entries per batch: one for each thread that works on the same quarter.
const BATCH: u32 = 16u;
const QUARTERS: u32 = TILE_PIXELS / BATCH;
const QUARTER_PIXELS: u32 = TILE_PIXELS / QUARTERS;
// Padded by one against bank conflicts between threads of different entries.
const STRIDE: u32 = TILE_PIXELS + 1u;

var<workgroup> batch: array<Splat, BATCH>;
var<workgroup> batch_slots: array<u32, BATCH>;
var<workgroup> weights: array<f32, BATCH * STRIDE>;
var<workgroup> d_exponents: array<f32, BATCH * STRIDE>;
var<workgroup> d_rendered: array<vec4<f32>, TILE_PIXELS>;
var<workgroup> min_n_rays: array<f32, TILE_PIXELS>;
var<workgroup> partial_sums: array<array<vec4<f32>, TILE_PIXELS>, 4>;
var<workgroup> max_used: atomic<u32>;

@compute @workgroup_size(TILE_PIXELS)
fn backward(
    @builtin(workgroup_id) tile: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let column = tile.x * u32(TILE) + thread % u32(TILE);
    let row = tile.y * u32(TILE) + thread / u32(TILE);
    let pixel = vec2(f32(column), f32(row));
    let min_n_ray = min_n_ray_at(pixel);
    let range = ranges[tile.y * view.tile_columns + tile.x];

    var state = PixelState(1.0, 0u);
    var d = vec4(0.0);
    var d_own_alpha = 0.0;
    if column < view.width && row < view.height {
        let at = row * view.width + column;
        state = pixel_states[at];
        d = cotangents[at];
        d_own_alpha = d_alpha[at];
    }
    d_rendered[thread] = d;
    min_n_rays[thread] = min_n_ray;
    atomicMax(&max_used, state.used);
    // Has a barrier before and after the load; they also cover the arrays.
    let used = workgroupUniformLoad(&max_used);
    // Entries that no pixel reached: not taken.
    for (var i = range.x + used + thread; i < range.y; i += TILE_PIXELS) {
        sums[slots[i]][3].z = 0.0;
    }

    let entry = thread % BATCH;
    let quarter = thread / BATCH;
    var transmittance = state.transmittance;
    // Sum over the entries visited so far of weight times d loss / d weight.
    var behind = 0.0;
    for (var end = used; end > 0u;) {
        let len = min((end - 1u) % BATCH + 1u, end);
        let start = end - len;
        if thread < len {
            let slot = slots[range.x + start + thread];
            batch_slots[thread] = slot;
            batch[thread] = splats[slot_splats[slot]];
        }
        workgroupBarrier();

        for (var i = len; i > 0u;) {
            i -= 1u;
            let splat = batch[i];
            let sample = sample_of(splat, pixel - splat.mean2d, min_n_ray);
            var weight = 0.0;
            var d_exponent = 0.0;
            if sample.alpha >= ALPHA_MIN && start + i < state.used {
                let alpha = min(sample.alpha, ALPHA_MAX);
                let inverse_rest = 1.0 / (1.0 - alpha);
                let before = transmittance * inverse_rest;
                weight = before * alpha;
                let plane_depth = splat.plane_offset / sample.n_ray;
                let depth = select(splat.center_depth, plane_depth, sample.on_plane);
                let value = dot(d.xyz, splat.color) + fma(d.w, depth, d_own_alpha);
                // d weight / d alpha = before; every weight behind has the factor 1 - alpha.
                let d_sample_alpha = before * value - behind * inverse_rest;
                transmittance = before;
                behind = fma(weight, value, behind);
                d_exponent = select(0.0, d_sample_alpha * alpha, sample.alpha <= ALPHA_MAX);
            }
            weights[i * STRIDE + thread] = weight;
            d_exponents[i * STRIDE + thread] = d_exponent;
        }
        workgroupBarrier();

        if entry < len {
            add_up(tile.xy, entry, quarter, thread);
        }
        workgroupBarrier();

        // A row of four sums per thread; neighbouring threads write neighbouring rows.
        let summed = thread / 4u;
        if summed < len {
            let part = thread % 4u;
            var total = vec4(0.0);
            for (var from_thread = summed; from_thread < TILE_PIXELS; from_thread += BATCH) {
                total += partial_sums[part][from_thread];
            }
            sums[batch_slots[summed]][part] = total;
        }
        end = start;
        workgroupBarrier();
    }
}

// An entry's sums over a quarter of the tile's pixels.
fn add_up(tile: vec2<u32>, entry: u32, quarter: u32, thread: u32) {
    let splat = batch[entry];
    let origin = vec2<f32>(tile * u32(TILE)) - splat.mean2d;
    var color = vec3(0.0);
    var g = 0.0;
    var by_pq = vec2(0.0);
    var by_squares = vec3(0.0);
    var center = 0.0;
    var ht = 0.0;
    var htt = 0.0;
    var htt_d = vec2(0.0);
    var taken = 0.0;
    for (var i = 0u; i < QUARTER_PIXELS; i += 1u) {
        let pixel = quarter * QUARTER_PIXELS + i;
        let weight = weights[entry * STRIDE + pixel];
        if weight == 0.0 {
            continue;
        }
        taken = 1.0;
        let offset = vec2(pixel % u32(TILE), pixel / u32(TILE));
        let d = origin + vec2<f32>(offset);
        let sample = sample_of(splat, d, min_n_rays[pixel]);
        let d_here = d_rendered[pixel];
        color += weight * d_here.xyz;
        let d_exponent = d_exponents[entry * STRIDE + pixel];
        let gp = d_exponent * sample.p;
        let gq = d_exponent * sample.q;
        g += d_exponent;
        by_pq += vec2(gp, gq);
        by_squares += vec3(gp * sample.p, gp * sample.q, gq * sample.q);
        let h = weight * d_here.w;
        if sample.on_plane {
            let t = 1.0 / sample.n_ray;
            ht += h * t;
            htt += h * t * t;
            htt_d += h * t * t * d;
        } else {
            center += h;
        }
    }
    // In the order that `gradient_of` in `project_vjp.wgsl` expects.
    partial_sums[0][thread] = vec4(color, g);
    partial_sums[1][thread] = vec4(by_pq, by_squares.xy);
    partial_sums[2][thread] = vec4(by_squares.z, center, ht, htt);
    partial_sums[3][thread] = vec4(htt_d, taken, 0.0);
}
