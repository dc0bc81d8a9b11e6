//! with bin_table
// Counts the particles of a chunk by bin, and stores each particle's slot: one thread per particle.
// A bin's first particle takes a slot for the bin. Two particles are in the same bin if their keys,
// which the shader `place` wrote, are equal.

struct EnterPush {
    // The number of particles in the chunk.
    count: u32,
    // Number of slots minus 1.
    mask: u32,
}

struct Census {
    not_finite: u32,
    too_far: u32,
    outside: u32,
    invalid: u32,
    overflow: atomic<u32>,
}

var<immediate> push: EnterPush;
@group(0) @binding(0) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(1) var<storage, read_write> slots: array<BinSlot>;
@group(0) @binding(2) var<storage, read_write> census: array<Census>;
// The slot of each particle's bin; NO_BIN for a particle without a bin.
@group(0) @binding(3) var<storage, read_write> homes: array<u32>;

fn has_key(owner: u32, at: u32, key: vec2<u32>) -> bool {
    if owner == SETTLED {
        return all(slots[at].key == key);
    }
    return all(keys[owner - 1u] == key);
}

@compute @workgroup_size(256)
fn enter(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= push.count || atomicLoad(&census[0].overflow) != 0u {
        return;
    }
    let key = keys[i];
    homes[i] = NO_BIN;
    if all(key == vec2(NO_BIN)) {
        return;
    }
    var at = first_slot(key, push.mask);
    for (var probe = 0u; probe < PROBES; probe++) {
        var owner = atomicLoad(&slots[at].owner);
        while owner == 0u {
            let taken = atomicCompareExchangeWeak(&slots[at].owner, 0u, i + 1u);
            owner = select(taken.old_value, i + 1u, taken.exchanged);
        }
        if has_key(owner, at, key) {
            atomicAdd(&slots[at].count, 1u);
            homes[i] = at;
            return;
        }
        at = (at + 1u) & push.mask;
    }
    atomicStore(&census[0].overflow, 1u);
}
