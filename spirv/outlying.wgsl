// The distance by which cells with particles lie outside of the calm surface; 0 for other cells.

struct OutlyingPush {
    // Words of the field.
    words: u32,
    // The minimum sample of a cell that contains a particle's centre.
    least: u32,
}

var<immediate> push: OutlyingPush;
@group(0) @binding(0) var<storage, read> calm: array<u32>;
// Clouds; replaced by the field.
@group(0) @binding(1) var<storage, read_write> field: array<u32>;

@compute @workgroup_size(256)
fn outlying(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let distances = vec2(calm[word] & 0xffffu, calm[word] >> 16u);
    let clouds = vec2(field[word] & 0xffffu, field[word] >> 16u);
    let out = max(vec2(FULL) - distances, vec2(1u));
    let kept = select(vec2(0u), out, clouds >= vec2(push.least));
    field[word] = kept.x | kept.y << 16u;
}
