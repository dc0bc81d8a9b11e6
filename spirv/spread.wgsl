//! with block axis
// One axis of a dilation: the greatest of the taps within reach.

@group(0) @binding(2) var<storage, read_write> greatest: array<u32>;

fn with_taps(most: vec2<u32>, k: i32, taps: vec2<u32>) -> vec2<u32> {
    return max(most, taps);
}

@compute @workgroup_size(256)
fn spread(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let at = cell_of(block, id.x);
    if !is_wanted(block, at) {
        return;
    }
    let most = with_all_taps(vec2(0u), block, at);
    greatest[word_of(block, at)] = most.x | most.y << 16u;
}
