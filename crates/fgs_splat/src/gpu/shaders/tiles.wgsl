// Per-tile lists of splats in blending order; counterpart of `cpu/tiles.rs`.
//
// Splats are sorted by depth, ties by gaussian index. Their touches, one per tile, are written in
// that order and then sorted by tile alone; this sort is stable, so each list stays in depth order.
// A touch's slot is its index before the second sort: a splat's slots are contiguous.

@group(0) @binding(1) var<storage, read_write> counts: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> splats: array<Splat>;
@group(0) @binding(4) var<storage, read_write> touches: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> block_sums: array<u32>;
@group(0) @binding(6) var<storage, read_write> tile_keys: array<u32>;
@group(0) @binding(7) var<storage, read_write> slots: array<u32>;
@group(0) @binding(8) var<storage, read_write> slot_splats: array<u32>;
@group(0) @binding(9) var<storage, read_write> dispatches: array<u32>;
// Per tile, the half-open range of its entries.
@group(0) @binding(10) var<storage, read_write> ranges: array<vec2<u32>>;

@compute @workgroup_size(GROUP)
fn count_touches(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) block: vec3<u32>,
    lane: Lane,
) {
    var number = 0u;
    if id.x < counts[VISIBLE] {
        number = touches[order[id.x]].y;
    }
    count_in_block(number, block.x, lane);
}

var<workgroup> visible: u32;

// Scans the block sums. If the touches exceed the buffers' capacity, the step is void, and so is
// everything submitted after it until the host has grown the buffers and cleared the flag.
@compute @workgroup_size(GROUP)
fn place_touches(lane: Lane) {
    if lane.thread == 0u {
        visible = counts[VISIBLE];
    }
    let blocks = (workgroupUniformLoad(&visible) + GROUP - 1u) / GROUP;
    let needed = scan_block_sums(blocks, lane);
    if lane.thread == 0u {
        if needed > view.capacity {
            counts[OVERFLOWED] = 1u;
        }
        let entries = select(needed, 0u, counts[OVERFLOWED] != 0u);
        counts[ENTRIES_NEEDED] = needed;
        counts[ENTRIES] = entries;
        dispatches[SORT_ENTRIES] = (entries + SORT_BLOCK - 1u) / SORT_BLOCK;
        dispatches[SORT_ENTRIES + 1u] = 1u;
        dispatches[SORT_ENTRIES + 2u] = 1u;
    }
}

@compute @workgroup_size(GROUP)
fn write_touches(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) block: vec3<u32>,
    lane: Lane,
) {
    let is_splat = id.x < counts[VISIBLE];
    var index = 0u;
    var number = 0u;
    if is_splat {
        index = order[id.x];
        number = touches[index].y;
    }
    let first = place_in_block(number, block.x, lane);
    if !is_splat || counts[ENTRIES] == 0u {
        return;
    }
    // `project` counted with the same functions, but they may round differently in its pipeline:
    // write no more touches than were counted, and pad missing ones with a key beyond all tiles.
    let end = first + number;
    var slot = first;
    let splat = splats[index];
    let support = support_of(splat);
    for (var row = support.first_row / TILE; row <= support.last_row / TILE; row += 1) {
        let columns = touched_columns(splat, support, row);
        for (var column = columns.x; column < columns.y && slot < end; column += 1u) {
            tile_keys[slot] = u32(row) * view.tile_columns + column;
            slots[slot] = slot;
            slot_splats[slot] = index;
            slot += 1u;
        }
    }
    touches[index] = vec2(first, slot - first);
    for (; slot < end; slot += 1u) {
        tile_keys[slot] = view.tile_columns * view.tile_rows;
        slots[slot] = slot;
        slot_splats[slot] = index;
    }
}

// The first entry whose tile is not less than `tile`.
fn lower_bound(tile: u32) -> u32 {
    var low = 0u;
    var high = counts[ENTRIES];
    while low < high {
        let middle = (low + high) / 2u;
        if tile_keys[middle] < tile {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

@compute @workgroup_size(GROUP)
fn find_ranges(@builtin(global_invocation_id) id: vec3<u32>) {
    let tile = id.x;
    if tile < view.tile_columns * view.tile_rows {
        ranges[tile] = vec2(lower_bound(tile), lower_bound(tile + 1u));
    }
}
