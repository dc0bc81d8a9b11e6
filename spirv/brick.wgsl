// The number of a cell's brick among those of its bin, along the Morton curve.
fn brick_of(cell: vec3<u32>, brick_bits: u32) -> u32 {
    let brick = (cell & vec3(u32(BIN) - 1u)) >> vec3(brick_bits);
    // Two bits an axis at the most.
    let low = brick & vec3(1u);
    let high = brick >> vec3(1u);
    return low.x | (low.y << 1u) | (low.z << 2u) | (high.x << 3u) | (high.y << 4u) | (high.z << 5u);
}
