//! with block
// Cuts padded blocks out of pages of particles' numbers and centroids: what their clouds leave in each cell. Clouds of
// cells beyond a block's faces are left out.

struct Push {
    // The lowest cell within the walls, and the highest.
    walls_lo: vec3<i32>,
    // What a particle makes of the DIF, all around.
    amount: u32,
    walls_hi: vec3<i32>,
}

var<immediate> push: Push;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
// For every bin that a block touches, x fastest, one more than the number of its page, or 0.
@group(0) @binding(1) var<storage, read> tables: array<u32>;
// Channel by channel: numbers, and centroids' places along x, y and z.
@group(0) @binding(2) var<storage, read> pages: array<u32>;
@group(0) @binding(3) var<storage, read_write> field: array<u32>;

// What is stored of a cell: its particles' number, and their centroid's place along x, y and z.
fn stored(block: Block, cell: vec3<i32>) -> vec4<u32> {
    if any(cell < block.lo) || any(cell >= block.lo + vec3<i32>(block.size)) {
        return vec4(0u);
    }
    let first = block.lo >> vec3(BIN_BITS);
    let bins = ((block.lo + vec3<i32>(block.size) - 1) >> vec3(BIN_BITS)) - first + 1;
    let bin = (cell >> vec3(BIN_BITS)) - first;
    let page = tables[block.table + u32(bin.x + bins.x * (bin.y + bins.y * bin.z))];
    if page == 0u {
        return vec4(0u);
    }
    let local = vec3<u32>(cell & vec3(BIN - 1));
    let at = (page - 1u) * CLOUD_CHANNELS * PAGE_WORDS + (local.x + u32(BIN) * (local.y + u32(BIN) * local.z)) / 2u;
    let count = half_of(pages[at], local.x);
    if count == 0u {
        return vec4(0u);
    }
    return vec4(
        count,
        half_of(pages[at + PAGE_WORDS], local.x),
        half_of(pages[at + 2u * PAGE_WORDS], local.x),
        half_of(pages[at + 3u * PAGE_WORDS], local.x),
    );
}

// The share of a cloud that falls so many cells from its own along an axis: -1, 0 or 1.
fn share(place: u32, away: i32) -> u32 {
    let fractions = 1u << FRACTION_BITS;
    let twice = 2u * (place & (fractions - 1u)) + 1u;
    let rest = 2u * fractions - twice;
    let half_square = vec2(rest * rest, twice * twice) >> vec2(SQUARE_BITS);
    if away == 0 {
        return (1u << SHARE_BITS) - half_square.x - half_square.y;
    }
    return select(half_square.x, half_square.y, away > 0);
}

fn part_of(amount: u32, share: u32) -> u32 {
    return (amount * share + (1u << (SHARE_BITS - 1u))) >> SHARE_BITS;
}

fn theta(block: Block, cell: vec3<i32>) -> u32 {
    // What would lie beyond a wall lies in the cell before it.
    let lo = cell - vec3<i32>(cell == push.walls_lo);
    let hi = cell + vec3<i32>(cell == push.walls_hi);
    var sum = 0u;
    for (var from_z = lo.z - 1; from_z <= hi.z + 1; from_z++) {
        for (var from_y = lo.y - 1; from_y <= hi.y + 1; from_y++) {
            for (var from_x = lo.x - 1; from_x <= hi.x + 1; from_x++) {
                let from_cell = vec3(from_x, from_y, from_z);
                let own = stored(block, from_cell);
                if own.x == 0u {
                    continue;
                }
                let cloud = min(own.x * push.amount, FULL);
                let first = max(lo, from_cell - 1);
                let last = min(hi, from_cell + 1);
                for (var z = first.z; z <= last.z; z++) {
                    let slab = part_of(cloud, share(own.w, z - from_z));
                    for (var y = first.y; y <= last.y; y++) {
                        let row = part_of(slab, share(own.z, y - from_y));
                        for (var x = first.x; x <= last.x; x++) {
                            sum += part_of(row, share(own.y, x - from_x));
                        }
                    }
                }
            }
        }
    }
    return min(sum, FULL);
}

@compute @workgroup_size(256)
fn clouds(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let at = cell_of(block, id.x);
    if at.z >= block.size.z {
        return;
    }
    let cell = block.lo + vec3<i32>(at);
    field[word_of(block, at)] = theta(block, cell) | (theta(block, cell + vec3(1, 0, 0)) << 16u);
}
