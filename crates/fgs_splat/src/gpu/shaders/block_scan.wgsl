// Places in order for those of all threads' items that are kept: each workgroup, a block, leaves its
// sum; a single one finds where each block starts; then each thread knows its own place.

// Leaves the block's sum. To be called by all threads.
fn count_in_block(value: u32, block: u32, lane: Lane) {
    let sums = workgroup_scan(value, lane);
    if lane.thread == 0u {
        block_sums[block] = sums.y;
    }
}

// The sum of the values of all threads before this one. To be called by all threads.
fn place_in_block(value: u32, block: u32, lane: Lane) -> u32 {
    return block_sums[block] + workgroup_scan(value, lane).x;
}

const BLOCKS_PER_THREAD: u32 = 8u;

// Whether the sum of all is no number of 32 bits.
var<workgroup> wrapped: atomic<u32>;

// Replaces each of the first `blocks` sums by the sum of those before it; returns the sum of all,
// or the largest number if that is less.
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
