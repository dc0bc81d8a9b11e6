//! with tally scan
// Computes where the tiles, vertices and triangles of each block start in the batch: an exclusive
// prefix sum by one work group. The last entry has the totals. The number of tiles determines the
// number of work groups that write tiles.

struct BasesPush {
    // The number of blocks in the batch.
    blocks: u32,
    // The number of vertices for which there is memory.
    room: u32,
    // Maximum number of work groups in a row of `groups`.
    width: u32,
}

var<immediate> push: BasesPush;
@group(0) @binding(0) var<storage, read_write> tallies: array<BlockTally>;
// The number of work groups that write tiles, one per tile, in rows; 0 if the vertices do not fit.
@group(0) @binding(1) var<storage, read_write> groups: array<u32, 3>;

@compute @workgroup_size(256)
fn bases(@builtin(local_invocation_id) local: vec3<u32>) {
    let i = local.x;
    let share = (push.blocks + GROUP - 1u) / GROUP;
    let first = min(i * share, push.blocks);
    let end = min(first + share, push.blocks);
    var own = vec3(0u);
    for (var block = first; block < end; block++) {
        own += vec3(tallies[block].tiles, tallies[block].vertices, tallies[block].triangles);
    }
    var at = scanned(i, own) - own;
    for (var block = first; block < end; block++) {
        let tally = tallies[block];
        tallies[block] = tally_of(at);
        at += vec3(tally.tiles, tally.vertices, tally.triangles);
    }
    if i == GROUP - 1u {
        tallies[push.blocks] = tally_of(at);
        let count = select(at.x, 0u, at.y > push.room);
        groups[0] = min(count, push.width);
        groups[1] = (count + push.width - 1u) / push.width;
        groups[2] = 1u;
    }
}
