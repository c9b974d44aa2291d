// How many gaussians a view's set has in common with every set. One workgroup per set.

@group(0) @binding(0) var<uniform> covisibility_: Covisibility;
@group(0) @binding(1) var<storage, read> visible_sets: array<u32>;
@group(0) @binding(2) var<storage, read_write> overlaps: array<u32>;

@compute @workgroup_size(GROUP)
fn covisibility(
    @builtin(workgroup_id) other_set: vec3<u32>,
    lane: Lane,
) {
    let own = covisibility_.own_set * covisibility_.set_words;
    let other = other_set.x * covisibility_.set_words;
    var shared_bits = 0u;
    for (var word = lane.thread; word < covisibility_.used_words; word += GROUP) {
        shared_bits += countOneBits(visible_sets[own + word] & visible_sets[other + word]);
    }
    let sums = workgroup_scan(shared_bits, lane);
    if lane.thread == 0u {
        overlaps[other_set.x] = sums.y;
    }
}
