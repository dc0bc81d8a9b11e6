// The distance by which cells with particles lie outside of the calm surface; 0 for other cells. It
// is reduced in the bulk, where no sheet needs to stand out early.

struct OutlyingPush {
    // Words of the field.
    words: u32,
    // The minimum sample of a cell that contains a particle's centre.
    least: u32,
    // The sample at which drops begin to stand out, and the one at which sheets do.
    begin: u32,
    begin_of_sheets: u32,
    // The least difference of the fine and the calm surface in a sheet.
    apart: u32,
}

var<immediate> push: OutlyingPush;
@group(0) @binding(0) var<storage, read> calm: array<u32>;
@group(0) @binding(1) var<storage, read> fine: array<u32>;
// Clouds; replaced by the field.
@group(0) @binding(2) var<storage, read_write> field: array<u32>;

@compute @workgroup_size(256)
fn outlying(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let distances = vec2(calm[word] & 0xffffu, calm[word] >> 16u);
    let finer = vec2(fine[word] & 0xffffu, fine[word] >> 16u);
    let clouds = vec2(field[word] & 0xffffu, field[word] >> 16u);
    let out = max(vec2(FULL) - distances, vec2(1u));
    let may_be_sheet = (finer >= distances + vec2(push.apart)) | (out > vec2(push.begin));
    let counts = select(min(out, vec2(push.begin_of_sheets)), out, may_be_sheet);
    let kept = select(vec2(0u), counts, clouds >= vec2(push.least));
    field[word] = kept.x | kept.y << 16u;
}
