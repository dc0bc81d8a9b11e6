// Computes the DIF where smoothing reduced it to the isovalue or below, and 0 elsewhere (section
// 6.2 of the paper).

struct LostPush {
    // The number of words in each field.
    words: u32,
    // The greatest sample that counts as outside the fluid.
    threshold: u32,
}

var<immediate> push: LostPush;
@group(0) @binding(0) var<storage, read> dif: array<u32>;
@group(0) @binding(1) var<storage, read> smoothed: array<u32>;
@group(0) @binding(2) var<storage, read_write> kept: array<u32>;

@compute @workgroup_size(256)
fn lost(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let smooth_pair = vec2(smoothed[word] & 0xffffu, smoothed[word] >> 16u);
    let mask = select(vec2(0u), vec2(0xffffu, 0xffff0000u), smooth_pair <= vec2(push.threshold));
    kept[word] = dif[word] & (mask.x | mask.y);
}
