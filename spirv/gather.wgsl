//! with block brick
// Cuts padded blocks out of the pages: of every cell the sum over the bricks that hold it, or hold it in their ghost layers.

struct GatherPush {
    // Entries of the table that turns numbers of particles into theta; 0 where pages hold theta.
    decode: u32,
    // Of a cell's coordinate, those in its brick.
    brick_bits: u32,
    // How many cells around their own bricks hold.
    ghost_layer: u32,
    page_words: u32,
}

var<immediate> push: GatherPush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
// For every bin whose bricks and ghost layers a block touches, x fastest, one more than the number of its page, or 0.
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

// The bins that a block and its ghost layers touch: the lowest, and how many there are along each axis.
struct Bins {
    first: vec3<i32>,
    size: vec3<i32>,
}

fn bins_of(block: Block) -> Bins {
    let ghost_layer = i32(push.ghost_layer);
    let first = (block.lo - ghost_layer) >> vec3(BIN_BITS);
    return Bins(first, ((block.lo + vec3<i32>(block.size) - 1 + ghost_layer) >> vec3(BIN_BITS)) - first + 1);
}

// What a brick, given by its place in bricks, holds of a pair of cells.
fn stored(block: Block, bins: Bins, cell: vec3<i32>, brick: vec3<i32>) -> vec2<u32> {
    let corner = brick << vec3(push.brick_bits);
    let bin = (corner >> vec3(BIN_BITS)) - bins.first;
    let page = tables[block.table + u32(bin.x + bins.size.x * (bin.y + bins.size.y * bin.z))];
    if page == 0u {
        return vec2(0u);
    }
    let edge = (1u << push.brick_bits) + 2u * push.ghost_layer;
    let number = brick_of(vec3<u32>(corner & vec3(BIN - 1)), push.brick_bits);
    let inside = cell - corner + i32(push.ghost_layer);
    let row = edge * (u32(inside.y) + edge * (u32(inside.z) + edge * number));
    let first = (page - 1u) * push.page_words;
    // Of the pair, one cell can lie beyond the brick's ghost layer.
    let at = vec2(row + u32(max(inside.x, 0)), row + min(u32(inside.x + 1), edge - 1u));
    let samples = vec2(half_of(pages[first + at.x / 2u], at.x), half_of(pages[first + at.y / 2u], at.y));
    return select(vec2(0u), samples, vec2(inside.x >= 0, inside.x + 1 < i32(edge)));
}

@compute @workgroup_size(256)
fn gather(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let width = block.size.x / 2u;
    let row = id.x / width;
    // A run along z, that what is found by divisions is found once.
    var at = vec3(2u * (id.x % width), row % block.size.y, RUN * (row / block.size.y));
    let bins = bins_of(block);
    for (var i = 0u; i < RUN && at.z < block.size.z; i++) {
        let cell = block.lo + vec3<i32>(at);
        let first = (cell - i32(push.ghost_layer)) >> vec3(push.brick_bits);
        let last = (cell + vec3(1, 0, 0) + i32(push.ghost_layer)) >> vec3(push.brick_bits);
        var sum = vec2(0u);
        for (var z = first.z; z <= last.z; z++) {
            for (var y = first.y; y <= last.y; y++) {
                for (var x = first.x; x <= last.x; x++) {
                    sum += stored(block, bins, cell, vec3(x, y, z));
                }
            }
        }
        let held = min(sum, vec2(FULL));
        field[word_of(block, at)] = decoded(held.x) | decoded(held.y) << 16u;
        at.z++;
    }
}
