//! with binned brick
// The discrete indicator function of clouds; each work group computes a part of a bin's samples.
// Atomic sums in shared memory add up the contributions of the particles. A particle contributes
// only to the brick of its cell, including the brick's ghost layer.

struct CloudsPush {
    // The lowest cell within the walls, and the highest.
    walls_lo: vec3<i32>,
    // The total contribution of a particle to the DIF.
    amount: u32,
    walls_hi: vec3<i32>,
    // The number of low bits of a cell's coordinate within its brick.
    brick_bits: u32,
    // The gains of the outermost layers at the lower walls, and at the upper walls.
    gains_lo: vec3<u32>,
    // Samples per work group.
    group_samples: u32,
    gains_hi: vec3<u32>,
    page_words: u32,
}

var<immediate> push: CloudsPush;
@group(0) @binding(0) var<storage, read> bins: array<Bin>;
@group(0) @binding(1) var<storage, read> records: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> pages: array<u32>;

var<workgroup> sums: array<atomic<u32>, CLOUD_SAMPLES>;

// If a sum has reached this limit, further values are subtracted again, which prevents an overflow
// of 32 bits. The result is 65535 in any case.
const ENOUGH: u32 = 1u << 31u;

fn add(at: u32, value: u32) {
    if atomicAdd(&sums[at], value) >= ENOUGH {
        atomicSub(&sums[at], value);
    }
}

// The shares of a cloud in the cell below, in the particle's own cell, and in the cell above. A
// share beyond a wall is added to the share of the particle's own cell.
fn shares(offset: u32, at_lo: bool, at_hi: bool) -> array<u32, 3> {
    let twice = 2u * offset + 1u;
    let rest = (2u << FRACTION_BITS) - twice;
    let half_square = vec2(rest * rest, twice * twice) >> vec2(SQUARE_BITS);
    let kept = select(half_square, vec2(0u), vec2(at_lo, at_hi));
    return array(kept.x, (1u << SHARE_BITS) - kept.x - kept.y, kept.y);
}

fn part_of(amount: u32, share: u32) -> u32 {
    return (amount * share + (1u << (SHARE_BITS - 1u))) >> SHARE_BITS;
}

// A part of a cloud, multiplied by a gain, and rounded.
fn raised(part: u32, gain: u32) -> u32 {
    return min((part * gain + (1u << (GAIN_BITS - 1u))) >> GAIN_BITS, FULL);
}

// The gain of a cell: the product of the gains along the axes, rounded down after each
// multiplication.
fn gain_of(cell: vec3<i32>) -> u32 {
    let upper = select(vec3(1u << GAIN_BITS), push.gains_hi, cell == push.walls_hi);
    let gains = select(upper, push.gains_lo, cell == push.walls_lo);
    return (((gains.z * gains.y) >> GAIN_BITS) * gains.x) >> GAIN_BITS;
}

@compute @workgroup_size(256)
fn clouds(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    for (var i = local.x; i < push.group_samples; i += 256u) {
        atomicStore(&sums[i], 0u);
    }
    workgroupBarrier();
    let edge = (1u << push.brick_bits) + 2u * GHOST_LAYER;
    let begin = group.x * push.group_samples;
    let bin = bins[group.y];
    // Clouds reach one cell beyond the bin.
    let lowest_around = vec3(bin.x, bin.y, bin.z) * BIN - 1;
    let is_at_wall = any(lowest_around <= push.walls_lo)
        || any(lowest_around + BIN + 1 >= push.walls_hi);
    for (var i = local.x; i < bin.count; i += 256u) {
        let place = place_of(records[bin.first + i]);
        let cell = place >> vec3(FRACTION_BITS);
        let offset = place & vec3((1u << FRACTION_BITS) - 1u);
        let inside = cell & vec3((1u << push.brick_bits) - 1u);
        let brick = brick_of(cell, push.brick_bits);
        let lowest = inside.x + edge * (inside.y + edge * (inside.z + edge * brick));
        if lowest >= begin + push.group_samples || lowest + 2u * (1u + edge + edge * edge) < begin {
            continue;
        }
        let at = vec3<i32>(cell) + vec3(bin.x, bin.y, bin.z) * BIN;
        let at_lo = at == push.walls_lo;
        let at_hi = at == push.walls_hi;
        let x_shares = shares(offset.x, at_lo.x, at_hi.x);
        let y_shares = shares(offset.y, at_lo.y, at_hi.y);
        let z_shares = shares(offset.z, at_lo.z, at_hi.z);
        for (var z = 0u; z < 3u; z++) {
            let in_slab = part_of(push.amount, z_shares[z]);
            for (var y = 0u; y < 3u; y++) {
                let in_row = part_of(in_slab, y_shares[y]);
                for (var x = 0u; x < 3u; x++) {
                    // If the cell is below the part, the subtraction wraps around to a large
                    // number.
                    let to = lowest + x + edge * (y + edge * z) - begin;
                    if to < push.group_samples {
                        var part = part_of(in_row, x_shares[x]);
                        if is_at_wall {
                            part = raised(part, gain_of(at + vec3<i32>(vec3(x, y, z)) - 1));
                        }
                        add(to, part);
                    }
                }
            }
        }
    }
    workgroupBarrier();
    let words = push.group_samples / 2u;
    for (var word = local.x; word < words; word += 256u) {
        let low = min(atomicLoad(&sums[2u * word]), FULL);
        let high = min(atomicLoad(&sums[2u * word + 1u]), FULL);
        pages[group.y * push.page_words + group.x * words + word] = low | (high << 16u);
    }
}
