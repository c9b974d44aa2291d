// SSIM and its derivatives with respect to the windowed moments; counterpart of `losses/ssim.rs`,
// which has the formula. d = render - target, s = render + target. Both are zero outside the image,
// and d at pixels that are not compared.

var<workgroup> images: array<vec2<f32>, PADDED * PADDED>;
// Blurred along the rows: d, s, d^2, s^2.
var<workgroup> rows: array<vec4<f32>, PADDED * SIDE>;

@compute @workgroup_size(SIDE, SIDE)
fn ssim(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) tile: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let inside = id.x < view.width && id.y < view.height;
    let at = id.y * view.width + id.x;
    var valid = false;
    if inside {
        valid = is_valid(measured[at]);
    }
    var dissimilarity = 0.0;
    for (var channel = 0u; channel < 3u; channel += 1u) {
        for (var i = thread; i < PADDED * PADDED; i += GROUP) {
            images[i] = load(tile.xy * SIDE + vec2(i % PADDED, i / PADDED), channel);
        }
        workgroupBarrier();
        for (var i = thread; i < PADDED * SIDE; i += GROUP) {
            let first = i / SIDE * PADDED + i % SIDE;
            var sum = vec4(0.0);
            #each_tap sum += {weight} * with_squares(images[first + {tap}]);
            rows[i] = sum;
        }
        workgroupBarrier();
        var m = vec4(0.0);
        #each_tap m += {weight} * rows[thread + {tap} * SIDE];
        // Rounding may make a variance negative.
        let md = m.x;
        let ms = m.y;
        let var_d = max(m.z - md * md, 0.0);
        let var_s = max(m.w - ms * ms, 0.0);
        let inv_b1 = 1.0 / (0.5 * (md * md + ms * ms) + C1);
        let inv_b2 = 1.0 / (0.5 * (var_d + var_s) + C2);
        let luminance_loss = md * md * inv_b1;
        let structure_loss = var_d * inv_b2;
        let luminance = 1.0 - luminance_loss;
        let structure = 1.0 - structure_loss;
        let by_var_s = -0.5 * luminance * structure_loss * inv_b2;
        let by_var_d = luminance * inv_b2 + by_var_s;
        let by_b1 = -structure * luminance_loss * inv_b1;
        let by_md = 2.0 * structure * md * inv_b1 + (by_b1 - 2.0 * by_var_d) * md;
        let by_ms = (by_b1 - 2.0 * by_var_s) * ms;
        if valid {
            dissimilarity += luminance_loss + structure_loss - luminance_loss * structure_loss;
        }
        if inside {
            moments[offset_of(channel, 0u) + at] = select(0.0, by_md + by_ms, valid);
            moments[offset_of(channel, 1u) + at] = select(0.0, by_var_d, valid);
            moments[offset_of(channel, 2u) + at] = select(0.0, by_var_s, valid);
        }
    }
    let sum = workgroup_sum(dissimilarity, thread);
    if thread == 0u {
        loss_sums[tile.y * loss.columns + tile.x] = sum;
    }
}

fn with_squares(image: vec2<f32>) -> vec4<f32> {
    return vec4(image, image * image);
}

// d and s at `place`, whose origin lies RADIUS pixels left of and above the first pixel.
fn load(place: vec2<u32>, channel: u32) -> vec2<f32> {
    // Left of and above the image this wraps to large numbers.
    let pixel = place - vec2(RADIUS);
    if pixel.x >= view.width || pixel.y >= view.height {
        return vec2(0.0);
    }
    let at = pixel.y * view.width + pixel.x;
    let target_color = unpack4x8unorm(measured[at].x)[channel];
    let difference = select(0.0, rendered[at][channel] - target_color, is_valid(measured[at]));
    return vec2(difference, difference + 2.0 * target_color);
}
