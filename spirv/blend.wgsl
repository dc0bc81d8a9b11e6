// Blends the shares of drops with the shares of sheets, weighted by the certainty of the sheets.

struct BlendPush {
    // The number of words in each field.
    words: u32,
}

var<immediate> push: BlendPush;
@group(0) @binding(0) var<storage, read> sheets: array<u32>;
@group(0) @binding(1) var<storage, read> certainty: array<u32>;
// The shares of drops; replaced by the result.
@group(0) @binding(2) var<storage, read_write> shares: array<u32>;

fn blended(drop: u32, sheet: u32, certain: u32) -> u32 {
    if certain == 0u {
        return drop;
    }
    return u32(i32(drop) + (((i32(sheet) - i32(drop)) * i32(certain)) >> SHEET_BITS));
}

@compute @workgroup_size(256)
fn blend(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let drops = shares[word];
    let of_sheets = sheets[word];
    let certain = certainty[word];
    let first = blended(drops & 0xffffu, of_sheets & 0xffffu, certain & 0xffffu);
    shares[word] = first | blended(drops >> 16u, of_sheets >> 16u, certain >> 16u) << 16u;
}
