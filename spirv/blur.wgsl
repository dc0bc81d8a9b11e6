//! with block axis
// One axis of a separable filter: (sum over taps of weight * sample + half) >> shift, at most 65535.

@group(0) @binding(2) var<storage, read_write> blurred: array<u32>;
// The weight of the centre, then of the cells 1, 2, ... away on either side.
@group(0) @binding(3) var<storage, read> half_kernel: array<u32>;

fn with_taps(sum: vec2<u32>, k: i32, taps: vec2<u32>) -> vec2<u32> {
    return sum + half_kernel[abs(k)] * taps;
}

@compute @workgroup_size(256)
fn blur(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let at = cell_of(block, id.x);
    if !is_wanted(block, at) {
        return;
    }
    let sum = with_all_taps(vec2(1u << (push.shift - 1u)), block, at);
    let samples = min(sum >> vec2(push.shift), vec2(FULL));
    blurred[word_of(block, at)] = samples.x | samples.y << 16u;
}
