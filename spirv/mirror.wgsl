// Mirrors at the walls of a tank. The coordinates of the mirrors' planes are in halves of a cell.

// The coordinate of the cell whose mirror image lies at the coordinate `cell`, for mirrors at `lo`
// and `hi`.
fn source_of(cell: i32, lo: i32, hi: i32) -> i32 {
    if cell >= (lo >> 1u) && cell < ((hi + 1) >> 1u) {
        return cell;
    }
    let period = 2 * (hi - lo);
    let at = abs(2 * cell + 1 - lo) % period;
    return (min(at, period - at) + lo - 1) >> 1u;
}

fn source_cell(cell: vec3<i32>, lo: vec3<i32>, hi: vec3<i32>) -> vec3<i32> {
    return vec3(
        source_of(cell.x, lo.x, hi.x),
        source_of(cell.y, lo.y, hi.y),
        source_of(cell.z, lo.z, hi.z),
    );
}
