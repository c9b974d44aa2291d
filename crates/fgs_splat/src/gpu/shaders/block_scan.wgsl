// Exclusive prefix sum over all threads of a dispatch, in three dispatches: each workgroup stores
// its block's sum (`count_in_block`), one workgroup scans these (`scan_block_sums`), and each thread
// adds its prefix within the workgroup (`place_in_block`). Call all three in uniform control flow.

// Stores the sum of the workgroup's values.
fn count_in_block(value: u32, block: u32, lane: Lane) {
    let sums = workgroup_scan(value, lane);
    if lane.thread == 0u {
        block_sums[block] = sums.y;
    }
}

// The sum of the values of all threads of the dispatch before this one.
fn place_in_block(value: u32, block: u32, lane: Lane) -> u32 {
    return block_sums[block] + workgroup_scan(value, lane).x;
}

const BLOCKS_PER_THREAD: u32 = 8u;

// 1 if the total does not fit into 32 bits.
var<workgroup> wrapped: atomic<u32>;

// Exclusive scan of the first `blocks` block sums, in place. Returns the total, saturated at the
// largest u32.
fn scan_block_sums(blocks: u32, lane: Lane) -> u32 {
    if lane.thread == 0u {
        atomicStore(&wrapped, 0u);
    }
    var before = 0u;
    for (var start = 0u; start < blocks; start += GROUP * BLOCKS_PER_THREAD) {
        let first = start + lane.thread * BLOCKS_PER_THREAD;
        let end = min(first + BLOCKS_PER_THREAD, blocks);
        var sum = 0u;
        for (var block = first; block < end; block += 1u) {
            sum += block_sums[block];
        }
        let sums = workgroup_scan(sum, lane);
        var next = before + sums.x;
        if next + sum < next {
            atomicStore(&wrapped, 1u);
        }
        for (var block = first; block < end; block += 1u) {
            let own = block_sums[block];
            block_sums[block] = next;
            next += own;
        }
        before += sums.y;
    }
    workgroupBarrier();
    return select(before, 0xffffffffu, atomicLoad(&wrapped) != 0u);
}
