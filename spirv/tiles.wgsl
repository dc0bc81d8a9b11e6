//! with block tile slot tally scan
// Counts and orders the tiles with a surface: one work group per block, with a prefix sum over the
// block's tiles in Morton order.

@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> signs: array<vec2<u32>>;
// Number of triangles for each case.
@group(0) @binding(2) var<storage, read> lengths: array<u32>;
@group(0) @binding(3) var<storage, read_write> slots: array<TileSlot>;
@group(0) @binding(4) var<storage, read_write> tallies: array<BlockTally>;

fn tally(number: u32, block: Block, index: u32) -> vec3<u32> {
    let tile = tile_at(block, index);
    if any(tile < vec3(0)) || any(vec3<u32>(tile) >= block.tiles_size / TILE) {
        return vec3(0u);
    }
    let corners = corners_at(number, block, vec3<u32>(tile));
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
    let end = scanned(i, one + two);
    let middle = end - two;
    let begin = middle - one;
    if one.x == 1u {
        slots[number * BLOCK_TILES + begin.x] = TileSlot(2u * i, begin.y, begin.z, 0u);
    }
    if two.x == 1u {
        slots[number * BLOCK_TILES + middle.x] = TileSlot(2u * i + 1u, middle.y, middle.z, 0u);
    }
    if i == GROUP - 1u {
        tallies[number] = tally_of(end);
    }
}
