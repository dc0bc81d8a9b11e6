//! with gate
// The surface of the bulk: the calm one, and the fine one where both are apart all around, but not deep in the fluid.

struct Push {
    // Words of the field.
    words: u32,
    // From where to where what both are apart by makes the fine surface of the calm one.
    apart_begin: u32,
    apart_range: u32,
    apart_slope: u32,
    // From which sample of the calm surface to which it stays what it is.
    deep_begin: u32,
    deep_range: u32,
    deep_slope: u32,
}

var<immediate> push: Push;
// The calm surface, to become the one that is drawn.
@group(0) @binding(0) var<storage, read_write> calm: array<u32>;
@group(0) @binding(1) var<storage, read> fine: array<u32>;
// What both are apart by on average.
@group(0) @binding(2) var<storage, read> apart: array<u32>;

fn mixed(calm: u32, fine: u32, apart: u32) -> u32 {
    let distance = u32(abs(i32(apart) - DISTANCE_ZERO));
    let shallow = 4096u - passed(calm, Gate(push.deep_begin, push.deep_range, push.deep_slope));
    let told = passed(distance, Gate(push.apart_begin, push.apart_range, push.apart_slope));
    let share = (told * shallow) >> 12u;
    return u32(i32(calm) + (((i32(fine) - i32(calm)) * i32(share) + 2048) >> 12u));
}

@compute @workgroup_size(256)
fn mix_both(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let a = calm[word];
    let b = fine[word];
    let c = apart[word];
    calm[word] = mixed(a & 0xffffu, b & 0xffffu, c & 0xffffu) | mixed(a >> 16u, b >> 16u, c >> 16u) << 16u;
}
