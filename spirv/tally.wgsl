// What a block has, or where it begins among the blocks of a batch.

struct Tally {
    tiles: u32,
    vertices: u32,
    triangles: u32,
    spare: u32,
}

fn tally_of(counts: vec3<u32>) -> Tally {
    return Tally(counts.x, counts.y, counts.z, 0u);
}
