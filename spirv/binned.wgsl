// Bins with their particles.

struct Bin {
    // The index of the bin's first particle, and the number of its particles.
    first: u32,
    count: u32,
    // Coordinates in bins.
    x: i32,
    y: i32,
    z: i32,
}

// A particle's position along each axis, with the cell in the bin in the upper bits, and the offset
// in the cell in the lower bits.
fn place_of(record: vec2<u32>) -> vec3<u32> {
    // The bits of y are in both words.
    let bits = vec3(
        record.x,
        (record.x >> AXIS_BITS) | (record.y << (32u - AXIS_BITS)),
        record.y >> (2u * AXIS_BITS - 32u),
    );
    return bits & vec3((1u << AXIS_BITS) - 1u);
}
