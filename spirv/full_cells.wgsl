//! with block brick
// Finds the full cells of each page's bin, for the host. One work group per page, one thread per
// row along x.

struct Full {
    // For each axis, a bit for each layer of cells perpendicular to the axis: whether the layer has
    // a full cell.
    layers: array<u32, 3>,
    // The number of full cells.
    count: u32,
    // A bit for each brick: whether the brick, without its ghost layer, has a full cell.
    bricks: array<u32, 2>,
}

struct FullCellsPush {
    // The number of low bits of a cell's coordinate within its piece. A piece is a brick or, if
    // there are no ghost layers, a bin. A piece is stored contiguously.
    piece_bits: u32,
    // The width of the ghost layer around each piece.
    ghost_layer: u32,
    // The number of low bits of a cell's coordinate within its brick.
    brick_bits: u32,
    page_words: u32,
}

var<immediate> push: FullCellsPush;
// The pages. A page has its pieces in the order of the Morton curve, and x varies fastest in each
// piece.
@group(0) @binding(0) var<storage, read> pages: array<u32>;
@group(0) @binding(1) var<storage, read_write> found: array<Full>;

var<workgroup> layers: array<atomic<u32>, 3>;
var<workgroup> count: atomic<u32>;
var<workgroup> bricks: array<atomic<u32>, 2>;

@compute @workgroup_size(256)
fn full_cells(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    if local.x < 3u {
        atomicStore(&layers[local.x], 0u);
    }
    if local.x < 2u {
        atomicStore(&bricks[local.x], 0u);
    }
    if local.x == 0u {
        atomicStore(&count, 0u);
    }
    workgroupBarrier();
    let bin = u32(BIN);
    let ghost_layer = i32(push.ghost_layer);
    let side = 1u << push.piece_bits;
    let edge = side + 2u * push.ghost_layer;
    let cell = vec2<i32>(vec2(local.x % bin, local.x / bin));
    let first = max(cell - ghost_layer, vec2(0)) >> vec2(push.piece_bits);
    let last = min(cell + ghost_layer, vec2(BIN - 1)) >> vec2(push.piece_bits);
    var bits = 0u;
    for (var z = first.y; z <= last.y; z++) {
        for (var y = first.x; y <= last.x; y++) {
            for (var x = 0u; x < bin / side; x++) {
                let corner = vec3(x, u32(y), u32(z)) << vec3(push.piece_bits);
                let number = brick_of(corner, push.piece_bits);
                let inside = vec2<u32>(cell - vec2<i32>(corner.yz) + ghost_layer);
                let row = edge * (inside.x + edge * (inside.y + edge * number));
                let owns_row = all(inside >= vec2(push.ghost_layer)) && all(inside < vec2(push.ghost_layer + side));
                for (var i = 0u; i < edge; i++) {
                    let at = i32(corner.x + i) - ghost_layer;
                    let word = pages[group.y * push.page_words + (row + i) / 2u];
                    if at < 0 || at >= BIN || half_of(word, row + i) == 0u {
                        continue;
                    }
                    bits |= 1u << u32(at);
                    if owns_row && i >= push.ghost_layer && i < push.ghost_layer + side {
                        let brick = brick_of(vec3(u32(at), vec2<u32>(cell)), push.brick_bits);
                        atomicOr(&bricks[brick / 32u], 1u << (brick % 32u));
                    }
                }
            }
        }
    }
    if bits != 0u {
        atomicOr(&layers[0], bits);
        atomicOr(&layers[1], 1u << u32(cell.x));
        atomicOr(&layers[2], 1u << u32(cell.y));
        atomicAdd(&count, countOneBits(bits));
    }
    workgroupBarrier();
    if local.x < 3u {
        found[group.y].layers[local.x] = atomicLoad(&layers[local.x]);
    }
    if local.x < 2u {
        found[group.y].bricks[local.x] = atomicLoad(&bricks[local.x]);
    }
    if local.x == 0u {
        found[group.y].count = atomicLoad(&count);
    }
}
