//! with block
// Cuts padded blocks out of the pages. Cells of a row that share a word in the block share one in a page.

struct Push {
    // Entries of the table that turns numbers of particles into theta; 0 where pages hold theta.
    decode: u32,
}

var<immediate> push: Push;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
// For every bin that a block touches, x fastest, one more than the number of its page, or 0.
@group(0) @binding(1) var<storage, read> tables: array<u32>;
@group(0) @binding(2) var<storage, read> pages: array<u32>;
@group(0) @binding(3) var<storage, read> theta: array<u32>;
@group(0) @binding(4) var<storage, read_write> field: array<u32>;

fn decoded(sample: u32) -> u32 {
    if push.decode == 0u {
        return sample;
    }
    return theta[min(sample, push.decode - 1u)];
}

@compute @workgroup_size(256)
fn gather(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let at = cell_of(block, id.x);
    if at.z >= block.size.z {
        return;
    }
    let cell = block.lo + vec3<i32>(at);
    let first = block.lo >> vec3(BIN_BITS);
    let bins = ((block.lo + vec3<i32>(block.size) - 1) >> vec3(BIN_BITS)) - first + 1;
    let bin = (cell >> vec3(BIN_BITS)) - first;
    let page = tables[block.table + u32(bin.x + bins.x * (bin.y + bins.y * bin.z))];
    var word = 0u;
    if page != 0u {
        let local = vec3<u32>(cell & vec3(BIN - 1));
        let samples = pages[(page - 1u) * PAGE_WORDS + (local.x + u32(BIN) * (local.y + u32(BIN) * local.z)) / 2u];
        word = decoded(samples & 0xffffu) | (decoded(samples >> 16u) << 16u);
    }
    field[word_of(block, at)] = word;
}
