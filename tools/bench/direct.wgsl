//! with wide float64 grid placing table
// Adds every particle of a chunk directly to the sums of its cell in device memory. A cell has 7
// words: the number of particles, the low words of the sums of x, y and z, and their high words.

struct Push {
    first: u32,
    count: u32,
    width: u32,
    mask: u32,
}

var<immediate> push: Push;
@group(0) @binding(0) var<storage, read> grid: Grid;
@group(0) @binding(1) var<storage, read> positions: array<u32>;
@group(0) @binding(2) var<storage, read_write> slots: array<Slot>;
// For each slot of the hash table, the number of its bin.
@group(0) @binding(3) var<storage, read> bins: array<u32>;
@group(0) @binding(4) var<storage, read_write> sums: array<atomic<u32>>;

@compute @workgroup_size(256)
fn direct(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= push.count {
        return;
    }
    let placed = place_particle(id.x);
    if placed.fate != BINNED {
        return;
    }
    let key = bin_of(placed.cell);
    var at = first_slot(key, push.mask);
    for (var probe = 0u; probe < PROBES && any(slots[at].key != key); probe++) {
        at = (at + 1u) & push.mask;
    }
    let local = vec3<u32>(placed.cell & vec3(BIN - 1));
    let edge = u32(BIN);
    let cell = 7u * (local.x + edge * (local.y + edge * (local.z + edge * bins[at])));
    atomicAdd(&sums[cell], 1u);
    for (var axis = 0u; axis < 3u; axis++) {
        let before = atomicAdd(&sums[cell + 1u + axis], placed.offset[axis]);
        if before + placed.offset[axis] < before {
            atomicAdd(&sums[cell + 4u + axis], 1u);
        }
    }
}
