// Padded blocks of 16-bit samples, two per word, x fastest. Rows begin at even cells and consist of
// whole words.

struct Block {
    // The lowest cell, and the index of the block's first word in the field.
    lo: vec3<i32>,
    field: u32,
    // The size in cells, and the first entry of the block's page table.
    size: vec3<u32>,
    table: u32,
    // The lowest cell of the tiles that are meshed.
    tiles_lo: vec3<i32>,
    // The index of the block's first word in a buffer that has one bit for each brick of every
    // block; unused without such a buffer.
    marks: u32,
    // The edges, in cells, of the part of the block that is divided into tiles.
    tiles_size: vec3<u32>,
    spare: u32,
}

// The word of a cell, relative to the block's lowest cell.
fn word_of(block: Block, at: vec3<u32>) -> u32 {
    return block.field + at.x / 2u + block.size.x / 2u * (at.y + block.size.y * at.z);
}

// The lower cell of the pair in word number `word` of the block, relative to the block's lowest
// cell. If the word is beyond the end of the block, z is at least the block's size along z.
fn cell_of(block: Block, word: u32) -> vec3<u32> {
    let row = word / (block.size.x / 2u);
    return vec3(2u * (word % (block.size.x / 2u)), row % block.size.y, row / block.size.y);
}

fn half_of(word: u32, x: u32) -> u32 {
    return (word >> (16u * (x & 1u))) & 0xffffu;
}
