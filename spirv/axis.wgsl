// One axis of a separable operation: what a file's own `with_taps` makes of the cells within reach. Taps beyond a wall
// read the outermost cell before it.

struct Push {
    // The lowest cell within the walls, and the highest.
    walls_lo: vec3<i32>,
    axis: u32,
    walls_hi: vec3<i32>,
    reach: u32,
    // Cells at the block's faces that are not to be computed.
    margin: vec3<u32>,
    // Bits that sums are shifted down by, where there are any.
    shift: u32,
}

var<immediate> push: Push;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> samples: array<u32>;

// Whether either of the pair of cells at `at` is to be computed.
fn is_wanted(block: Block, at: vec3<u32>) -> bool {
    let low = vec3(at.x + 1u, at.y, at.z) < push.margin;
    let high = at + push.margin >= block.size;
    let cell = block.lo + vec3<i32>(at);
    // Of a pair, one cell inside the walls is enough.
    let below = vec3(cell.x + 1, cell.y, cell.z) < push.walls_lo;
    let above = cell > push.walls_hi;
    return !(any(low) || any(high) || any(below) || any(above));
}

// `all` with the taps of both cells of the pair at `at`, from the farthest below to the farthest above.
fn with_all_taps(all: vec2<u32>, block: Block, at: vec3<u32>) -> vec2<u32> {
    var so_far = all;
    let reach = i32(push.reach);
    // The walls along this axis, relative to the block.
    let first = push.walls_lo[push.axis] - block.lo[push.axis];
    let last = push.walls_hi[push.axis] - block.lo[push.axis];
    let centre = i32(at[push.axis]);
    if push.axis == 0u {
        let row = word_of(block, vec3(0u, at.y, at.z));
        let end = i32(block.size.x) - 1;
        var taps = vec2(0u);
        for (var k = -reach - 1; k <= reach; k++) {
            // Where only one of a pair is computed, the other's outermost tap can lie beyond the block.
            let x = u32(clamp(clamp(centre + k + 1, first, last), 0, end));
            taps = vec2(taps.y, half_of(samples[row + x / 2u], x));
            if k >= -reach {
                so_far = with_taps(so_far, k, taps);
            }
        }
    } else {
        var tap = at;
        for (var k = -reach; k <= reach; k++) {
            tap[push.axis] = u32(clamp(centre + k, first, last));
            let word = samples[word_of(block, tap)];
            so_far = with_taps(so_far, k, vec2(word & 0xffffu, word >> 16u));
        }
    }
    return so_far;
}
