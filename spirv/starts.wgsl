//! with tile surface
// Computes the number of the first triangle of every tile: one work group per block, with a prefix
// sum over the block's tiles.

struct StartsPush {
    blocks: u32,
}

var<immediate> push: StartsPush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
// For each case: the number of triangles, followed by the edges on which their vertices lie.
@group(0) @binding(2) var<storage, read> table: array<u32>;
@group(0) @binding(3) var<storage, read_write> begins: array<Start>;

const GROUP: u32 = 256u;
var<workgroup> sums: array<u32, GROUP>;

fn triangles_of(tile: u32) -> u32 {
    let corners = corners_at(tile);
    let mixed = mixed_of(corners);
    var triangles = 0u;
    for (var bit = 0u; bit < 64u; bit++) {
        if bit_of(mixed, bit) == 1u {
            triangles += table[CASE_WORDS * case_of(corners, bit)];
        }
    }
    return triangles;
}

@compute @workgroup_size(256)
fn starts(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) i: u32,
) {
    let number = group.x + groups.x * group.y;
    if number >= push.blocks {
        return;
    }
    let block = blocks[number];
    var one = 0u;
    var two = 0u;
    if 2u * i < block.tiles {
        one = triangles_of(block.first_tile + 2u * i);
    }
    if 2u * i + 1u < block.tiles {
        two = triangles_of(block.first_tile + 2u * i + 1u);
    }
    sums[i] = one + two;
    for (var step = 1u; step < GROUP; step *= 2u) {
        workgroupBarrier();
        var below = 0u;
        if i >= step {
            below = sums[i - step];
        }
        workgroupBarrier();
        sums[i] += below;
    }
    let middle = block.first_triangle + sums[i] - two;
    if 2u * i < block.tiles {
        begins[block.first_tile + 2u * i] = Start(number, middle - one);
    }
    if 2u * i + 1u < block.tiles {
        begins[block.first_tile + 2u * i + 1u] = Start(number, middle);
    }
}
