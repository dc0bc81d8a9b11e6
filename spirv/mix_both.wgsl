//! with block ramp
// Computes the surface of the bulk: the calm surface, blended with the fine surface where their
// mean difference is large, except deep in the fluid. The samples are 0 where no particle is near,
// and maximal in inside bricks.

struct MixBothPush {
    // The ramp, over the mean difference, along which the fine surface replaces the calm surface.
    apart_begin: u32,
    apart_range: u32,
    apart_slope: u32,
    // The ramp, over samples of the calm surface, along which the fine surface fades out deep in
    // the fluid.
    deep_begin: u32,
    deep_range: u32,
    deep_slope: u32,
}

var<immediate> push: MixBothPush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
// The calm surface; replaced by the result.
@group(0) @binding(1) var<storage, read_write> calm: array<u32>;
@group(0) @binding(2) var<storage, read> fine: array<u32>;
// The mean difference between the two surfaces.
@group(0) @binding(3) var<storage, read> apart: array<u32>;
// For each cell, the distance by which nearby particles lie outside the calm surface; 0 where no
// particle is near.
@group(0) @binding(4) var<storage, read> near: array<u32>;
// For each brick that overlaps a block, x fastest, a bit that says whether the brick is inside.
@group(0) @binding(5) var<storage, read> marks: array<u32>;

fn is_inside(block: Block, cell: vec3<i32>) -> bool {
    let first = block.lo >> vec3(INSIDE_BITS);
    let last = (block.lo + vec3<i32>(block.size) - 1) >> vec3(INSIDE_BITS);
    let at = vec3<u32>((cell >> vec3(INSIDE_BITS)) - first);
    let size = vec3<u32>(last - first + 1);
    let index = at.x + size.x * (at.y + size.y * at.z);
    return (marks[block.marks + index / 32u] >> (index % 32u) & 1u) != 0u;
}

fn mixed(calm: u32, fine: u32, apart: u32, near: u32) -> u32 {
    if near == 0u {
        return 0u;
    }
    let distance = u32(abs(i32(apart) - DISTANCE_ZERO));
    let shallow = 4096u - ramp_at(calm, Ramp(push.deep_begin, push.deep_range, push.deep_slope));
    let shape = ramp_at(distance, Ramp(push.apart_begin, push.apart_range, push.apart_slope));
    let share = (shape * shallow) >> 12u;
    return u32(i32(calm) + (((i32(fine) - i32(calm)) * i32(share) + 2048) >> 12u));
}

@compute @workgroup_size(256)
fn mix_both(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let at = cell_of(block, id.x);
    if at.z >= block.size.z {
        return;
    }
    let word = word_of(block, at);
    let a = calm[word];
    let b = fine[word];
    let c = apart[word];
    let d = near[word];
    let both = vec2(
        mixed(a & 0xffffu, b & 0xffffu, c & 0xffffu, d & 0xffffu),
        mixed(a >> 16u, b >> 16u, c >> 16u, d >> 16u),
    );
    let cell = block.lo + vec3<i32>(at);
    let inside = vec2(is_inside(block, cell), is_inside(block, cell + vec3(1, 0, 0)));
    let drawn = select(both, vec2(FULL), inside);
    calm[word] = drawn.x | drawn.y << 16u;
}
