// Which tiles a splat's support touches; counterpart of `cpu/bounds.rs`, with tiles for its blocks.

struct Support {
    // Squared radius in whitened coordinates.
    radius2: f32,
    // dy of the ellipse's rightmost point; the leftmost has its negative.
    rightmost_dy: f32,
    // Rows of pixels, both inclusive; first > last if there is none.
    first_row: i32,
    last_row: i32,
}

// First and last integer within both [low, high] and [0, size); first > last if there is none.
fn pixels(low: f32, high: f32, size: u32) -> vec2<i32> {
    let end = f32(size);
    let first = i32(ceil(clamp(low, -1.0, end)));
    let last = i32(floor(clamp(high, -1.0, end)));
    return vec2(max(first, 0), min(last, i32(size) - 1));
}

fn support_of(splat: Splat) -> Support {
    // Where alpha reaches ALPHA_MIN, plus more than the rounding error of a pixel's exponent.
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

// dx of the ellipse's right (side = 1) or left (side = -1) edge at this dy.
fn edge(splat: Splat, support: Support, dy: f32, side: f32) -> f32 {
    let q = splat.whiten_yy * dy;
    let across = side * sqrt(max(support.radius2 - q * q, 0.0));
    return (across - splat.whiten_xy * dy) / splat.whiten_xx;
}

// The half-open range of tile columns touched in a row of tiles.
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
