// A hash table of bins. Bins are never removed, so each bin has one slot.

struct BinSlot {
    // 0 for a free slot; SETTLED if `key` is set. Otherwise, a particle of the chunk has taken the
    // slot: `owner` is 1 plus the particle's number in the chunk, and the slot belongs to the bin
    // of that particle.
    owner: atomic<u32>,
    // The number of particles in the bin.
    count: atomic<u32>,
    key: vec2<u32>,
}

fn first_slot(key: vec2<u32>, mask: u32) -> u32 {
    var hash = (key.x * 0x9e3779b1u) ^ (key.y * 0x85ebca77u);
    hash = (hash ^ (hash >> 15u)) * 0x2c1b3c6du;
    return (hash ^ (hash >> 12u)) & mask;
}
