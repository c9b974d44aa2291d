// Projects a gaussian to the screen; counterpart of `cpu/project.rs`, which explains the fields.

@group(0) @binding(0) var<uniform> view: View;

struct Projection {
    drawn: bool,
    center: vec3<f32>,
    tangent: vec2<f32>,
    clamped_tangent: vec2<f32>,
    quat_norm: f32,
    unit_quat: vec4<f32>,
    scales: vec3<f32>,
    // Rows of the rotation camera_from_gaussian.
    row_x: vec3<f32>,
    row_y: vec3<f32>,
    row_z: vec3<f32>,
    half_x: vec3<f32>,
    half_y: vec3<f32>,
    // xx, xy, yy; px^2, low-pass included.
    cov2d: vec3<f32>,
    det: f32,
    opacity: f32,
    raw_color: vec3<f32>,
}

// A point of the world in camera axes, metres.
fn camera_axes(point: vec3<f32>) -> vec3<f32> {
    let relative = point - view.position;
    return vec3(dot(view.row_x, relative), dot(view.row_y, relative), dot(view.row_z, relative));
}

// Whether |x| <= MAX_MAGNITUDE. Compares bits: shader compilers may assume that there is no NaN.
fn is_sane(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7fffffffu) <= bitcast<u32>(MAX_MAGNITUDE);
}

fn are_sane(v: vec3<f32>) -> bool {
    return is_sane(v.x) && is_sane(v.y) && is_sane(v.z);
}

// world_from_gaussian of a unit quaternion (wxyz).
fn rotation_matrix(q: vec4<f32>) -> mat3x3<f32> {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    return mat3x3(
        vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
}

fn projection(gaussian: Gaussian) -> Projection {
    var p: Projection;
    p.center = camera_axes(gaussian.mean);
    let z = p.center.z;
    let quat_norm2 = dot(gaussian.quat, gaussian.quat);
    p.quat_norm = sqrt(quat_norm2);
    p.unit_quat = gaussian.quat / p.quat_norm;
    p.scales = exp(clamp(gaussian.log_scales, vec3(-80.0), vec3(80.0)));
    p.opacity = 1.0 / (1.0 + exp(clamp(-gaussian.opacity_logit, -80.0, 80.0)));
    let axes = rotation_matrix(p.unit_quat);
    p.row_x = view.row_x * axes;
    p.row_y = view.row_y * axes;
    p.row_z = view.row_z * axes;
    p.tangent = p.center.xy / z;
    p.clamped_tangent = clamp(p.tangent, view.tangent_min, view.tangent_max);
    let focal = view.focal / z;
    p.half_x = focal.x * (p.row_x - p.clamped_tangent.x * p.row_z) * p.scales;
    p.half_y = focal.y * (p.row_y - p.clamped_tangent.y * p.row_z) * p.scales;
    let xx = dot(p.half_x, p.half_x);
    let xy = dot(p.half_x, p.half_y);
    let yy = dot(p.half_y, p.half_y);
    p.cov2d = vec3(xx + LOW_PASS_PX2, xy, yy + LOW_PASS_PX2);
    let across = cross(p.half_x, p.half_y);
    p.det = dot(across, across) + LOW_PASS_PX2 * (xx + yy + LOW_PASS_PX2);
    p.raw_color = 0.5 + SH0_FACTOR * gaussian.sh;
    p.drawn = are_sane(gaussian.mean) && are_sane(gaussian.quat.xyz) && is_sane(gaussian.quat.w)
        && are_sane(gaussian.log_scales) && are_sane(p.scales) && are_sane(gaussian.sh)
        && is_sane(gaussian.opacity_logit)
        && z >= NEAR_M && quat_norm2 >= MIN_QUAT_NORM2 && p.opacity >= ALPHA_MIN
        && xx <= MAX_VARIANCE_PX2 && yy <= MAX_VARIANCE_PX2;
    return p;
}

// L^T of the inverse covariance's Cholesky factorisation L L^T: rows (x, y) and (0, z).
fn whitening(p: Projection) -> vec3<f32> {
    let xx = sqrt(p.cov2d.z / p.det);
    return vec3(xx, -xx * p.cov2d.y / p.cov2d.z, 1.0 / sqrt(p.cov2d.z));
}

// The disk's normal in camera axes: the gaussian's third axis.
fn disk_normal(p: Projection) -> vec3<f32> {
    return vec3(p.row_x.z, p.row_y.z, p.row_z.z);
}

fn splat_of(p: Projection) -> Splat {
    let whiten = WHITEN_SCALE * whitening(p);
    let unsigned_normal = disk_normal(p);
    let unsigned_offset = dot(unsigned_normal, p.center);
    let side = select(1.0, -1.0, unsigned_offset < 0.0);
    let normal = side * unsigned_normal;
    let offset = side * unsigned_offset;
    var splat: Splat;
    splat.mean2d = view.focal * p.tangent + view.center;
    splat.whiten_xx = whiten.x;
    splat.whiten_xy = whiten.y;
    splat.whiten_yy = whiten.z;
    splat.opacity = p.opacity;
    splat.center_depth = p.center.z;
    splat.plane_offset = offset;
    splat.color = max(p.raw_color, vec3(0.0));
    splat.plane = select(
        vec3(-1.0, 0.0, 0.0),
        vec3(offset / p.center.z, normal.xy / view.focal),
        offset > 0.0,
    );
    return splat;
}
