//! with wide float64 grid placing table
// Packs the particles of a chunk and drops each into its bin's place, if the bin is of this run: a particle a thread.

struct Push {
    // Words before the chunk's first coordinate.
    first: u32,
    // Particles of the chunk.
    count: u32,
    // Words of a coordinate: 1 for f32, 2 for f64.
    width: u32,
    // Slots less one.
    mask: u32,
}

var<immediate> push: Push;
@group(0) @binding(0) var<storage, read> grid: Grid;
@group(0) @binding(1) var<storage, read> positions: array<u32>;
@group(0) @binding(2) var<storage, read_write> slots: array<Slot>;
// Where the next particle of each slot's bin goes; ELSEWHERE where the bin is of another run.
@group(0) @binding(3) var<storage, read_write> places: array<atomic<u32>>;
@group(0) @binding(4) var<storage, read_write> records: array<vec2<u32>>;

// Per axis, from x on, the offset in the cell and then the cell in the bin.
fn packed(placed: Placed) -> vec2<u32> {
    let axis = (vec3<u32>(placed.cell & vec3(BIN - 1)) << vec3(FRACTION_BITS)) | placed.offset;
    return vec2(
        axis.x | (axis.y << AXIS_BITS),
        (axis.y >> (32u - AXIS_BITS)) | (axis.z << (2u * AXIS_BITS - 32u)),
    );
}

@compute @workgroup_size(256)
fn sort(@builtin(global_invocation_id) id: vec3<u32>) {
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
    if atomicLoad(&places[at]) != ELSEWHERE {
        let to = atomicAdd(&places[at], 1u);
        // Positions that someone changes between the readings must not reach beyond the buffer.
        if to < arrayLength(&records) {
            records[to] = packed(placed);
        }
    }
}
