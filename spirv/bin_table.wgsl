// A hash table of bins: none is ever removed, so each has one slot.

struct BinSlot {
    // 0 where it is free, SETTLED where `key` is known; else one more than the number in the chunk of the particle that
    // took it, whose key it has.
    owner: atomic<u32>,
    // Particles in the bin.
    count: atomic<u32>,
    key: vec2<u32>,
}

fn first_slot(key: vec2<u32>, mask: u32) -> u32 {
    var hash = (key.x * 0x9e3779b1u) ^ (key.y * 0x85ebca77u);
    hash = (hash ^ (hash >> 15u)) * 0x2c1b3c6du;
    return (hash ^ (hash >> 12u)) & mask;
}
