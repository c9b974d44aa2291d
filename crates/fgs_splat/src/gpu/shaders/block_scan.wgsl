// From the sums of blocks to where each block starts. A single workgroup does it.

const BLOCKS_PER_THREAD: u32 = 8u;

// Replaces each of the first `blocks` sums by the sum of those before it; returns the sum of all.
fn scan_block_sums(blocks: u32, thread: u32) -> u32 {
    var before = 0u;
    for (var start = 0u; start < blocks; start += GROUP * BLOCKS_PER_THREAD) {
        let first = start + thread * BLOCKS_PER_THREAD;
        let end = min(first + BLOCKS_PER_THREAD, blocks);
        var sum = 0u;
        for (var block = first; block < end; block += 1u) {
            sum += block_sums[block];
        }
        let sums = workgroup_scan(sum, thread);
        var next = before + sums.x;
        for (var block = first; block < end; block += 1u) {
            let own = block_sums[block];
            block_sums[block] = next;
            next += own;
        }
        before += sums.y;
    }
    return before;
}
