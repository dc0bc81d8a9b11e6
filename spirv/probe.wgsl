//! with block
// Probes the wide cells around each region: whether any cell is inside, whether any cell is
// outside, and the box around the cells near which particles stand out.

struct RegionProbe {
    // The region's lowest wide cell, and the number of the block that contains its cells.
    lo: vec3<i32>,
    block: u32,
    // The number of wide cells along each axis.
    size: vec3<u32>,
    spare: u32,
}

struct ProbeResult {
    // Whether any sample is above the threshold, and whether any sample is at or below the
    // threshold.
    above: u32,
    below: u32,
    // The box around the cells near which particles stand out, relative to the region's lowest wide
    // cell. If there are no such cells, `lo` is greater than `hi`.
    lo: array<u32, 3>,
    hi: array<u32, 3>,
}

struct ProbePush {
    // Samples of the field above this threshold are inside the fluid.
    threshold: u32,
    // Particles stand out where the sample in `outlying` exceeds this number.
    begin: u32,
}

var<immediate> push: ProbePush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> probes: array<RegionProbe>;
@group(0) @binding(2) var<storage, read> bulk: array<u32>;
@group(0) @binding(3) var<storage, read> outlying: array<u32>;
@group(0) @binding(4) var<storage, read_write> results: array<ProbeResult>;

var<workgroup> above: atomic<u32>;
var<workgroup> below: atomic<u32>;
var<workgroup> lowest: array<atomic<u32>, 3>;
var<workgroup> highest: array<atomic<u32>, 3>;

@compute @workgroup_size(256)
fn probe(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    if local.x < 3u {
        atomicStore(&lowest[local.x], 0xffffffffu);
        atomicStore(&highest[local.x], 0u);
    }
    if local.x == 0u {
        atomicStore(&above, 0u);
        atomicStore(&below, 0u);
    }
    workgroupBarrier();
    let region = probes[group.y];
    let block = blocks[region.block];
    let first = vec3<u32>(region.lo - block.lo);
    var any_above = false;
    var any_below = false;
    // One row along x per iteration.
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
        results[group.y].above = atomicLoad(&above);
        results[group.y].below = atomicLoad(&below);
    }
    if local.x < 3u {
        results[group.y].lo[local.x] = atomicLoad(&lowest[local.x]);
        results[group.y].hi[local.x] = atomicLoad(&highest[local.x]);
    }
}
