//! with wide binned
// Each work group computes the sums of the cells in one octant of a bin, with atomic operations in
// shared memory. For symmetry, theta follows from the sums (eq. 7). For counting, the number of
// particles is stored, and a table converts it to theta (eq. 6) when samples are gathered.

struct IndicatePush {
    // Not 0 for counting, 0 for symmetry.
    counting: u32,
}

var<immediate> push: IndicatePush;
@group(0) @binding(0) var<storage, read> bins: array<Bin>;
@group(0) @binding(1) var<storage, read> records: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> pages: array<u32>;

// For each cell: N, then the low words of the sums of offsets along x, y and z, then their high
// words.
const SUMS: u32 = 7u;
var<workgroup> sums: array<atomic<u32>, OCTANT_CELLS * SUMS>;

fn add(at: u32, high: u32, value: u32) {
    let before = atomicAdd(&sums[at], value);
    if before + value < before {
        atomicAdd(&sums[high], 1u);
    }
}

// The 64-bit number a * 2^b, where b is at most 31. The high word is shifted in two steps, because
// no shift may be as wide as a word.
fn shifted(a: u32, b: u32) -> vec2<u32> {
    return vec2(a << b, (a >> 1u) >> (31u - b));
}

// |2 S + n - n F|, where S is the sum of the offsets of n particles, and F is 2^FRACTION_BITS.
fn deviation(n: u32, s: vec2<u32>) -> vec2<u32> {
    var sum = vec2(s.x << 1u, (s.y << 1u) | (s.x >> 31u));
    sum.x += n;
    sum.y += u32(sum.x < n);
    let middle = shifted(n, FRACTION_BITS);
    if less(sum, middle) {
        return minus(middle, sum);
    }
    return minus(sum, middle);
}

// floor(a / n), which must be less than 2^bits, and the remainder.
fn divided(a: vec2<u32>, n: u32, bits: u32) -> vec2<u32> {
    if a.y == 0u {
        return vec2(a.x / n, a.x % n);
    }
    var quotient = 0u;
    var rest = a;
    for (var bit = bits; bit > 0u; bit--) {
        let part = shifted(n, bit - 1u);
        if !less(rest, part) {
            rest = minus(rest, part);
            quotient |= 1u << (bit - 1u);
        }
    }
    return vec2(quotient, rest.x);
}

// |D| / n in units of 1 / DISTANCE_SCALE, rounded to the nearest unit. |D| is the deviation, which
// is from 0 to n F.
fn rounded(n: u32, s: vec2<u32>) -> u32 {
    let whole = divided(deviation(n, s), n, FRACTION_BITS + 1u);
    // The remainder is less than n. It adds (2 DISTANCE_SCALE remainder + n) / (2 n), rounded down,
    // to the result.
    var twice = shifted(whole.y, DISTANCE_SCALE_BITS + 1u);
    twice.x += n;
    twice.y += u32(twice.x < n);
    var share = 0u;
    let half_steps = divided(twice, n, DISTANCE_SCALE_BITS + 2u).x;
    share = half_steps / 2u;
    return (whole.x << DISTANCE_SCALE_BITS) + share;
}

// The integer nearest to the square root. The result does not depend on the error of the device's
// square root.
fn nearest_root(square: u32) -> u32 {
    var root = min(u32(sqrt(f32(square))), 65535u);
    while root * root > square {
        root--;
    }
    while root < 65535u && (root + 1u) * (root + 1u) <= square {
        root++;
    }
    return root + u32(square - root * root > root);
}

fn symmetry(n: u32, s: array<vec2<u32>, 3>) -> u32 {
    if n == 0u {
        return 0u;
    }
    let x = rounded(n, s[0]);
    let y = rounded(n, s[1]);
    let z = rounded(n, s[2]);
    let distance = nearest_root(x * x + y * y + z * z);
    return FULL - ((distance * THETA_PER_DISTANCE + (1u << 14u)) >> 15u);
}

fn value(cell: u32) -> u32 {
    let at = cell * SUMS;
    let n = atomicLoad(&sums[at]);
    if push.counting != 0u {
        return min(n, FULL);
    }
    let low = vec3(atomicLoad(&sums[at + 1u]), atomicLoad(&sums[at + 2u]), atomicLoad(&sums[at + 3u]));
    let high = vec3(atomicLoad(&sums[at + 4u]), atomicLoad(&sums[at + 5u]), atomicLoad(&sums[at + 6u]));
    return symmetry(n, array(vec2(low.x, high.x), vec2(low.y, high.y), vec2(low.z, high.z)));
}

@compute @workgroup_size(256)
fn indicate(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    for (var i = local.x; i < OCTANT_CELLS * SUMS; i += 256u) {
        atomicStore(&sums[i], 0u);
    }
    workgroupBarrier();
    let octant = vec3(group.x & 1u, (group.x >> 1u) & 1u, group.x >> 2u);
    let bin = bins[group.y];
    for (var i = local.x; i < bin.count; i += 256u) {
        let bits = place_of(records[bin.first + i]);
        let cell = bits >> vec3(FRACTION_BITS);
        if all(cell / OCTANT == octant) {
            let inside = cell % OCTANT;
            let at = (inside.x + OCTANT * (inside.y + OCTANT * inside.z)) * SUMS;
            let offset = bits & vec3((1u << FRACTION_BITS) - 1u);
            atomicAdd(&sums[at], 1u);
            add(at + 1u, at + 4u, offset.x);
            add(at + 2u, at + 5u, offset.y);
            add(at + 3u, at + 6u, offset.z);
        }
    }
    workgroupBarrier();
    // Each thread writes two cells, which form one word of the page.
    for (var pair = local.x; pair < OCTANT_CELLS / 2u; pair += 256u) {
        let cell = 2u * pair;
        let inside = vec3(cell % OCTANT, cell / OCTANT % OCTANT, cell / (OCTANT * OCTANT));
        let at = octant * OCTANT + inside;
        let word = (at.x + u32(BIN) * (at.y + u32(BIN) * at.z)) / 2u;
        pages[group.y * PAGE_WORDS + word] = value(cell) | (value(cell + 1u) << 16u);
    }
}
