//! with block ramp
// Blends the surface of the bulk with drops. Drops get more weight the farther nearby particles lie
// outside the calm surface. Sheets get weight at smaller distances, according to their certainty.

struct JoinPush {
    // The sample at which drops begin to fade in.
    begin: u32,
    // The distance beyond `begin` from which drops completely replace the surface.
    range: u32,
    slope: u32,
    // The radius of a single particle's drop.
    radius: i32,
    // The standard deviation of a drop.
    width: i32,
    // The distance by which sheets of full certainty fade in earlier than drops.
    earlier: u32,
}

var<immediate> push: JoinPush;
// The parts of blocks in which particles stand out, the blocks, and for each part, the number of
// its block.
@group(0) @binding(0) var<storage, read> parts: array<Block>;
@group(0) @binding(1) var<storage, read> blocks: array<Block>;
@group(0) @binding(2) var<storage, read> homes: array<u32>;
// On the cells of the parts, the distance by which nearby particles lie outside the calm surface,
// and the shares of drops.
@group(0) @binding(3) var<storage, read> near: array<u32>;
@group(0) @binding(4) var<storage, read> shares: array<u32>;
// For each share from 0 to 1, the distance from the middle of a Gaussian at which the Gaussian is
// this share of its maximum.
@group(0) @binding(5) var<storage, read> away: array<i32>;
// The certainty of sheets, on the cells of the parts.
@group(0) @binding(6) var<storage, read> certainty: array<u32>;
// The bulk's surface; replaced by the field.
@group(0) @binding(7) var<storage, read_write> field: array<u32>;

fn joined(bulk: u32, outlying: u32, share: u32, certain: u32) -> u32 {
    let stands_out = min(outlying + ((certain * push.earlier) >> 12u), 65535u);
    let weight = ramp_at(stands_out, Ramp(push.begin, push.range, push.slope));
    if weight == 0u {
        return bulk;
    }
    let of_table = min(share, 32768u);
    let at = of_table >> 5u;
    let low = away[at];
    let deviations = low + (((away[at + 1u] - low) * i32(of_table & 31u)) >> 5u);
    let distance = push.radius - ((deviations * push.width) >> 12u);
    let out = max(distance + DISTANCE_ZERO - i32(bulk), 0);
    return u32(clamp(i32(bulk) + ((out * i32(weight) + 2048) >> 12u), 1, 65535));
}

@compute @workgroup_size(256)
fn join(@builtin(global_invocation_id) id: vec3<u32>) {
    let own = parts[id.y];
    let at = cell_of(own, id.x);
    if at.z >= own.size.z {
        return;
    }
    let home = blocks[homes[id.y]];
    let word = word_of(home, at + vec3<u32>(own.lo - home.lo));
    let a = field[word];
    let b = near[own.field + id.x];
    let c = shares[own.field + id.x];
    let d = certainty[own.field + id.x];
    let first = joined(a & 0xffffu, b & 0xffffu, c & 0xffffu, d & 0xffffu);
    field[word] = first | joined(a >> 16u, b >> 16u, c >> 16u, d >> 16u) << 16u;
}
