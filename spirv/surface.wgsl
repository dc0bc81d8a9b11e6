// The surfaces of all blocks, in Morton order. Uses `blocks` and `tiles` of the shader.

struct Block {
    // Block coordinates.
    coord: vec3<i32>,
    first_tile: u32,
    tiles: u32,
    // Index in the whole mesh.
    first_vertex: u32,
    first_triangle: u32,
    spare: u32,
    // For each corner number, the number of the next block along the corner's axes; NO_BLOCK if
    // there is none.
    above: array<u32, 8>,
}

// A tile's block, and its first triangle in the whole mesh.
struct Start {
    block: u32,
    triangle: u32,
}

// The corners of a tile's dual cells; see Corners.
fn corners_at(tile: u32) -> Corners {
    var corners: Corners;
    for (var k = 0u; k < 8u; k++) {
        let at = tile * TILE_WORDS + 2u + 2u * k;
        corners.at[k] = vec2(tiles[at], tiles[at + 1u]);
    }
    return corners;
}

// A tile's first vertex in the whole mesh.
fn first_vertex_of(tile: u32, block: u32) -> u32 {
    return blocks[block].first_vertex + tiles[tile * TILE_WORDS + 1u];
}
