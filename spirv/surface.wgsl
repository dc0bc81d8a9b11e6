// The surfaces of all blocks, in Morton order. Uses `blocks` and `tiles` of the shader that
// includes this file.

struct Block {
    // The block's coordinates, in units of blocks.
    coord: vec3<i32>,
    first_tile: u32,
    tiles: u32,
    // The numbers of the block's first vertex and first triangle in the whole mesh.
    first_vertex: u32,
    first_triangle: u32,
    spare: u32,
    // For each corner number k from 0 to 7, the number of the block that is one block up along axis
    // i for every set bit i of k; NO_BLOCK if there is no such block.
    above: array<u32, 8>,
}

// The block of a tile, and the number of the tile's first triangle in the whole mesh.
struct Start {
    block: u32,
    triangle: u32,
}

// The signs at the corners of a tile's dual cells; see `Corners`.
fn corners_at(tile: u32) -> Corners {
    var corners: Corners;
    for (var k = 0u; k < 8u; k++) {
        let at = tile * TILE_WORDS + 2u + 2u * k;
        corners.at[k] = vec2(tiles[at], tiles[at + 1u]);
    }
    return corners;
}

// The number of a tile's first vertex in the whole mesh.
fn first_vertex_of(tile: u32, block: u32) -> u32 {
    return blocks[block].first_vertex + tiles[tile * TILE_WORDS + 1u];
}
