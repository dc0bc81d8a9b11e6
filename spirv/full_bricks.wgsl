//! with block brick
// Finds the full bricks of a bin of wide cells. A brick is full if the samples in every cube that
// overlaps the brick have a sufficient sum. One work group per bin. The block of a bin has a margin
// of cells for the cubes.

struct FullBricksPush {
    // The edge of the cubes, in parts. The edge of a part is two cells.
    width: u32,
    // The minimum sum of a cube.
    least: u32,
}

var<immediate> push: FullBricksPush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> field: array<u32>;
// A bit for each brick, by its Morton index in the bin.
@group(0) @binding(2) var<storage, read_write> bricks: array<vec2<u32>>;

// Sums of the parts of the bin and its margin, x fastest.
var<workgroup> sums: array<u32, CUBE_PARTS>;
// A bit for each cube, by its lowest part: whether the cube's sum is sufficient.
var<workgroup> full: array<atomic<u32>, CUBE_WORDS>;
var<workgroup> mask: array<atomic<u32>, 2>;

fn place(i: u32, edge: u32) -> vec3<u32> {
    return vec3(i % edge, i / edge % edge, i / (edge * edge));
}

fn index(at: vec3<u32>, edge: u32) -> u32 {
    return at.x + edge * (at.y + edge * at.z);
}

@compute @workgroup_size(256)
fn full_bricks(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    if local.x < 2u {
        atomicStore(&mask[local.x], 0u);
    }
    for (var i = local.x; i < CUBE_WORDS; i += 256u) {
        atomicStore(&full[i], 0u);
    }
    let block = blocks[group.y];
    let parts = block.size.y / 2u;
    for (var i = local.x; i < parts * parts * parts; i += 256u) {
        var sum = 0u;
        for (var row = 0u; row < 4u; row++) {
            let word = field[word_of(block, 2u * place(i, parts) + vec3(0u, row & 1u, row >> 1u))];
            sum += (word & 0xffffu) + (word >> 16u);
        }
        sums[i] = sum;
    }
    workgroupBarrier();
    let cubes = parts + 1u - push.width;
    for (var i = local.x; i < cubes * cubes * cubes; i += 256u) {
        let first = place(i, cubes);
        var sum = 0u;
        for (var k = 0u; k < push.width * push.width * push.width; k++) {
            sum += sums[index(first + place(k, push.width), parts)];
        }
        if sum >= push.least {
            atomicOr(&full[i / 32u], 1u << (i % 32u));
        }
    }
    workgroupBarrier();
    // A brick has two parts along each axis.
    let side = u32(BIN) >> INSIDE_BITS;
    let touching = push.width + 1u;
    if local.x < side * side * side {
        let brick = place(local.x, side);
        var all_full = true;
        for (var k = 0u; k < touching * touching * touching; k++) {
            let cube = index(2u * brick + place(k, touching), cubes);
            all_full = all_full && (atomicLoad(&full[cube / 32u]) >> (cube % 32u) & 1u) != 0u;
        }
        if all_full {
            let bit = brick_of(brick << vec3(INSIDE_BITS), INSIDE_BITS);
            atomicOr(&mask[bit / 32u], 1u << (bit % 32u));
        }
    }
    workgroupBarrier();
    if local.x == 0u {
        bricks[group.y] = vec2(atomicLoad(&mask[0]), atomicLoad(&mask[1]));
    }
}
