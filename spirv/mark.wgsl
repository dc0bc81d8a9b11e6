// The adaptive blur's marks: `mark` where a cell is full, else 0.

struct Push {
    // Words of the field.
    words: u32,
    mark: u32,
}

var<immediate> push: Push;
@group(0) @binding(0) var<storage, read_write> field: array<u32>;

@compute @workgroup_size(256)
fn mark(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let pair = vec2(field[word] & 0xffffu, field[word] >> 16u);
    let marks = select(vec2(0u), vec2(push.mark), pair > vec2(0u));
    field[word] = marks.x | marks.y << 16u;
}
