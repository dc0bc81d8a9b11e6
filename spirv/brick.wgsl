// The Morton index of a cell's brick in its bin.
fn brick_of(cell: vec3<u32>, brick_bits: u32) -> u32 {
    let brick = (cell & vec3(u32(BIN) - 1u)) >> vec3(brick_bits);
    // At most two bits per axis.
    let low = brick & vec3(1u);
    let high = brick >> vec3(1u);
    return low.x | (low.y << 1u) | (low.z << 2u) | (high.x << 3u) | (high.y << 4u) | (high.z << 5u);
}
