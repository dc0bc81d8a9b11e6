//! with bin_table
// Writes the keys of the bins into the slots that a chunk took, before the next chunk: one thread
// per slot.

struct SettlePush {
    slots: u32,
}

var<immediate> push: SettlePush;
@group(0) @binding(0) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(1) var<storage, read_write> slots: array<BinSlot>;

@compute @workgroup_size(256)
fn settle(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let at = id.x + 256u * groups.x * id.y;
    if at >= push.slots {
        return;
    }
    let owner = atomicLoad(&slots[at].owner);
    if owner != 0u && owner != SETTLED {
        slots[at].key = keys[owner - 1u];
        atomicStore(&slots[at].owner, SETTLED);
    }
}
