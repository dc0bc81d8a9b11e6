// 1 where a cell is full, else 0.

struct Push {
    // Words of the field.
    words: u32,
    // The least theta of a full cell.
    least: u32,
}

var<immediate> push: Push;
@group(0) @binding(0) var<storage, read_write> field: array<u32>;

@compute @workgroup_size(256)
fn occupancy(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let pair = vec2(field[word] & 0xffffu, field[word] >> 16u);
    let full = select(vec2(0u), vec2(FULL), pair >= vec2(push.least));
    field[word] = full.x | full.y << 16u;
}
