//! with block mirror ramp
// Computes the shares and the certainty of sheets and filaments from the smoothed density, which is
// mirrored at walls. The formulas are in src/field/sheets/mod.rs; numbers have SHEET_BITS fraction
// bits, and logarithms are binary.

struct SheetsPush {
    // The planes of the mirrors, in halves of a cell.
    mirror_lo: vec3<i32>,
    // The distance, in cells, between a cell and the samples from which its differences are
    // computed.
    step: i32,
    mirror_hi: vec3<i32>,
    slope: i32,
    bend: i32,
    plateau: i32,
    most_more: i32,
    sheet_size: i32,
    filament_size: i32,
    drop_size: i32,
    least_size: i32,
    rim: i32,
    gradual: i32,
    by_gradual: i32,
    least: i32,
    sheet_stretch: i32,
    filament_stretch: i32,
    share: i32,
    by_directions: i32,
    by_size: i32,
    by_distance: i32,
    torn_begin: u32,
    torn_range: u32,
}

var<immediate> push: SheetsPush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> density: array<u32>;
@group(0) @binding(2) var<storage, read_write> shares: array<u32>;
@group(0) @binding(3) var<storage, read_write> certainty: array<u32>;

const ONE: i32 = 1 << SHEET_BITS;
const MOST_BEND: i32 = 2 * ONE;
const MOST_SLOPE: i32 = 4 * ONE;

fn ramp_of(begin: u32, range: u32) -> Ramp {
    return Ramp(begin, range, ((1u << 28u) + range - 1u) / range);
}

fn log_two(sample: u32) -> i32 {
    let power = firstLeadingBit(max(sample, 1u));
    let x = i32((max(sample, 1u) << (15u - power)) & 32767u);
    var sum = LOG2_D;
    sum = LOG2_C + ((sum * x) >> 15u);
    sum = LOG2_B + ((sum * x) >> 15u);
    sum = LOG2_A + ((sum * x) >> 15u);
    let between = (((x * (32768 - x)) >> 15u) * sum) >> 15u;
    return (i32(power) << SHEET_BITS) + ((x + between) >> (15u - SHEET_BITS));
}

fn two_to(power: i32) -> i32 {
    let whole = power >> SHEET_BITS;
    let x = (power & (ONE - 1)) << (15u - SHEET_BITS);
    var sum = EXP2_C;
    sum = EXP2_B + ((sum * x) >> 15u);
    sum = EXP2_A + ((sum * x) >> 15u);
    let mantissa = 32768 + x - ((((x * (32768 - x)) >> 15u) * sum) >> 15u);
    if whole >= 0 {
        return mantissa << u32(whole);
    }
    return mantissa >> u32(-whole);
}

fn product(a: vec3<i32>, b: vec3<i32>) -> i32 {
    return (a.x * b.x + a.y * b.y + a.z * b.z) / ONE;
}

fn held(v: vec3<i32>, most: i32) -> vec3<i32> {
    return clamp(v, vec3(-most), vec3(most));
}

fn times(m: mat3x3i, v: vec3<i32>) -> vec3<i32> {
    return held(vec3(product(m.x, v), product(m.y, v), product(m.z, v)), MOST_SLOPE);
}

// A symmetric matrix, by rows.
struct mat3x3i {
    x: vec3<i32>,
    y: vec3<i32>,
    z: vec3<i32>,
}

// The logarithm of the density at a cell, relative to the block's lowest cell.
fn at(block: Block, cell: vec3<i32>) -> i32 {
    let source = source_cell(cell + block.lo, push.mirror_lo, push.mirror_hi) - block.lo;
    let known = vec3<u32>(clamp(source, vec3(0), vec3<i32>(block.size) - 1));
    return log_two(half_of(density[word_of(block, known)], known.x));
}

fn impurity(row: vec3<i32>, m: mat3x3i) -> i32 {
    let apart = held(row - vec3(product(row, m.x), product(row, m.y), product(row, m.z)), MOST_BEND);
    return apart.x * apart.x + apart.y * apart.y + apart.z * apart.z;
}

fn minor(a: vec2<i32>, b: vec2<i32>) -> i32 {
    return (a.x * b.x - a.y * b.y) / ONE;
}

