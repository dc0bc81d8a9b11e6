//! with wide float64 grid placing
// Computes the bin and the record of every particle of a chunk, and counts the particles without a
// bin: one thread per particle.

struct PlacePush {
    // The number of words in the buffer before the chunk's first coordinate.
    first: u32,
    // The number of particles in the chunk.
    count: u32,
    // The number of words in a coordinate: 1 for f32, 2 for f64.
    width: u32,
    // The chunk's number.
    chunk: u32,
}

struct Census {
    not_finite: atomic<u32>,
    too_far: atomic<u32>,
    outside: atomic<u32>,
    // `count` minus the index of the chunk's first invalid particle; 0 if there is none.
    invalid: atomic<u32>,
    // Whether the table of bins was too small; used only in the census of the first chunk.
    overflow: atomic<u32>,
}

var<immediate> push: PlacePush;
@group(0) @binding(0) var<storage, read> grid: Grid;
@group(0) @binding(1) var<storage, read> positions: array<u32>;
@group(0) @binding(2) var<storage, read_write> keys: array<vec2<u32>>;
// Packed particles.
@group(0) @binding(3) var<storage, read_write> packed: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> census: array<Census>;

// The number of particles with each fate. The entry for binned particles has another use: it is the
// work group's maximum for `invalid`.
var<workgroup> tally: array<atomic<u32>, 4>;

// Packs a particle. From the lowest bit on, the record has, for x, y and z in this order, the
// offset in the cell and then the cell in the bin.
fn record_of(placed: Placed) -> vec2<u32> {
    let axis = (vec3<u32>(placed.cell & vec3(BIN - 1)) << vec3(FRACTION_BITS)) | placed.offset;
    return vec2(
        axis.x | (axis.y << AXIS_BITS),
        (axis.y >> (32u - AXIS_BITS)) | (axis.z << (2u * AXIS_BITS - 32u)),
    );
}

@compute @workgroup_size(256)
fn place(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let i = id.x;
    if local < 4u {
        atomicStore(&tally[local], 0u);
    }
    workgroupBarrier();
    if i < push.count {
        let placed = place_particle(i);
        keys[i] = select(vec2(NO_BIN), bin_of(placed.cell), placed.fate == BINNED);
        packed[i] = record_of(placed);
        if placed.fate != BINNED {
            atomicAdd(&tally[placed.fate], 1u);
        }
        if placed.fate == NOT_FINITE || placed.fate == TOO_FAR {
            atomicMax(&tally[BINNED], push.count - i);
        }
    }
    workgroupBarrier();
    if local != 0u {
        return;
    }
    if atomicLoad(&tally[OUTSIDE]) != 0u {
        atomicAdd(&census[push.chunk].outside, atomicLoad(&tally[OUTSIDE]));
    }
    if atomicLoad(&tally[BINNED]) != 0u {
        atomicAdd(&census[push.chunk].not_finite, atomicLoad(&tally[NOT_FINITE]));
        atomicAdd(&census[push.chunk].too_far, atomicLoad(&tally[TOO_FAR]));
        atomicMax(&census[push.chunk].invalid, atomicLoad(&tally[BINNED]));
    }
}
