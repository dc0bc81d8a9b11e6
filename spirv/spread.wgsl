//! with block
// One axis of a dilation: the greatest of the taps within reach. Taps beyond a wall read the outermost cell before it.

struct Push {
    // The lowest cell within the walls, and the highest.
    walls_lo: vec3<i32>,
    axis: u32,
    walls_hi: vec3<i32>,
    reach: u32,
    // Cells at the block's faces that are not to be computed.
    margin: vec3<u32>,
}

var<immediate> push: Push;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> samples: array<u32>;
@group(0) @binding(2) var<storage, read_write> greatest: array<u32>;

@compute @workgroup_size(256)
fn spread(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let at = cell_of(block, id.x);
    let low = vec3(at.x + 1u, at.y, at.z) < push.margin;
    let high = at + push.margin >= block.size;
    let cell = block.lo + vec3<i32>(at);
    // Of a pair, one cell inside the walls is enough.
    let below = vec3(cell.x + 1, cell.y, cell.z) < push.walls_lo;
    let above = cell > push.walls_hi;
    if any(low) || any(high) || any(below) || any(above) {
        return;
    }
    let reach = i32(push.reach);
    // The walls along this axis, relative to the block.
    let first = push.walls_lo[push.axis] - block.lo[push.axis];
    let last = push.walls_hi[push.axis] - block.lo[push.axis];
    var most = vec2(0u);
    if push.axis == 0u {
        let row = word_of(block, vec3(0u, at.y, at.z));
        let centre = i32(at.x);
        let end = i32(block.size.x) - 1;
        for (var k = -reach; k <= reach + 1; k++) {
            // Where only one of a pair is computed, the other's outermost tap can lie beyond the block.
            let x = u32(clamp(clamp(centre + k, first, last), 0, end));
            let sample = half_of(samples[row + x / 2u], x);
            if k <= reach {
                most.x = max(most.x, sample);
            }
            if k > -reach {
                most.y = max(most.y, sample);
            }
        }
    } else {
        let centre = i32(at[push.axis]);
        var tap = at;
        for (var k = -reach; k <= reach; k++) {
            tap[push.axis] = u32(clamp(centre + k, first, last));
            let word = samples[word_of(block, tap)];
            most = max(most, vec2(word & 0xffffu, word >> 16u));
        }
    }
    greatest[word_of(block, at)] = most.x | most.y << 16u;
}
