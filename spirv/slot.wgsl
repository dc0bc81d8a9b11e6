// A tile that the surface passes through, and the signs of a block's tiles.

struct TileSlot {
    // The tile's Morton index in the block.
    index: u32,
    // The numbers of the tile's first vertex and its first triangle within the block.
    vertex: u32,
    triangle: u32,
    spare: u32,
}

// The signs at the corners of a tile's dual cells. `number` is the number of the block, and `tile`
// is relative to the block's first tile.
fn corners_at(number: u32, block: Block, tile: vec3<u32>) -> Corners {
    let row = block.tiles_size.x / TILE + 1u;
    let slab = row * (block.tiles_size.y / TILE + 1u);
    let first = number * SIGN_TILES + tile.x + row * tile.y + slab * tile.z;
    return corners_of(array(
        signs[first], signs[first + 1u], signs[first + row], signs[first + row + 1u],
        signs[first + slab], signs[first + slab + 1u], signs[first + slab + row], signs[first + slab + row + 1u],
    ));
}

// The tile with this Morton index in its block, as an offset from the first meshed tile.
fn tile_at(block: Block, index: u32) -> vec3<i32> {
    return vec3<i32>(tile_from_morton(index)) - (block.tiles_lo & vec3(BLOCK - 1)) / i32(TILE);
}
