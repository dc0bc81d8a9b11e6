// Moves each packed particle of a chunk to its bin, if the bin belongs to this run (the bins that
// are sorted together): one thread per particle.

struct SortPush {
    // The number of particles in the chunk.
    count: u32,
}

var<immediate> push: SortPush;
@group(0) @binding(0) var<storage, read> packed: array<vec2<u32>>;
// The slot of each particle's bin; NO_BIN for a particle without a bin.
@group(0) @binding(1) var<storage, read> homes: array<u32>;
// The position of the next particle of each slot's bin; ELSEWHERE if the bin belongs to another
// run.
@group(0) @binding(2) var<storage, read_write> places: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> records: array<vec2<u32>>;

@compute @workgroup_size(256)
fn sort(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= push.count {
        return;
    }
    let home = homes[id.x];
    if home != NO_BIN && atomicLoad(&places[home]) != ELSEWHERE {
        records[atomicAdd(&places[home], 1u)] = packed[id.x];
    }
}
