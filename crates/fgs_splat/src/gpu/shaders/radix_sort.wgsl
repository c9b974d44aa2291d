// One pass of a stable radix sort over an eight-bit digit: a histogram of each block of keys, a scan
// of the histograms, and a scatter. The number of keys is read from `counts`.

@group(0) @binding(0) var<uniform> pass_: SortPass;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> keys_in: array<u32>;
@group(0) @binding(3) var<storage, read> values_in: array<u32>;
@group(0) @binding(4) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> values_out: array<u32>;
// [digit][block]: the block's keys with that digit; after `place_digits`, those in earlier blocks.
@group(0) @binding(6) var<storage, read_write> digit_counts: array<u32>;
// Keys with each digit.
@group(0) @binding(7) var<storage, read_write> digit_totals: array<u32>;

const ROUNDS: u32 = SORT_BLOCK / GROUP;
const WORDS: u32 = GROUP / 32u;

fn digit_of(key: u32) -> u32 {
    return (key >> pass_.shift) & 0xffu;
}

fn block_count() -> u32 {
    return (counts[pass_.count] + SORT_BLOCK - 1u) / SORT_BLOCK;
}

var<workgroup> histogram: array<atomic<u32>, GROUP>;

@compute @workgroup_size(GROUP)
fn count_digits(
    @builtin(workgroup_id) block: vec3<u32>,
    lane: Lane,
) {
    let count = counts[pass_.count];
    atomicStore(&histogram[lane.thread], 0u);
    workgroupBarrier();
    for (var round = 0u; round < ROUNDS; round += 1u) {
        let at = block.x * SORT_BLOCK + round * GROUP + lane.thread;
        if at < count {
            atomicAdd(&histogram[digit_of(keys_in[at])], 1u);
        }
    }
    workgroupBarrier();
    digit_counts[lane.thread * block_count() + block.x] = atomicLoad(&histogram[lane.thread]);
}

// One workgroup per digit.
@compute @workgroup_size(GROUP)
fn place_digits(
    @builtin(workgroup_id) digit: vec3<u32>,
    lane: Lane,
) {
    let blocks = block_count();
    var before = 0u;
    for (var start = 0u; start < blocks; start += GROUP) {
        let block = start + lane.thread;
        let at = digit.x * blocks + block;
        var own = 0u;
        if block < blocks {
            own = digit_counts[at];
        }
        let sums = workgroup_scan(own, lane);
        if block < blocks {
            digit_counts[at] = before + sums.x;
        }
        before += sums.y;
    }
    if lane.thread == 0u {
        digit_totals[digit.x] = before;
    }
}

// Destination of the block's next key with each digit.
var<workgroup> next: array<u32, GROUP>;
// [word][digit]: a bit for each thread whose key has that digit.
var<workgroup> holders: array<array<atomic<u32>, GROUP>, WORDS>;

@compute @workgroup_size(GROUP)
fn move_keys(
    @builtin(workgroup_id) block: vec3<u32>,
    lane: Lane,
) {
    let count = counts[pass_.count];
    next[lane.thread] = workgroup_scan(digit_totals[lane.thread], lane).x
        + digit_counts[lane.thread * block_count() + block.x];
    for (var word = 0u; word < WORDS; word += 1u) {
        atomicStore(&holders[word][lane.thread], 0u);
    }
    workgroupBarrier();
    let own_word = lane.thread / 32u;
    let own_bit = 1u << (lane.thread % 32u);
    for (var round = 0u; round < ROUNDS; round += 1u) {
        let at = block.x * SORT_BLOCK + round * GROUP + lane.thread;
        let is_key = at < count;
        var key = 0u;
        var value = 0u;
        if is_key {
            key = keys_in[at];
            value = values_in[at];
            atomicOr(&holders[own_word][digit_of(key)], own_bit);
        }
        workgroupBarrier();
        if is_key {
            let digit = digit_of(key);
            var place = next[digit];
            for (var word = 0u; word < own_word; word += 1u) {
                place += countOneBits(atomicLoad(&holders[word][digit]));
            }
            place += countOneBits(atomicLoad(&holders[own_word][digit]) & (own_bit - 1u));
            keys_out[place] = key;
            values_out[place] = value;
        }
        workgroupBarrier();
        var held = 0u;
        for (var word = 0u; word < WORDS; word += 1u) {
            held += countOneBits(atomicExchange(&holders[word][lane.thread], 0u));
        }
        next[lane.thread] += held;
        workgroupBarrier();
    }
}
