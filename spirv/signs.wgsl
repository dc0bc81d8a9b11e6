//! with block
// Computes a sign word for every tile to mesh, and for the tiles beyond the upper faces of the
// meshed part: bit x + 4 y + 16 z is set if the cell at (x, y, z) in the tile is inside the fluid.
// In the tiles beyond the upper faces, only the first layer of cells is known.

struct SignsPush {
    // The lowest cell within the walls, and the highest; all ghost points beyond the walls are
    // outside.
    walls_lo: vec3<i32>,
    // The greatest sample that counts as outside the fluid.
    threshold: u32,
    walls_hi: vec3<i32>,
}

var<immediate> push: SignsPush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> field: array<u32>;
@group(0) @binding(2) var<storage, read_write> masks: array<vec2<u32>>;

@compute @workgroup_size(64)
fn signs(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = blocks[id.y];
    let tiles = block.tiles_size / TILE + 1u;
    let tile = vec3(id.x % tiles.x, id.x / tiles.x % tiles.y, id.x / (tiles.x * tiles.y));
    if tile.z >= tiles.z {
        return;
    }
    let corner = block.tiles_lo + vec3<i32>(tile * TILE);
    let highest = min(block.tiles_lo + vec3<i32>(block.tiles_size), push.walls_hi);
    // The cells of a row whose signs are known.
    let along = vec4(0, 1, 2, 3) + corner.x;
    let known = (along >= vec4(push.walls_lo.x)) & (along <= vec4(highest.x));
    var mask = vec2(0u);
    for (var row = 0u; row < TILE * TILE; row++) {
        let first = corner + vec3<i32>(vec3(0u, row % TILE, row / TILE));
        if any(first.yz < push.walls_lo.yz) || any(first.yz > highest.yz) {
            continue;
        }
        // Tiles and blocks both begin at whole words.
        let word = word_of(block, vec3<u32>(first - block.lo));
        var words = vec2(0u);
        if any(known.xy) {
            words.x = field[word];
        }
        if any(known.zw) {
            words.y = field[word + 1u];
        }
        let samples = vec4(words.x & 0xffffu, words.x >> 16u, words.y & 0xffffu, words.y >> 16u);
        let inside = select(vec4(0u), vec4(1u, 2u, 4u, 8u), known & (samples > vec4(push.threshold)));
        let bit = TILE * row;
        mask[bit / 32u] |= (inside.x | inside.y | inside.z | inside.w) << (bit % 32u);
    }
    masks[id.y * SIGN_TILES + id.x] = mask;
}
