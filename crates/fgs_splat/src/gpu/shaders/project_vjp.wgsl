// The derivative of `project.wgsl`; counterpart of `cpu/project_vjp.rs`. Adds up each splat's sums
// in slot order and propagates them to the gaussian's parameters.

@group(0) @binding(1) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(2) var<storage, read> gaussians: array<Gaussian>;
@group(0) @binding(3) var<storage, read> gaussian_of: array<u32>;
@group(0) @binding(4) var<storage, read> touches: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read> sums: array<array<vec4<f32>, 4>>;
// Per splat.
@group(0) @binding(6) var<storage, read_write> gradients: array<Gradient>;
// [set][word]: a bit for each gaussian that contributed to a pixel when the view was last rendered.
@group(0) @binding(7) var<storage, read_write> visible_sets: array<atomic<u32>>;

// Splats with more slots are summed by the whole workgroup: for one that fills the image a single
// thread would take milliseconds, with the rest of the device idle.
const MANY_SLOTS: u32 = 512u;
// Slots per batch.
const BATCH: u32 = 2u * GROUP / 4u;

var<workgroup> batch: array<array<vec4<f32>, 4>, BATCH>;
// First slot and number of slots of each of the workgroup's large splats, and their number.
var<workgroup> large: array<vec2<u32>, GROUP>;
var<workgroup> large_count: u32;
var<workgroup> batch_sums: array<vec4<f32>, 4>;

// A row of a slot's sums, or zero if no pixel took the splat there: then the row is stale. Adding
// zero to a sum that started at zero changes no bit.
fn addend(row: vec4<f32>, last_row: vec4<f32>) -> vec4<f32> {
    return select(vec4(0.0), row, last_row.z > 0.0);
}

// The total over a splat's slots, added in slot order.
fn few(first: u32, number: u32) -> array<vec4<f32>, 4> {
    var total = array(vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0));
    for (var slot = first; slot < first + number; slot += 1u) {
        let last = sums[slot][3];
        total[0] += addend(sums[slot][0], last);
        total[1] += addend(sums[slot][1], last);
        total[2] += addend(sums[slot][2], last);
        total[3] += addend(last, last);
    }
    return total;
}

// The same, in the same order, by the whole workgroup: all threads load, four add. Call in uniform
// control flow.
fn many(first: u32, number: u32, thread: u32) -> array<vec4<f32>, 4> {
    let row = thread % 4u;
    var total = vec4(0.0);
    for (var start = 0u; start < number; start += BATCH) {
        let len = min(BATCH, number - start);
        for (var at = thread / 4u; at < len; at += GROUP / 4u) {
            batch[at][row] = sums[first + start + at][row];
        }
        workgroupBarrier();
        if thread < 4u {
            for (var at = 0u; at < len; at += 1u) {
                total += addend(batch[at][thread], batch[at][3]);
            }
        }
        workgroupBarrier();
    }
    if thread < 4u {
        batch_sums[thread] = total;
    }
    workgroupBarrier();
    let all = batch_sums;
    workgroupBarrier();
    return all;
}

@compute @workgroup_size(GROUP)
fn project_vjp(@builtin(global_invocation_id) id: vec3<u32>, lane: Lane) {
    let index = id.x;
    // If a rendered value is out of range the gradients are meaningless, but visibility is valid.
    let is_void = atomicLoad(&counts[OVERFLOWED]) != 0u;
    let is_splat = index < atomicLoad(&counts[VISIBLE]) && !is_void;
    var slots = vec2(0u);
    if is_splat {
        slots = touches[index];
    }
    let is_large = slots.y > MANY_SLOTS;
    let large_places = workgroup_scan(u32(is_large), lane);
    if is_large {
        large[large_places.x] = slots;
    }
    if lane.thread == 0u {
        large_count = large_places.y;
    }
    var total = array(vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0));
    if !is_large {
        total = few(slots.x, slots.y);
    }
    // Has a barrier before and after the load; they also cover `large`.
    let count = workgroupUniformLoad(&large_count);
    for (var i = 0u; i < count; i += 1u) {
        let of_large = workgroupUniformLoad(&large[i]);
        let sum = many(of_large.x, of_large.y, lane.thread);
        if is_large && i == large_places.x {
            total = sum;
        }
    }
    let touched = u32(is_splat && total[3].z > 0.0);
    if touched == 1u {
        let gaussian = gaussian_of[index];
        gradients[index] = gradient_of(
            projection(gaussians[gaussian]), total[0], total[1], total[2], total[3],
        );
        if view.set_start != NONE {
            let word = view.set_start + gaussian / 32u;
            atomicOr(&visible_sets[word], 1u << (gaussian % 32u));
        }
    } else if is_splat {
        gradients[index].touched = 0u;
    }
    let all = workgroup_scan(touched, lane).y;
    if lane.thread == 0u {
        atomicAdd(&counts[TOUCHED], all);
    }
}

fn to_world(v: vec3<f32>) -> vec3<f32> {
    return view.row_x * v.x + view.row_y * v.y + view.row_z * v.z;
}

