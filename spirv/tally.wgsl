// The numbers of tiles, vertices and triangles of a block, or of all blocks before it in the batch.

struct BlockTally {
    tiles: u32,
    vertices: u32,
    triangles: u32,
    spare: u32,
}

fn tally_of(counts: vec3<u32>) -> BlockTally {
    return BlockTally(counts.x, counts.y, counts.z, 0u);
}
