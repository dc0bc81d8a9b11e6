//! with ramp
// Computes the distance by which each cell with a particle lies outside the calm surface; 0 for
// other cells. Small distances are reduced where the fine surface agrees with the calm surface.

struct OutlyingPush {
    // The number of words in each field.
    words: u32,
    // A cell contains a particle's centre if its sample is at least this number.
    least: u32,
    // The distances at which drops and sheets begin to stand out.
    begin: u32,
    begin_of_sheets: u32,
    // The ramp over the difference between the fine and the calm surface. Where they differ, sheets
    // stand out earlier.
    apart_begin: u32,
    apart_range: u32,
    apart_slope: u32,
}

var<immediate> push: OutlyingPush;
@group(0) @binding(0) var<storage, read> calm: array<u32>;
@group(0) @binding(1) var<storage, read> fine: array<u32>;
// Clouds; replaced by the field.
@group(0) @binding(2) var<storage, read_write> field: array<u32>;

fn outside(calm: u32, fine: u32, cloud: u32) -> u32 {
    if cloud < push.least {
        return 0u;
    }
    let distance = max(FULL - calm, 1u);
    let apart = Ramp(push.apart_begin, push.apart_range, push.apart_slope);
    let differs = ramp_at(max(fine, calm) - calm, apart);
    let most = push.begin_of_sheets + (((push.begin - push.begin_of_sheets) * differs) >> 12u);
    return select(min(distance, most), distance, distance > push.begin);
}

@compute @workgroup_size(256)
fn outlying(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let a = calm[word];
    let b = fine[word];
    let c = field[word];
    let first = outside(a & 0xffffu, b & 0xffffu, c & 0xffffu);
    field[word] = first | outside(a >> 16u, b >> 16u, c >> 16u) << 16u;
}
