// Divides one field by another, such as clouds by the smoothed clouds.

struct QuotientPush {
    // The number of words in each field.
    words: u32,
    // Fraction bits of the quotient.
    bits: u32,
}

var<immediate> push: QuotientPush;
// The divisor.
@group(0) @binding(0) var<storage, read> around: array<u32>;
// The dividend; replaced by the quotient.
@group(0) @binding(1) var<storage, read_write> field: array<u32>;

@compute @workgroup_size(256)
fn quotient(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let all = max(vec2(around[word] & 0xffffu, around[word] >> 16u), vec2(1u));
    let clouds = vec2(field[word] & 0xffffu, field[word] >> 16u);
    let shares = min((clouds << vec2(push.bits)) / all, vec2(FULL));
    field[word] = shares.x | shares.y << 16u;
}
