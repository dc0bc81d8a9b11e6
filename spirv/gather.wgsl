//! with block brick
// Gathers padded blocks from the pages: the sample of a cell is the sum over the bricks that
// contain the cell, including their ghost layers.

struct GatherPush {
    // Number of entries of the table that converts numbers of particles to theta; 0 if pages
    // contain theta.
    decode: u32,
    // The number of low bits of a cell's coordinate within its brick.
    brick_bits: u32,
    // The width of the ghost layer around each brick.
    ghost_layer: u32,
    page_words: u32,
}

var<immediate> push: GatherPush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
// For every bin whose bricks or ghost layers overlap a block, x fastest: the number of its page
// plus 1, or 0 if the bin has no page.
@group(0) @binding(1) var<storage, read> tables: array<u32>;
// The pages. A page has its bricks in the order of the Morton curve, and x varies fastest in each
// brick.
@group(0) @binding(2) var<storage, read> pages: array<u32>;
@group(0) @binding(3) var<storage, read> theta: array<u32>;
@group(0) @binding(4) var<storage, read_write> field: array<u32>;

fn decoded(sample: u32) -> u32 {
    if push.decode == 0u {
        return sample;
    }
    return theta[min(sample, push.decode - 1u)];
}

// The bins that overlap a block and its ghost layers: the lowest bin, and the number of bins along
// each axis.
struct Bins {
    first: vec3<i32>,
    size: vec3<i32>,
}

fn bins_of(block: Block) -> Bins {
    let ghost_layer = i32(push.ghost_layer);
    let first = (block.lo - ghost_layer) >> vec3(BIN_BITS);
    return Bins(first, ((block.lo + vec3<i32>(block.size) - 1 + ghost_layer) >> vec3(BIN_BITS)) - first + 1);
}

// The samples of a pair of cells that are stored for one brick. `brick` has the brick's
// coordinates.
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
    // One cell of the pair can lie beyond the brick's ghost layer.
    let at = vec2(row + u32(max(inside.x, 0)), row + min(u32(inside.x + 1), edge - 1u));
    let samples = vec2(half_of(pages[first + at.x / 2u], at.x), half_of(pages[first + at.y / 2u], at.y));
    return select(vec2(0u), samples, vec2(inside.x >= 0, inside.x + 1 < i32(edge)));
}

@compute @workgroup_size(256)
fn gather(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let width = block.size.x / 2u;
    let row = id.x / width;
    // Computes a run of pairs along z, so that the divisions are done only once per run.
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
