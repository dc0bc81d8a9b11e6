//! with block tile
// Counts and orders the tiles that the surface passes through: a block a work group, by a prefix sum over the block's
// tiles in Morton order.

struct Tally {
    tiles: u32,
    vertices: u32,
    triangles: u32,
    spare: u32,
}

struct Slot {
    // Its Morton index in the block.
    index: u32,
    // The numbers of its first vertex and its first triangle, counted in the block.
    vertex: u32,
    triangle: u32,
    spare: u32,
}

@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> signs: array<vec2<u32>>;
// Triangles by case.
@group(0) @binding(2) var<storage, read> lengths: array<u32>;
@group(0) @binding(3) var<storage, read_write> slots: array<Slot>;
@group(0) @binding(4) var<storage, read_write> tallies: array<Tally>;

const GROUP: u32 = 256u;
var<workgroup> sums: array<vec3<u32>, GROUP>;

fn tally(number: u32, block: Block, index: u32) -> vec3<u32> {
    let tiles = block.tiles_size / TILE;
    let at = vec3<i32>(tile_from_morton(index)) - (block.tiles_lo & vec3(BLOCK - 1)) / i32(TILE);
    if any(at < vec3(0)) || any(vec3<u32>(at) >= tiles) {
        return vec3(0u);
    }
    let tile = vec3<u32>(at);
    let row = tiles.x + 1u;
    let slab = row * (tiles.y + 1u);
    let first = number * SIGN_TILES + tile.x + row * tile.y + slab * tile.z;
    let corners = corners_of(array(
        signs[first], signs[first + 1u], signs[first + row], signs[first + row + 1u],
        signs[first + slab], signs[first + slab + 1u], signs[first + slab + row], signs[first + slab + row + 1u],
    ));
    let mixed = mixed_of(corners);
    if all(mixed == vec2(0u)) {
        return vec3(0u);
    }
    var triangles = 0u;
    for (var bit = 0u; bit < 64u; bit++) {
        if bit_of(mixed, bit) == 1u {
            triangles += lengths[case_of(corners, bit)];
        }
    }
    let vertices = ones(crossed_of(corners, 0u)) + ones(crossed_of(corners, 1u)) + ones(crossed_of(corners, 2u));
    return vec3(1u, vertices, triangles);
}

@compute @workgroup_size(256)
fn tiles(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let number = group.x;
    let block = blocks[number];
    let i = local.x;
    let one = tally(number, block, 2u * i);
    let two = tally(number, block, 2u * i + 1u);
    sums[i] = one + two;
    for (var step = 1u; step < GROUP; step *= 2u) {
        workgroupBarrier();
        var below = vec3(0u);
        if i >= step {
            below = sums[i - step];
        }
        workgroupBarrier();
        sums[i] += below;
    }
    workgroupBarrier();
    let end = sums[i];
    let middle = end - two;
    let begin = middle - one;
    if one.x == 1u {
        slots[number * BLOCK_TILES + begin.x] = Slot(2u * i, begin.y, begin.z, 0u);
    }
    if two.x == 1u {
        slots[number * BLOCK_TILES + middle.x] = Slot(2u * i + 1u, middle.y, middle.z, 0u);
    }
    if i == GROUP - 1u {
        tallies[number] = Tally(end.x, end.y, end.z, 0u);
    }
}
