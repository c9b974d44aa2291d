// Writes the splats of the gaussians in view and the number of tiles that each touches.

@group(0) @binding(1) var<storage, read> gaussians: array<Gaussian>;
@group(0) @binding(2) var<storage, read_write> block_sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> splats: array<Splat>;
// The gaussian of each splat.
@group(0) @binding(4) var<storage, read_write> gaussian_of: array<u32>;
// Per splat: its sort key, and its index as the value to be sorted.
@group(0) @binding(5) var<storage, read_write> depth_keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> order: array<u32>;
// Per splat: its first slot (written by `write_touches`) and its number of slots.
@group(0) @binding(7) var<storage, read_write> touches: array<vec2<u32>>;
@group(0) @binding(8) var<storage, read> in_view: array<u32>;

@compute @workgroup_size(GROUP)
fn project(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) block: vec3<u32>,
    lane: Lane,
) {
    let index = id.x;
    var seen = false;
    if index < view.count {
        seen = in_view[index] == 1u;
    }
    let place = place_in_block(u32(seen), block.x, lane);
    if !seen {
        return;
    }
    let splat = splat_of(projection(gaussians[index]));
    let support = support_of(splat);
    var number = 0u;
    for (var row = support.first_row / TILE; row <= support.last_row / TILE; row += 1) {
        let columns = touched_columns(splat, support, row);
        number += columns.y - columns.x;
    }
    splats[place] = splat;
    gaussian_of[place] = index;
    // Positive floats sort like their bits.
    depth_keys[place] = bitcast<u32>(splat.center_depth);
    order[place] = place;
    touches[place] = vec2(0u, number);
}
