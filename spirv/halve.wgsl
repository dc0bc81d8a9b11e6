//! with block mirror
// Makes pages of cells twice as wide from blocks of finer cells. One thread per word of a page.

struct HalvePush {
    // The planes at which the finer cells are mirrored, in halves of a finer cell.
    mirror_lo: vec3<i32>,
    // The factor that multiplies the mean of the finer cells, in steps of 2^-16.
    factor: u32,
    mirror_hi: vec3<i32>,
}

var<immediate> push: HalvePush;
// Each block has the finer cells from which the wide cells of a bin within the walls are computed.
// Along y and z, the block begins one finer cell below the lowest of these wide cells. Along x, it
// begins two finer cells below, because rows begin at an even cell.
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> field: array<u32>;
@group(0) @binding(2) var<storage, read_write> pages: array<u32>;

// The weight along an axis of one of the four cells around the middle of a wide cell.
fn weight(i: i32) -> u32 {
    return select(1u, 3u, i == 1 || i == 2);
}

fn wide_sample(block: Block, wide: vec3<i32>) -> u32 {
    let lowest = push.mirror_lo >> vec3(2u);
    let end = (push.mirror_hi + 3) >> vec3(2u);
    if any(wide < lowest) || any(wide >= end) {
        return 0u;
    }
    var sum = 0u;
    for (var z = 0; z < 4; z++) {
        for (var y = 0; y < 4; y++) {
            var row = 0u;
            for (var x = 0; x < 4; x++) {
                let cell = 2 * wide - 1 + vec3(x, y, z);
                let at = vec3<u32>(source_cell(cell, push.mirror_lo, push.mirror_hi) - block.lo);
                row += weight(x) * half_of(field[word_of(block, at)], at.x);
            }
            sum += weight(y) * weight(z) * row;
        }
    }
    // The product is wider than a word, but its lowest 16 bits do not affect the result.
    let product = (sum >> 16u) * push.factor + (((sum & 0xffffu) * push.factor) >> 16u);
    return min((product + (1u << (HALVED_BITS - 17u))) >> (HALVED_BITS - 16u), FULL);
}

@compute @workgroup_size(256)
fn halve(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    // Blocks of finer cells begin at an even x, because their rows consist of whole words.
    let corner = ((block.lo + 2) >> vec3(1u)) & vec3(-BIN);
    let first = 2u * id.x;
    let bin = u32(BIN);
    let wide = corner + vec3<i32>(vec3(first % bin, first / bin % bin, first / (bin * bin)));
    let pair = vec2(wide_sample(block, wide), wide_sample(block, wide + vec3(1, 0, 0)));
    pages[id.y * PAGE_WORDS + id.x] = pair.x | pair.y << 16u;
}
