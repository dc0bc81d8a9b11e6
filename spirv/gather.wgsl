//! with block brick
// Cuts padded blocks out of the pages: of every cell the sum over the bricks that hold it, or hold it in their rims.

struct Push {
    // Entries of the table that turns numbers of particles into theta; 0 where pages hold theta.
    decode: u32,
    // Of a cell's coordinate, those in its brick.
    brick_bits: u32,
    // How many cells around their own bricks hold.
    rim: u32,
    page_words: u32,
}

var<immediate> push: Push;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
// For every bin whose bricks and rims a block touches, x fastest, one more than the number of its page, or 0.
@group(0) @binding(1) var<storage, read> tables: array<u32>;
// Brick after brick along the Morton curve, x fastest in each.
@group(0) @binding(2) var<storage, read> pages: array<u32>;
@group(0) @binding(3) var<storage, read> theta: array<u32>;
@group(0) @binding(4) var<storage, read_write> field: array<u32>;

fn decoded(sample: u32) -> u32 {
    if push.decode == 0u {
        return sample;
    }
    return theta[min(sample, push.decode - 1u)];
}

// What a brick, given by its place in bricks, holds of a cell.
fn stored(block: Block, cell: vec3<i32>, brick: vec3<i32>) -> u32 {
    let rim = i32(push.rim);
    let first = (block.lo - rim) >> vec3(BIN_BITS);
    let bins = ((block.lo + vec3<i32>(block.size) - 1 + rim) >> vec3(BIN_BITS)) - first + 1;
    let corner = brick << vec3(push.brick_bits);
    let bin = (corner >> vec3(BIN_BITS)) - first;
    let page = tables[block.table + u32(bin.x + bins.x * (bin.y + bins.y * bin.z))];
    if page == 0u {
        return 0u;
    }
    let edge = (1u << push.brick_bits) + 2u * push.rim;
    let number = brick_of(vec3<u32>(corner & vec3(BIN - 1)), push.brick_bits);
    let inside = vec3<u32>(cell - corner + rim);
    let at = inside.x + edge * (inside.y + edge * (inside.z + edge * number));
    return half_of(pages[(page - 1u) * push.page_words + at / 2u], at);
}

fn sample(block: Block, cell: vec3<i32>) -> u32 {
    let rim = i32(push.rim);
    let first = (cell - rim) >> vec3(push.brick_bits);
    let last = (cell + rim) >> vec3(push.brick_bits);
    var sum = 0u;
    for (var z = first.z; z <= last.z; z++) {
        for (var y = first.y; y <= last.y; y++) {
            for (var x = first.x; x <= last.x; x++) {
                sum += stored(block, cell, vec3(x, y, z));
            }
        }
    }
    return decoded(min(sum, FULL));
}

@compute @workgroup_size(256)
fn gather(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let at = cell_of(block, id.x);
    if at.z >= block.size.z {
        return;
    }
    let cell = block.lo + vec3<i32>(at);
    field[word_of(block, at)] = sample(block, cell) | (sample(block, cell + vec3(1, 0, 0)) << 16u);
}