// Returns the share and the certainty of a sheet at a cell.
fn sheeted(block: Block, cell: vec3<i32>) -> vec2<u32> {
    let x = vec3(push.step, 0, 0);
    let y = vec3(0, push.step, 0);
    let z = vec3(0, 0, push.step);
    let centre = at(block, cell);
    let below = vec3(at(block, cell - x), at(block, cell - y), at(block, cell - z));
    let above = vec3(at(block, cell + x), at(block, cell + y), at(block, cell + z));
    // The sums over the ends of the diagonals in the planes xy, xz and yz.
    let same = vec3(
        at(block, cell + x + y) + at(block, cell - x - y),
        at(block, cell + x + z) + at(block, cell - x - z),
        at(block, cell + y + z) + at(block, cell - y - z),
    );
    let opposite = vec3(
        at(block, cell + x - y) + at(block, cell - x + y),
        at(block, cell + x - z) + at(block, cell - x + z),
        at(block, cell + y - z) + at(block, cell - y + z),
    );
    let g = held(held(above - below, 4 * ONE) * push.slope / ONE, MOST_SLOPE);
    let bends = held(held(2 * centre - above - below, 8 * ONE) * push.bend / ONE, MOST_BEND);
    let twists = held(held(opposite - same, 8 * ONE) * push.bend / (4 * ONE), MOST_BEND);
    let b = mat3x3i(
        vec3(bends.x, twists.x, twists.y),
        vec3(twists.x, bends.y, twists.z),
        vec3(twists.y, twists.z, bends.z),
    );
    let away_from_projection = impurity(b.x, b) + impurity(b.y, b) + impurity(b.z, b);
    let impure = min(away_from_projection >> SHEET_BITS, 65535);
    let directions = clamp(bends.x + bends.y + bends.z, 0, 3 * ONE);
    let narrow = clamp(directions - ONE, 0, ONE);
    let rounded = max(directions - 2 * ONE, 0);
    let rim = max(min(impure * BY_RIM, ONE), narrow);

    // The determinant of I - B.
    let d = vec3(ONE) - bends;
    let product_of_variances = (d.x * minor(vec2(d.y, twists.z), vec2(d.z, twists.z))
        - twists.x * minor(vec2(twists.x, -twists.z), vec2(d.z, twists.y))
        - twists.y * minor(vec2(twists.y, -twists.z), vec2(d.y, twists.x))) >> SHEET_BITS;
    let determinant = u32(clamp(product_of_variances, 0, 65535));
    let flat = 4096 - i32(ramp_at(determinant, ramp_of(FLAT_BEGIN, FLAT_RANGE)));
    let no_body = 4096u - ramp_at(determinant, ramp_of(THICK_BEGIN, THICK_RANGE));
    let less_impure = u32(max(impure - ((IMPURE_IF_FLAT * flat) >> SHEET_BITS), 0));

    let along = times(b, g);
    let middle = held(2 * along - times(b, along), MOST_BEND);
    let away = product(middle, middle);
    let beyond = clamp((4 * product(g, g) - 3 * product(g, along)) >> 1u, 0, 65535);
    let more = min(beyond, push.most_more);
    let thick = centre + ((more * LOG2_E) >> SHEET_BITS) - push.plateau;

    let sheet_stretch = push.sheet_stretch + (((push.filament_stretch - push.sheet_stretch) * narrow) >> SHEET_BITS);
    let stretch = u32(clamp(sheet_stretch - ((thick * (ONE / 2 + narrow / 2)) >> SHEET_BITS), 0, 65535));
    let whole = 4096u - ramp_at(stretch, ramp_of(push.torn_begin, push.torn_range));
    let pure_share = 4096u - ramp_at(less_impure, ramp_of(IMPURE_BEGIN, IMPURE_RANGE));
    let thin = ramp_at(u32(directions), ramp_of(THIN_BEGIN, THIN_RANGE));
    let stretched = 4096u - ramp_at(u32(directions), ramp_of(ROUND_BEGIN, ROUND_RANGE));
    let less_beyond = u32(max(beyond - ((BEYOND_IF_FLAT * flat) >> SHEET_BITS), 0));
    let here = 4096u - ramp_at(less_beyond, ramp_of(BEYOND_BEGIN, BEYOND_RANGE));
    let all = (((whole * pure_share) >> 12u) * ((((thin * stretched) >> 12u) * here) >> 12u)) >> 12u;
    let thin_all = (all * no_body) >> 12u;
    let certain = (thin_all * thin_all) >> 12u;
    if centre < push.least {
        return vec2(0u, certain);
    }
    let of_size = push.sheet_size
        + (((push.filament_size - push.sheet_size) * narrow + (push.drop_size - push.filament_size) * rounded) >> SHEET_BITS);
    let size = ((thick * (2 * ONE - narrow - rounded / 3)) >> SHEET_BITS) + of_size;
    let least_size = push.least_size + ((push.rim * rim) >> SHEET_BITS);
    let closer = max(push.gradual - abs(size - least_size), 0);
    let gradual_size = max(size, least_size) + ((((closer * closer) >> SHEET_BITS) * push.by_gradual) >> SHEET_BITS);
    let square = two_to(min(gradual_size, ONE)) >> 3u;
    let share = push.share
        + ((push.by_directions * max(directions, ONE) + push.by_size * square - push.by_distance * away) >> SHEET_BITS);
    return vec2(u32(two_to(clamp(share, -15 * ONE, ONE - 1))), certain);
}

@compute @workgroup_size(256)
fn sheets(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let cell = cell_of(block, id.x);
    if cell.z >= block.size.z {
        return;
    }
    let word = word_of(block, cell);
    let first = sheeted(block, vec3<i32>(cell));
    let second = sheeted(block, vec3<i32>(cell) + vec3(1, 0, 0));
    shares[word] = first.x | second.x << 16u;
    certainty[word] = first.y | second.y << 16u;
}
