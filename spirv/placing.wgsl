// Computes the cell of a particle and its offset in the cell from (x - origin) / cell, with the
// same f64 arithmetic as the host. Uses `grid`, `positions` and `push` of the shader that includes
// this file.

// The fate of a particle: it is in a bin, or it has no bin for one of three reasons.
const BINNED: u32 = 0u;
const NOT_FINITE: u32 = 1u;
const TOO_FAR: u32 = 2u;
const OUTSIDE: u32 = 3u;

struct Placed {
    fate: u32,
    cell: vec3<i32>,
    // The offset in the cell, from 0 to 2^FRACTION_BITS - 1.
    offset: vec3<u32>,
}

struct Along {
    cell: i32,
    offset: u32,
}

// Rounds a number of cells down to steps of 2^-FRACTION_BITS; NaN and numbers that are too large
// become CELL_LIMIT.
fn along(cells: vec2<u32>) -> Along {
    let parts = parts_of(cells);
    let shift = -(parts.exponent + i32(FRACTION_BITS));
    if shift < 1 {
        return Along(CELL_LIMIT, 0u);
    }
    let n = u32(min(shift, 63));
    var steps = right(parts.significand, n);
    if steps.y > 0xffu {
        return Along(CELL_LIMIT, 0u);
    }
    if parts.sign != 0u {
        steps = minus(minus(vec2(0u), steps), vec2(u32(any(left(steps, n) != parts.significand)), 0u));
    }
    return Along(i32(right(steps, FRACTION_BITS).x), steps.x & ((1u << FRACTION_BITS) - 1u));
}

// Particle number `i` of the chunk.
fn place_particle(i: u32) -> Placed {
    var placed = Placed(BINNED, vec3(0), vec3(0u));
    var world: array<vec2<u32>, 3>;
    for (var axis = 0u; axis < 3u; axis++) {
        let at = push.first + (3u * i + axis) * push.width;
        if push.width == 1u {
            world[axis] = f64_from_f32(positions[at]);
        } else {
            world[axis] = vec2(positions[at], positions[at + 1u]);
        }
        let found = along(f64_div(f64_sub(world[axis], grid.origin[axis]), grid.cell, grid.reciprocal));
        placed.cell[axis] = found.cell;
        placed.offset[axis] = found.offset;
    }
    if any(placed.cell < vec3(-CELL_LIMIT)) || any(placed.cell >= vec3(CELL_LIMIT)) {
        if !is_finite(world[0]) || !is_finite(world[1]) || !is_finite(world[2]) {
            placed.fate = NOT_FINITE;
        } else {
            // With walls, a particle that is too far away for the grid counts as outside the walls.
            placed.fate = select(TOO_FAR, OUTSIDE, grid.walled != 0u);
        }
        return placed;
    }
    if grid.walled != 0u {
        for (var axis = 0u; axis < 3u; axis++) {
            let above = f64_at_most(grid.walls_lo[axis], world[axis]);
            if !above || !f64_at_most(world[axis], grid.walls_hi[axis]) {
                placed.fate = OUTSIDE;
            }
            if placed.cell[axis] < grid.lo[axis] {
                placed.cell[axis] = grid.lo[axis];
                placed.offset[axis] = 0u;
            } else if placed.cell[axis] > grid.hi[axis] {
                placed.cell[axis] = grid.hi[axis];
                placed.offset[axis] = (1u << FRACTION_BITS) - 1u;
            }
        }
    }
    return placed;
}

// The bin of a cell: three coordinates of COORD_BITS.
fn bin_of(cell: vec3<i32>) -> vec2<u32> {
    let bin = vec3<u32>(cell >> vec3(BIN_BITS)) & vec3((1u << COORD_BITS) - 1u);
    return vec2(
        bin.x | (bin.y << COORD_BITS),
        (bin.y >> (32u - COORD_BITS)) | (bin.z << (2u * COORD_BITS - 32u)),
    );
}
