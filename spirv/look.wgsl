//! with block
// What can be seen of the wide cells around each region: whether any are inside and any are not, and the box around those near which
// particles stand out.

struct Look {
    // The lowest of its wide cells, and the number of the block that they lie in.
    lo: vec3<i32>,
    block: u32,
    // How many there are along each axis.
    size: vec3<u32>,
    spare: u32,
}

struct Seen {
    // Whether any sample is above the threshold, and any not.
    above: u32,
    below: u32,
    // From the lowest wide cell of the region on; `lo` is greater than `hi` where there is none.
    lo: array<u32, 3>,
    hi: array<u32, 3>,
}

struct LookPush {
    // Of the field, above which is the inside.
    threshold: u32,
    // From which sample on particles stand out.
    begin: u32,
}

var<immediate> push: LookPush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> looks: array<Look>;
@group(0) @binding(2) var<storage, read> bulk: array<u32>;
@group(0) @binding(3) var<storage, read> outlying: array<u32>;
@group(0) @binding(4) var<storage, read_write> seen: array<Seen>;

var<workgroup> above: atomic<u32>;
var<workgroup> below: atomic<u32>;
var<workgroup> lowest: array<atomic<u32>, 3>;
var<workgroup> highest: array<atomic<u32>, 3>;

@compute @workgroup_size(256)
fn look(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    if local.x < 3u {
        atomicStore(&lowest[local.x], 0xffffffffu);
        atomicStore(&highest[local.x], 0u);
    }
    if local.x == 0u {
        atomicStore(&above, 0u);
        atomicStore(&below, 0u);
    }
    workgroupBarrier();
    let region = looks[group.y];
    let block = blocks[region.block];
    let first = vec3<u32>(region.lo - block.lo);
    var any_above = false;
    var any_below = false;
    // A row along x at a time.
    for (var row = local.x; row < region.size.y * region.size.z; row += 256u) {
        let at = vec3(0u, row % region.size.y, row / region.size.y);
        let begin = word_of(block, vec3(0u, first.yz + at.yz));
        for (var x = 0u; x < region.size.x; x++) {
            let sample = half_of(bulk[begin + (first.x + x) / 2u], first.x + x);
            any_above = any_above || sample > push.threshold;
            any_below = any_below || sample <= push.threshold;
            if half_of(outlying[begin + (first.x + x) / 2u], first.x + x) > push.begin {
                atomicMin(&lowest[0], x);
                atomicMax(&highest[0], x);
                atomicMin(&lowest[1], at.y);
                atomicMax(&highest[1], at.y);
                atomicMin(&lowest[2], at.z);
                atomicMax(&highest[2], at.z);
            }
        }
    }
    if any_above {
        atomicStore(&above, 1u);
    }
    if any_below {
        atomicStore(&below, 1u);
    }
    workgroupBarrier();
    if local.x == 0u {
        seen[group.y].above = atomicLoad(&above);
        seen[group.y].below = atomicLoad(&below);
    }
    if local.x < 3u {
        seen[group.y].lo[local.x] = atomicLoad(&lowest[local.x]);
        seen[group.y].hi[local.x] = atomicLoad(&highest[local.x]);
    }
}
