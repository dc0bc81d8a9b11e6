//! with block mirror
// Interpolates a field of wide cells at the middles of cells. The samples of wide cells are the
// control points of a quadratic B-spline, and are mirrored at walls.

struct RefinePush {
    // The planes at which wide cells are mirrored, in halves of a wide cell.
    mirror_lo: vec3<i32>,
    // A wide cell is 2^level cells along an axis.
    level: u32,
    mirror_hi: vec3<i32>,
}

var<immediate> push: RefinePush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
// The blocks of wide cells, and for each block of cells, the number of the block of wide cells that
// contains it.
@group(0) @binding(1) var<storage, read> wide_blocks: array<Block>;
@group(0) @binding(2) var<storage, read> within: array<u32>;
@group(0) @binding(3) var<storage, read> wide: array<u32>;
@group(0) @binding(4) var<storage, read_write> field: array<u32>;

// Maximum number of planes of wide cells that a thread reads. The thread computes RUN pairs of
// cells along z, and each pair needs the planes of wide cells below, at and above the pair.
const PLANES: u32 = RUN + 2u;

fn mean(weights: vec3<u32>, taps: vec3<u32>) -> u32 {
    let bits = 2u * push.level + 3u;
    return (dot(weights, taps) + (1u << (bits - 1u))) >> bits;
}

fn weights_of(cell: i32) -> vec3<u32> {
    if push.level == 0u {
        return vec3(0u, 8u, 0u);
    }
    let edge = 2u << push.level;
    let at = 2u * (u32(cell) & ((1u << push.level) - 1u)) + 1u;
    let below = (edge - at) * (edge - at);
    let above = at * at;
    return vec3(below, 2u * edge * edge - below - above, above);
}

// The index of a wide cell along an axis of a block. A cell beyond the block is replaced by the
// block's outermost cell. Such cells affect only results that are not used.
fn wide_place(block: Block, axis: u32, cell: i32) -> u32 {
    let source = source_of(cell, push.mirror_lo[axis], push.mirror_hi[axis]);
    return u32(clamp(source - block.lo[axis], 0, i32(block.size[axis]) - 1));
}

// Three wide cells along x, from the words of their row.
fn row_of(begin: u32, x: vec3<u32>) -> vec3<u32> {
    return vec3(
        half_of(wide[begin + x.x / 2u], x.x),
        half_of(wide[begin + x.y / 2u], x.y),
        half_of(wide[begin + x.z / 2u], x.z),
    );
}

@compute @workgroup_size(256)
fn refine(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let width = block.size.x / 2u;
    let row = id.x / width;
    var at = vec3(2u * (id.x % width), row % block.size.y, RUN * (row / block.size.y));
    if at.z >= block.size.z {
        return;
    }
    let around = wide_blocks[within[id.y]];
    let cell = block.lo + vec3<i32>(at);
    let x_weights = array(weights_of(cell.x), weights_of(cell.x + 1));
    let y_weights = weights_of(cell.y);
    var columns: array<vec3<u32>, 2>;
    for (var i = 0; i < 3; i++) {
        columns[0][i] = wide_place(around, 0u, (cell.x >> push.level) + i - 1);
        columns[1][i] = wide_place(around, 0u, ((cell.x + 1) >> push.level) + i - 1);
    }
    let same = all(columns[0] == columns[1]);
    var rows: vec3<u32>;
    for (var i = 0; i < 3; i++) {
        rows[i] = around.size.x / 2u * wide_place(around, 1u, (cell.y >> push.level) + i - 1);
    }
    // The interpolated samples of both cells of the pair, in each plane of wide cells that the run
    // needs.
    let lowest = (cell.z >> push.level) - 1;
    let highest = (cell.z + i32(RUN) - 1) >> push.level;
    var planes: array<vec2<u32>, PLANES>;
    for (var k = 0u; i32(k) <= highest + 1 - lowest; k++) {
        let plane = around.size.x / 2u * around.size.y * wide_place(around, 2u, lowest + i32(k));
        var first = vec3(0u);
        var second = vec3(0u);
        for (var j = 0; j < 3; j++) {
            let begin = around.field + rows[j] + plane;
            let taps = row_of(begin, columns[0]);
            first[j] = mean(x_weights[0], taps);
            if same {
                second[j] = mean(x_weights[1], taps);
            } else {
                second[j] = mean(x_weights[1], row_of(begin, columns[1]));
            }
        }
        planes[k] = vec2(mean(y_weights, first), mean(y_weights, second));
    }
    for (var i = 0u; i < RUN && at.z < block.size.z; i++) {
        let z = block.lo.z + i32(at.z);
        let k = u32((z >> push.level) - 1 - lowest);
        let weights = weights_of(z);
        let a = mean(weights, vec3(planes[k].x, planes[k + 1u].x, planes[k + 2u].x));
        let b = mean(weights, vec3(planes[k].y, planes[k + 1u].y, planes[k + 2u].y));
        field[word_of(block, at)] = a | b << 16u;
        at.z++;
    }
}
