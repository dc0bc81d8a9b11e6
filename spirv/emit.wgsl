//! with block mirror tile slot tally
// Writes the tiles of a batch and the field at both ends of every crossed dual edge: one work group
// per tile, one thread per cell.

struct EmitPush {
    // The planes of the mirrors, in halves of a cell.
    mirror_lo: vec3<i32>,
    // The number of blocks in the batch.
    blocks: u32,
    mirror_hi: vec3<i32>,
    // Whether to also write the decrease of the field along each axis, for normals.
    normals: u32,
}

var<immediate> push: EmitPush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> field: array<u32>;
@group(0) @binding(2) var<storage, read> signs: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> slots: array<TileSlot>;
// The start of each block in the batch.
@group(0) @binding(4) var<storage, read> tallies: array<BlockTally>;
// For each tile, TILE_WORDS words: its Morton index, its first vertex in the block, and the signs
// at eight corners.
@group(0) @binding(5) var<storage, read_write> tiles: array<u32>;
// For each vertex, the samples at the lower and the upper end of its edge.
@group(0) @binding(6) var<storage, read_write> ends: array<u32>;
// For each vertex, the decrease of the field along x, y and z, first at the lower and then at the
// upper end of its edge.
@group(0) @binding(7) var<storage, read_write> falls: array<i32>;

fn sample(block: Block, cell: vec3<i32>) -> u32 {
    let at = vec3<u32>(source_cell(cell, push.mirror_lo, push.mirror_hi) - block.lo);
    return half_of(field[word_of(block, at)], at.x);
}

fn falling(block: Block, cell: vec3<i32>, axis: u32) -> i32 {
    var up = vec3(0);
    up[axis] = 1;
    return i32(sample(block, cell - up)) - i32(sample(block, cell + up));
}

// The block that contains a tile of the batch: the last block whose first tile is not after this
// tile.
fn block_of(tile: u32) -> u32 {
    var low = 0u;
    var beyond = push.blocks;
    while beyond - low > 1u {
        let middle = (low + beyond) / 2u;
        if tallies[middle].tiles <= tile {
            low = middle;
        } else {
            beyond = middle;
        }
    }
    return low;
}

@compute @workgroup_size(64)
fn emit(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
) {
    let written = group.x + groups.x * group.y;
    if written >= tallies[push.blocks].tiles {
        return;
    }
    let number = block_of(written);
    let base = tallies[number];
    let block = blocks[number];
    let slot = slots[number * BLOCK_TILES + written - base.tiles];
    let tile = vec3<u32>(tile_at(block, slot.index));
    let corners = corners_at(number, block, tile);
    let bit = local.x;
    let to = written * TILE_WORDS;
    if bit == 0u {
        tiles[to] = slot.index;
        tiles[to + 1u] = slot.vertex;
    }
    if bit < 8u {
        tiles[to + 2u + 2u * bit] = corners.at[bit].x;
        tiles[to + 3u + 2u * bit] = corners.at[bit].y;
    }
    let cell = block.tiles_lo + vec3<i32>(tile * TILE + vec3(bit % TILE, bit / TILE % TILE, bit / (TILE * TILE)));
    var vertex = base.vertices + slot.vertex;
    for (var axis = 0u; axis < 3u; axis++) {
        let crossed = crossed_of(corners, axis);
        if bit_of(crossed, bit) == 1u {
            let at = vertex + ones_below(crossed, bit);
            var upper = cell;
            upper[axis] += 1;
            ends[at] = sample(block, cell) | (sample(block, upper) << 16u);
            if push.normals != 0u {
                for (var along = 0u; along < 3u; along++) {
                    falls[6u * at + along] = falling(block, cell, along);
                    falls[6u * at + 3u + along] = falling(block, upper, along);
                }
            }
        }
        vertex += ones(crossed);
    }
}
