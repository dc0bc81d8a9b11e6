//! with tile surface
// Writes the triangles of every dual cell: one work group per tile, one thread per cell. The number
// of a vertex is the number of its tile's first vertex, plus its rank among the tile's crossed
// edges.

struct TrianglesPush {
    // The number of the first tile.
    first_tile: u32,
    tiles: u32,
    // The number of the first triangle to write, and the number of words in the buffer before it.
    first_triangle: u32,
    first_word: u32,
}

var<immediate> push: TrianglesPush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
@group(0) @binding(2) var<storage, read> begins: array<Start>;
// For each case: the number of triangles, followed by a word for each triangle. The word has the
// three edges on which the triangle's vertices lie, each as corner + 8 axis in EDGE_BITS bits.
@group(0) @binding(3) var<storage, read> table: array<u32>;
@group(0) @binding(4) var<storage, read_write> indices: array<u32>;

// For the tile and its upper neighbours, in the order of corner numbers, and for each axis: the
// crossed edges, and the number of the first vertex on them.
var<workgroup> crossed_edges: array<vec2<u32>, 24>;
var<workgroup> first_vertices: array<u32, 24>;
// For each cell, the number of triangles of this cell and of all cells before it.
var<workgroup> sums: array<u32, 64>;

// The number of the tile with this Morton index in a block; NO_BLOCK if there is none.
fn find_tile(block: u32, index: u32) -> u32 {
    var low = blocks[block].first_tile;
    let end = low + blocks[block].tiles;
    var high = end;
    while low < high {
        let middle = (low + high) / 2u;
        if tiles[middle * TILE_WORDS] < index {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    if low < end && tiles[low * TILE_WORDS] == index {
        return low;
    }
    return NO_BLOCK;
}

// The Morton index of a tile, given its coordinates in the block.
fn morton_of(tile: vec3<u32>) -> u32 {
    let spread = (tile & vec3(1u)) | ((tile & vec3(2u)) << vec3(2u)) | ((tile & vec3(4u)) << vec3(4u));
    return spread.x | (spread.y << 1u) | (spread.z << 2u);
}

// Computes the vertex numbers of the upper neighbour in a corner's direction; for corner 0, of the
// tile itself.
fn number_above(tile: u32, block: u32, corner: u32) {
    let at = tile_from_morton(tiles[tile * TILE_WORDS]) + vec3(corner & 1u, (corner >> 1u) & 1u, corner >> 2u);
    let beyond = at / BLOCK_EDGE_TILES;
    let owner = blocks[block].above[beyond.x | (beyond.y << 1u) | (beyond.z << 2u)];
    if owner == NO_BLOCK {
        return;
    }
    let found = find_tile(owner, morton_of(at % BLOCK_EDGE_TILES));
    if found == NO_BLOCK {
        return;
    }
    let corners = corners_at(found);
    var vertex = first_vertex_of(found, owner);
    for (var axis = 0u; axis < 3u; axis++) {
        let crossed = crossed_of(corners, axis);
        crossed_edges[3u * corner + axis] = crossed;
        first_vertices[3u * corner + axis] = vertex;
        vertex += ones(crossed);
    }
}

// The vertex on an edge of the dual cell at `cell`.
fn vertex_on(edge: u32, cell: vec3<u32>) -> u32 {
    let at = cell + vec3(edge & 1u, (edge >> 1u) & 1u, (edge >> 2u) & 1u);
    let beyond = at / TILE;
    let within = at % TILE;
    let table_at = 3u * (beyond.x | (beyond.y << 1u) | (beyond.z << 2u)) + (edge >> 3u);
    let bit = within.x + TILE * (within.y + TILE * within.z);
    return first_vertices[table_at] + ones_below(crossed_edges[table_at], bit);
}

@compute @workgroup_size(64)
fn triangles(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) bit: u32,
) {
    let number = group.x + groups.x * group.y;
    if number >= push.tiles {
        return;
    }
    let tile = push.first_tile + number;
    let start = begins[tile];
    if bit < 8u {
        number_above(tile, start.block, bit);
    }
    let row = CASE_WORDS * case_of(corners_at(tile), bit);
    let count = table[row];
    sums[bit] = count;
    for (var step = 1u; step < 64u; step *= 2u) {
        workgroupBarrier();
        var below = 0u;
        if bit >= step {
            below = sums[bit - step];
        }
        workgroupBarrier();
        sums[bit] += below;
    }
    let cell = vec3(bit % TILE, bit / TILE % TILE, bit / (TILE * TILE));
    let first = start.triangle + sums[bit] - count - push.first_triangle;
    for (var i = 0u; i < count; i++) {
        let edges = table[row + 1u + i];
        let to = push.first_word + 3u * (first + i);
        for (var k = 0u; k < 3u; k++) {
            let edge = (edges >> (EDGE_BITS * k)) & ((1u << EDGE_BITS) - 1u);
            indices[to + k] = vertex_on(edge, cell);
        }
    }
}
