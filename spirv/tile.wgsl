//! with block
// Sign words of tiles, and the corners of the dual cells that a tile owns.

// The signs of the grid cells at the eight corners of each dual cell in a tile, as one mask per
// corner. Bit i of a corner's index is set if the corner is on the upper side along axis i. Corner
// 0 has the signs of the tile's own cells.
struct Corners {
    at: array<vec2<u32>, 8>,
}

// For each cell of a tile, the sign of the next cell along x. `next` is the sign word of the next
// tile along x. `up_y` and `up_z` do the same along y and z.
fn up_x(tile: vec2<u32>, next: vec2<u32>) -> vec2<u32> {
    return ((tile >> vec2(1u)) & vec2(0x77777777u)) | ((next << vec2(3u)) & vec2(0x88888888u));
}

fn up_y(tile: vec2<u32>, next: vec2<u32>) -> vec2<u32> {
    return ((tile >> vec2(4u)) & vec2(0x0fff0fffu)) | ((next << vec2(12u)) & vec2(0xf000f000u));
}

fn up_z(tile: vec2<u32>, next: vec2<u32>) -> vec2<u32> {
    return vec2((tile.x >> 16u) | (tile.y << 16u), (tile.y >> 16u) | (next.x << 16u));
}

// The signs at the corners of a tile's dual cells, from the words of the tile and of its upper
// neighbours, in the order of corner numbers.
fn corners_of(s: array<vec2<u32>, 8>) -> Corners {
    let x0 = up_x(s[0], s[1]);
    let x2 = up_x(s[2], s[3]);
    let x4 = up_x(s[4], s[5]);
    let x6 = up_x(s[6], s[7]);
    let y0 = up_y(s[0], s[2]);
    let y4 = up_y(s[4], s[6]);
    let xy0 = up_y(x0, x2);
    let xy4 = up_y(x4, x6);
    return Corners(array(
        s[0], x0, y0, xy0, up_z(s[0], s[4]), up_z(x0, x4), up_z(y0, y4), up_z(xy0, xy4)
    ));
}

// The dual cells with corners on both sides of the surface.
fn mixed_of(corners: Corners) -> vec2<u32> {
    var any_inside = vec2(0u);
    var all_inside = vec2(0xffffffffu);
    for (var k = 0u; k < 8u; k++) {
        any_inside |= corners.at[k];
        all_inside &= corners.at[k];
    }
    return any_inside & ~all_inside;
}

// The cells whose dual edge along `axis` crosses the surface.
fn crossed_of(corners: Corners, axis: u32) -> vec2<u32> {
    return corners.at[0] ^ corners.at[1u << axis];
}

fn ones(mask: vec2<u32>) -> u32 {
    return countOneBits(mask.x) + countOneBits(mask.y);
}

fn bit_of(mask: vec2<u32>, bit: u32) -> u32 {
    return (mask[bit / 32u] >> (bit % 32u)) & 1u;
}

// The number of set bits below `bit`.
fn ones_below(mask: vec2<u32>, bit: u32) -> u32 {
    let part = (1u << (bit % 32u)) - 1u;
    return select(countOneBits(mask.x & part), countOneBits(mask.x) + countOneBits(mask.y & part), bit >= 32u);
}

// The inside corners of a dual cell, one bit per corner.
fn case_of(corners: Corners, bit: u32) -> u32 {
    var number = 0u;
    for (var k = 0u; k < 8u; k++) {
        number |= bit_of(corners.at[k], bit) << k;
    }
    return number;
}

// A tile's coordinates in its block, in tiles, from its Morton index.
fn tile_from_morton(index: u32) -> vec3<u32> {
    return vec3(
        (index & 1u) | ((index >> 2u) & 2u) | ((index >> 4u) & 4u),
        ((index >> 1u) & 1u) | ((index >> 3u) & 2u) | ((index >> 5u) & 4u),
        ((index >> 2u) & 1u) | ((index >> 4u) & 2u) | ((index >> 6u) & 4u),
    );
}
