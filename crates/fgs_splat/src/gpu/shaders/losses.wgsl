// The loss's derivatives with respect to the rendered colour, depth and alpha; counterpart of
// `losses/color.rs` and `losses/depth.rs`.

@group(0) @binding(6) var<storage, read> pixel_states: array<PixelState>;
@group(0) @binding(7) var<storage, read_write> cotangents: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> d_alpha: array<f32>;
@group(0) @binding(9) var<storage, read_write> counts: array<atomic<u32>>;

var<workgroup> images: array<array<f32, PADDED * PADDED>, 3>;
// Blurred along the rows.
var<workgroup> rows: array<vec3<f32>, PADDED * SIDE>;

fn is_out_of_range(v: vec4<f32>) -> bool {
    // Compares bits: shader compilers may assume that there is no NaN.
    return any((bitcast<vec4<u32>>(v) & vec4(0x7fffffffu)) > vec4(bitcast<u32>(MAX_RENDERED)));
}

fn moments_at(i: u32) -> vec3<f32> {
    return vec3(images[0][i], images[1][i], images[2][i]);
}

@compute @workgroup_size(SIDE, SIDE)
fn losses(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) tile: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let inside = id.x < view.width && id.y < view.height;
    let at = id.y * view.width + id.x;
    var target_pixel = vec2(0u);
    var shown = vec4(0.0);
    if inside {
        target_pixel = measured[at];
        shown = rendered[at];
        if is_out_of_range(shown) {
            atomicStore(&counts[OUT_OF_RANGE], 1u);
        }
    }
    let valid = inside && is_valid(target_pixel);
    let target_color = unpack4x8unorm(target_pixel.x);
    var d_color = vec3(0.0);
    var color_error = 0.0;
    for (var channel = 0u; channel < 3u; channel += 1u) {
        for (var i = thread; i < PADDED * PADDED; i += GROUP) {
            let pixel = tile.xy * SIDE + vec2(i % PADDED, i / PADDED) - vec2(RADIUS);
            let is_pixel = pixel.x < view.width && pixel.y < view.height;
            for (var map = 0u; map < 3u; map += 1u) {
                var value = 0.0;
                if is_pixel {
                    value = moments[offset_of(channel, map) + pixel.y * view.width + pixel.x];
                }
                images[map][i] = value;
            }
        }
        workgroupBarrier();
        for (var i = thread; i < PADDED * SIDE; i += GROUP) {
            let first = i / SIDE * PADDED + i % SIDE;
            var sum = vec3(0.0);
            #each_tap sum += {weight} * moments_at(first + {tap});
            rows[i] = sum;
        }
        workgroupBarrier();
        var blurred = vec3(0.0);
        #each_tap blurred += {weight} * rows[thread + {tap} * SIDE];
        if valid {
            let difference = shown[channel] - target_color[channel];
            let sum = shown[channel] + target_color[channel];
            let by_ssim = blurred.x + 2.0 * (difference * blurred.y + sum * blurred.z);
            d_color[channel] = loss.ssim * by_ssim + loss.l1 * sign(difference);
            color_error += abs(difference);
        }
    }

    var by_depth = 0.0;
    var by_alpha = 0.0;
    var depth_error = 0.0;
    if inside && has_depth(target_pixel.y) {
        let alpha = 1.0 - pixel_states[at].transmittance;
        let divisor = select(1.0, max(alpha, MIN_ALPHA), loss.normalize_depth == 1u);
        let depth = shown.w / divisor;
        let error = depth - bitcast<f32>(target_pixel.y);
        depth_error = abs(error);
        by_depth = loss.depth * sign(error) / divisor;
        if loss.normalize_depth == 1u && alpha > MIN_ALPHA {
            by_alpha = -depth * by_depth;
        }
    }
    if inside {
        cotangents[at] = vec4(d_color, by_depth);
        d_alpha[at] = by_alpha;
    }
    let color_sum = workgroup_sum(color_error, thread);
    let depth_sum = workgroup_sum(depth_error, thread);
    if thread == 0u {
        let workgroup = tile.y * loss.columns + tile.x;
        let workgroups = loss.columns * loss.rows;
        loss_sums[workgroups + workgroup] = color_sum;
        loss_sums[2u * workgroups + workgroup] = depth_sum;
    }
}
