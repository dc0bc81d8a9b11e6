//! with tally scan
// Where the tiles, vertices and triangles of each block begin among those of the batch: an exclusive prefix sum by one
// work group. The last entry holds the totals.

struct Push {
    // Blocks of the batch.
    blocks: u32,
}

var<immediate> push: Push;
@group(0) @binding(0) var<storage, read_write> tallies: array<Tally>;

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
    }
}
