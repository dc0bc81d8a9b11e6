//! with wide float64 grid tile surface
// Computes the positions of the vertices (eq. 8) with the host's f64 arithmetic, and rounds them to
// f32: one work group per tile, one thread per cell.

struct VerticesPush {
    // The number of the first tile.
    first_tile: u32,
    tiles: u32,
    // The number of the first vertex to write, and the number of words in the buffer before it.
    first_vertex: u32,
    first_word: u32,
    // The greatest sample that counts as outside the fluid.
    threshold: u32,
}

var<immediate> push: VerticesPush;
@group(0) @binding(0) var<storage, read> grid: Grid;
@group(0) @binding(1) var<storage, read> blocks: array<Block>;
@group(0) @binding(2) var<storage, read> tiles: array<u32>;
@group(0) @binding(3) var<storage, read> begins: array<Start>;
// For each vertex, the samples at the lower and the upper end of its edge.
@group(0) @binding(4) var<storage, read> ends: array<u32>;
// The positions, as the bits of f32, because a device may flush subnormal f32 to 0.
@group(0) @binding(5) var<storage, read_write> positions: array<u32>;

// The position of a vertex along its edge. If both samples are equal, they belong to a cell and its
// mirror image beyond a wall, and the vertex is halfway between the two.
fn fraction(samples: u32) -> vec2<u32> {
    let lower = i32(samples & 0xffffu);
    let upper = i32(samples >> 16u);
    if lower == upper {
        return f64_half(1);
    }
    return f64_ratio(u32(abs(2 * i32(push.threshold) + 1 - 2 * lower)), u32(2 * abs(upper - lower)));
}

fn write(vertex: u32, cell: vec3<i32>, axis: u32) {
    let along = fraction(ends[vertex]);
    let to = push.first_word + 3u * (vertex - push.first_vertex);
    for (var k = 0u; k < 3u; k++) {
        var cells = f64_half(2 * cell[k] + 1);
        if k == axis {
            cells = f64_add(cells, along);
        }
        var world = f64_add(grid.origin[k], f64_mul(grid.cell, cells));
        if grid.walled != 0u {
            if k == axis && cell[k] < grid.lo[k] {
                world = grid.walls_lo[k];
            } else if k == axis && cell[k] == grid.hi[k] {
                world = grid.walls_hi[k];
            }
            world = f64_min(f64_max(world, grid.walls_lo[k]), grid.walls_hi[k]);
        }
        positions[to + k] = f32_from_f64(world);
    }
}

@compute @workgroup_size(64)
fn vertices(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) bit: u32,
) {
    let number = group.x + groups.x * group.y;
    if number >= push.tiles {
        return;
    }
    let tile = push.first_tile + number;
    let block = begins[tile].block;
    let corners = corners_at(tile);
    let corner = blocks[block].coord * BLOCK + vec3<i32>(tile_from_morton(tiles[tile * TILE_WORDS]) * TILE);
    let cell = corner + vec3<i32>(vec3(bit % TILE, bit / TILE % TILE, bit / (TILE * TILE)));
    var vertex = first_vertex_of(tile, block);
    for (var axis = 0u; axis < 3u; axis++) {
        let crossed = crossed_of(corners, axis);
        if bit_of(crossed, bit) == 1u {
            write(vertex + ones_below(crossed, bit), cell, axis);
        }
        vertex += ones(crossed);
    }
}
