// The grid, and the walls if there are any. 64-bit numbers are (low word, high word).

struct Grid {
    origin: array<vec2<u32>, 3>,
    // Edge of a cell, and its reciprocal for divisions.
    cell: vec2<u32>,
    reciprocal: vec2<u32>,
    // The walls' corners in world coordinates.
    walls_lo: array<vec2<u32>, 3>,
    walls_hi: array<vec2<u32>, 3>,
    // The lowest cell within the walls, and the highest.
    lo: vec3<i32>,
    walled: u32,
    hi: vec3<i32>,
}
