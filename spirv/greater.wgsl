// Computes the greater of two fields, sample by sample (section 6.2 of the paper).

struct GreaterPush {
    // The number of words in each field.
    words: u32,
}

var<immediate> push: GreaterPush;
@group(0) @binding(0) var<storage, read> other: array<u32>;
@group(0) @binding(1) var<storage, read_write> field: array<u32>;

@compute @workgroup_size(256)
fn greater(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let a = field[word];
    let b = other[word];
    field[word] = max(a & 0xffffu, b & 0xffffu) | max(a & 0xffff0000u, b & 0xffff0000u);
}
