// Mirrors at the walls of a tank. The coordinates of the mirrors' planes are in halves of a cell.

// The coordinate of the cell whose mirror image lies at the coordinate `cell`, for mirrors at `lo`
// and `hi`.
fn source_of(cell: i32, lo: i32, hi: i32) -> i32 {
    // The middle of the cell, in halves of a cell. A loop is fast, because few cells are beyond a
    // mirror, and the other cells only evaluate the condition once.
    var at = 2 * cell + 1;
    while at < lo || at > hi {
        at = select(2 * hi - at, 2 * lo - at, at < lo);
    }
    return at >> 1u;
}

fn source_cell(cell: vec3<i32>, lo: vec3<i32>, hi: vec3<i32>) -> vec3<i32> {
    var at = 2 * cell + 1;
    while any(at < lo) || any(at > hi) {
        at = select(select(at, 2 * hi - at, at > hi), 2 * lo - at, at < lo);
    }
    return at >> vec3(1u);
}
