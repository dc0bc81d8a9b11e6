// Bins of particles.

struct Bin {
    // Of its first particle, and how many there are.
    first: u32,
    count: u32,
    // Where it is, in bins.
    x: i32,
    y: i32,
    z: i32,
}

// A particle's place along each axis: the cell in the bin, and then the offset in the cell.
fn place_of(record: vec2<u32>) -> vec3<u32> {
    // Bits of y lie in both words.
    let bits = vec3(
        record.x,
        (record.x >> AXIS_BITS) | (record.y << (32u - AXIS_BITS)),
        record.y >> (2u * AXIS_BITS - 32u),
    );
    return bits & vec3((1u << AXIS_BITS) - 1u);
}