// The sums are: colour, g; gp, gq, gpp, gpq; gqq, center, ht, htt; htt dx, htt dy, taken.
fn gradient_of(
    p: Projection,
    sums_0: vec4<f32>,
    sums_1: vec4<f32>,
    sums_2: vec4<f32>,
    sums_3: vec4<f32>,
) -> Gradient {
    let z = p.center.z;
    // First and second moments of g in whitened coordinates, without WHITEN_SCALE.
    let unscale = 1.0 / WHITEN_SCALE;
    let gp = sums_1.x * unscale;
    let gq = sums_1.y * unscale;
    let gpp = sums_1.z * unscale * unscale;
    let gpq = sums_1.w * unscale * unscale;
    let gqq = sums_2.x * unscale * unscale;

    let l = whitening(p);
    let d_mean2d = vec2(l.x * gp, l.y * gp + l.z * gq);
    let cov_xx = l.x * l.x * gpp;
    let cov_xy = l.x * (l.y * gpp + l.z * gpq);
    let cov_yy = l.y * (l.y * gpp + l.z * gpq) + l.z * (l.y * gpq + l.z * gqq);
    let d_half_x = cov_xx * p.half_x + cov_xy * p.half_y;
    let d_half_y = cov_xy * p.half_x + cov_yy * p.half_y;
    var gradient: Gradient;
    gradient.touched = 1u;
    gradient.log_scales = d_half_x * p.half_x + d_half_y * p.half_y;

    // half[k] = j (row[k] - t row_z[k]) scales[k], j = focal / z, t clamped x/z, y/z.
    let j = view.focal / z;
    let t = p.clamped_tangent;
    let d_unscaled_x = d_half_x * p.scales;
    let d_unscaled_y = d_half_y * p.scales;
    var d_row_x = j.x * d_unscaled_x;
    var d_row_y = j.y * d_unscaled_y;
    var d_row_z = -j.x * t.x * d_unscaled_x - j.y * t.y * d_unscaled_y;
    // Through j = focal / z.
    var d_z = -(dot(d_half_x, p.half_x) + dot(d_half_y, p.half_y)) / z;
    let d_free = -j * vec2(dot(d_unscaled_x, p.row_z), dot(d_unscaled_y, p.row_z));
    let d_tangent = select(vec2(0.0), d_free, p.tangent == t) + view.focal * d_mean2d;
    d_z += sums_2.y;
    var d_center = vec3(
        d_tangent / z,
        d_z - dot(d_tangent, p.center.xy) / (z * z),
    );

    // depth = (n . center) / (n . ray).
    let unsigned_normal = disk_normal(p);
    let unsigned_offset = dot(unsigned_normal, p.center);
    let side = select(1.0, -1.0, unsigned_offset < 0.0);
    let offset = side * unsigned_offset;
    let d_offset = sums_2.z;
    let d_n_ray = -offset * sums_2.w;
    let slope = -offset * sums_3.xy / view.focal;
    let d_normal = d_offset * p.center + d_n_ray * vec3(p.tangent, 1.0) + vec3(slope, 0.0);
    d_center += d_offset * side * unsigned_normal;
    d_row_x.z += side * d_normal.x;
    d_row_y.z += side * d_normal.y;
    d_row_z.z += side * d_normal.z;

    gradient.mean = to_world(d_center);
    gradient.quat = quat_vjp(
        p.unit_quat,
        p.quat_norm,
        to_world(vec3(d_row_x.x, d_row_y.x, d_row_z.x)),
        to_world(vec3(d_row_x.y, d_row_y.y, d_row_z.y)),
        to_world(vec3(d_row_x.z, d_row_y.z, d_row_z.z)),
    );
    // alpha = opacity e^exponent: d_opacity opacity = g, and opacity' = opacity (1 - opacity).
    gradient.opacity_logit = sums_0.w * (1.0 - p.opacity);
    gradient.sh = select(vec3(0.0), SH0_FACTOR * sums_0.xyz, p.raw_color > vec3(0.0));
    return gradient;
}

// From the derivatives with respect to the columns of a rotation matrix to those with respect to
// the stored quaternion (wxyz, of that norm).
fn quat_vjp(
    unit: vec4<f32>,
    norm: f32,
    d_x: vec3<f32>,
    d_y: vec3<f32>,
    d_z: vec3<f32>,
) -> vec4<f32> {
    let w = unit.x;
    let x = unit.y;
    let y = unit.z;
    let z = unit.w;
    let d_unit = 2.0 * vec4(
        x * (d_y.z - d_z.y) + y * (d_z.x - d_x.z) + z * (d_x.y - d_y.x),
        y * (d_y.x + d_x.y) + z * (d_z.x + d_x.z) + w * (d_y.z - d_z.y) - 2.0 * x * (d_y.y + d_z.z),
        x * (d_y.x + d_x.y) + z * (d_z.y + d_y.z) + w * (d_z.x - d_x.z) - 2.0 * y * (d_x.x + d_z.z),
        x * (d_z.x + d_x.z) + y * (d_z.y + d_y.z) + w * (d_x.y - d_y.x) - 2.0 * z * (d_x.x + d_y.y),
    );
    return (d_unit - unit * dot(d_unit, unit)) / norm;
}
