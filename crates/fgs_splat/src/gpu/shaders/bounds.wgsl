// Which tiles a gaussian's support touches; twin of `cpu/bounds.rs` with tiles in place of blocks.

struct Support {
    // Squared radius in whitened coordinates.
    radius2: f32,
    // The rightmost point of the ellipse has this dy, the leftmost its negative.
    rightmost_dy: f32,
    // Pixels; the first is greater than the last where there is none.
    first_row: i32,
    last_row: i32,
}

// First and last integer in [low, high] and in [0, size).
fn pixels(low: f32, high: f32, size: u32) -> vec2<i32> {
    let end = f32(size);
    let first = i32(ceil(clamp(low, -1.0, end)));
    let last = i32(floor(clamp(high, -1.0, end)));
    return vec2(max(first, 0), min(last, i32(size) - 1));
}

fn support_of(splat: Splat) -> Support {
    // Rounding may put a pixel's exponent a little off: the support grows by more than that.
    let exact = log2(splat.opacity / ALPHA_MIN);
    var support: Support;
    support.radius2 = max(exact * 1.001 + 1e-3, 0.0);
    let radius = sqrt(support.radius2);
    let wxy = splat.whiten_xy;
    let wyy = splat.whiten_yy;
    let reach = radius / wyy + SLACK_PX;
    let rows = pixels(splat.mean2d.y - reach, splat.mean2d.y + reach, view.height);
    support.first_row = rows.x;
    support.last_row = rows.y;
    support.rightmost_dy = -wxy * radius / (wyy * sqrt(wyy * wyy + wxy * wxy));
    return support;
}

fn edge(splat: Splat, support: Support, dy: f32, side: f32) -> f32 {
    let q = splat.whiten_yy * dy;
    let across = side * sqrt(max(support.radius2 - q * q, 0.0));
    return (across - splat.whiten_xy * dy) / splat.whiten_xx;
}

// First and after the last tile that is touched in a row of tiles; equal where none is.
fn touched_columns(splat: Splat, support: Support, tile_row: i32) -> vec2<u32> {
    let top = max(tile_row * TILE, support.first_row);
    let bottom = min(tile_row * TILE + TILE - 1, support.last_row);
    let dy_top = f32(top) - splat.mean2d.y - SLACK_PX;
    let dy_bottom = f32(bottom) - splat.mean2d.y + SLACK_PX;
    let right_dy = min(max(support.rightmost_dy, dy_top), dy_bottom);
    let left_dy = min(max(-support.rightmost_dy, dy_top), dy_bottom);
    let right = splat.mean2d.x + edge(splat, support, right_dy, 1.0) + SLACK_PX;
    let left = splat.mean2d.x + edge(splat, support, left_dy, -1.0) - SLACK_PX;
    let columns = pixels(left, right, view.width);
    if top > bottom || columns.x > columns.y {
        return vec2(0u);
    }
    return vec2(u32(columns.x / TILE), u32(columns.y / TILE) + 1u);
}
