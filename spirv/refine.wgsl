//! with block
// A field of wide cells at the middles of cells: the quadratic B-spline whose control points it is. Cells beyond a wall are the
// outermost before it.

struct Push {
    // The lowest cell within the walls.
    walls_lo: vec3<i32>,
    // A wide cell is 2^level cells along an axis.
    level: u32,
    // The highest cell within the walls.
    walls_hi: vec3<i32>,
}

var<immediate> push: Push;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
// Blocks of wide cells, and for each of the others the number of the one that it lies in.
@group(0) @binding(1) var<storage, read> wide_blocks: array<Block>;
@group(0) @binding(2) var<storage, read> within: array<u32>;
@group(0) @binding(3) var<storage, read> wide: array<u32>;
@group(0) @binding(4) var<storage, read_write> field: array<u32>;

fn wide_sample(block: Block, cell: vec3<i32>) -> u32 {
    // Beyond walls nothing is known, and only cells that nobody asked for lie beyond the block.
    let inside = clamp(cell, push.walls_lo >> vec3(push.level), push.walls_hi >> vec3(push.level));
    let at = vec3<u32>(clamp(inside - block.lo, vec3(0), vec3<i32>(block.size) - 1));
    return half_of(wide[word_of(block, at)], at.x);
}

fn mean(weights: vec3<u32>, taps: vec3<u32>) -> u32 {
    let bits = 2u * push.level + 3u;
    return (dot(weights, taps) + (1u << (bits - 1u))) >> bits;
}

fn weights_of(cell: i32) -> vec3<u32> {
    let edge = 2u << push.level;
    let at = 2u * (u32(cell) & ((1u << push.level) - 1u)) + 1u;
    let below = (edge - at) * (edge - at);
    let above = at * at;
    return vec3(below, 2u * edge * edge - below - above, above);
}

fn refined(block: Block, cell: vec3<i32>) -> u32 {
    let inside = clamp(cell, push.walls_lo, push.walls_hi);
    let own = inside >> vec3(push.level);
    if push.level == 0u {
        return wide_sample(block, own);
    }
    let x = weights_of(inside.x);
    let y = weights_of(inside.y);
    let z = weights_of(inside.z);
    var along_z = vec3(0u);
    for (var k = 0; k < 3; k++) {
        var along_y = vec3(0u);
        for (var j = 0; j < 3; j++) {
            let middle = own + vec3(0, j - 1, k - 1);
            let taps = vec3(
                wide_sample(block, middle - vec3(1, 0, 0)),
                wide_sample(block, middle),
                wide_sample(block, middle + vec3(1, 0, 0)),
            );
            along_y[j] = mean(x, taps);
        }
        along_z[k] = mean(y, along_y);
    }
    return mean(z, along_z);
}

@compute @workgroup_size(256)
fn refine(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let at = cell_of(block, id.x);
    if at.z >= block.size.z {
        return;
    }
    let cell = block.lo + vec3<i32>(at);
    let wide_block = wide_blocks[within[id.y]];
    let samples = vec2(refined(wide_block, cell), refined(wide_block, cell + vec3(1, 0, 0)));
    field[word_of(block, at)] = samples.x | samples.y << 16u;
}
