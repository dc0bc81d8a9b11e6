//! The side of a closed mesh on which each voxel of a block is.
//!
//! A column is a line of voxels along z. The side changes where the column crosses a triangle.
//! Crossings are computed in integers. Each column is treated as if it were shifted by an
//! infinitely small step, so that it never passes exactly through an edge or a vertex. A column
//! without crossings gets its side from a neighbouring column, or from a triangle that is visible
//! from one of its voxels. Where the mesh passes through itself, columns can contradict each other.
//! In that case, the majority of connected voxels decides on their common side.

use std::ops::RangeInclusive;

use glam::{DVec3, IVec3};

use crate::system::bits::ones;

use super::near::NearTriangles;
use super::triangle::shares;
use super::{BAND, BLOCK};

/// Number of bits after the binary point of a [`Place`].
const FRACTION: u32 = 20;
/// Number that is added to a coordinate before it is rounded, so that the sum is usually positive.
/// Converting a positive number to an integer rounds down without a function call. A negative sum
/// is rounded up, which does no harm because all triangles of a block round a vertex in the same
/// way.
const OFFSET: i64 = 1 << (52 - FRACTION);
/// Number of columns along the edge of a block, and of voxels in a column.
const EDGE: usize = BLOCK as usize;
/// Two neighbouring voxels are on the same side if the sum of their distances from the surface, in
/// voxels, is more than this. Distances are rounded, so the limit is more than 1.
const APART: f32 = 1.0001;
/// The square of the distance from the surface, in voxels, above which a voxel is deep: two
/// neighbouring deep voxels are on the same side.
const DEEP: f32 = APART * APART / 4.0;
/// The square of the distance, in voxels, below which a voxel counts as lying on the surface, where
/// either side is right.
const ON_SURFACE: f32 = 1e-10;
/// The distance, in voxels, by which the end of a line of sight is moved from the nearest point of
/// a triangle towards the triangle's centroid.
const INWARDS: f64 = 0.1;
/// Number of bits of each number in [`Sides::entries`].
const COUNT_BITS: usize = 3;

/// The coordinates x and y of a vertex, in multiples of 2^-[`FRACTION`] voxels.
type Place = [i64; 2];

/// For each column of a block, with y varying fastest, words in which bit z stands for voxel z.
pub struct Sides {
    /// For each step from voxel z - 1 to voxel z, the number of times that the column enters the
    /// mesh minus the number of times that it leaves the mesh. This number is in two's complement;
    /// each vector has one of its bits, beginning with the lowest.
    entries: [Vec<u64>; COUNT_BITS],
    /// Whether each voxel is inside; 0 for columns whose sides are not known.
    inside: Vec<u64>,
    /// Whether the sides of a column's voxels are known.
    is_known: Vec<bool>,
}

impl Sides {
    pub fn new() -> Self {
        let none = || vec![0; EDGE * EDGE];
        Self {
            entries: [none(), none(), none()],
            inside: none(),
            is_known: vec![false; EDGE * EDGE],
        }
    }

    /// Removes all crossings.
    pub fn clear(&mut self) {
        self.entries.iter_mut().for_each(|bits| bits.fill(0));
    }

    /// Adds the crossings of a triangle, with coordinates relative to the block's first voxel.
    pub fn cross(&mut self, corners: [DVec3; 3]) {
        let lowest = corners[0].z.min(corners[1].z).min(corners[2].z);
        let highest = corners[0].z.max(corners[1].z).max(corners[2].z);
        if highest <= 0.0 || lowest > f64::from(BLOCK - 1) {
            return;
        }
        let [a, b, c] = [rounded(corners[0]), rounded(corners[1]), rounded(corners[2])];
        let [along_x, along_y] = [columns(a[0], b[0], c[0]), columns(a[1], b[1], c[1])];
        if along_x.is_empty() || along_y.is_empty() {
            return;
        }
        // Twice the area; positive if columns leave the mesh through this triangle.
        let area = turn(a, b, c);
        if area == 0 {
            return;
        }
        for x in along_x {
            for y in along_y.clone() {
                let at = [x << FRACTION, y << FRACTION];
                let turns = [turn(b, c, at), turn(c, a, at), turn(a, b, at)];
                let is_left = |turn: i128, from: Place, to: Place| {
                    turn > 0 || turn == 0 && shifted_turn(from, to) > 0
                };
                let left =
                    [is_left(turns[0], b, c), is_left(turns[1], c, a), is_left(turns[2], a, b)];
                if left == [area > 0; 3] {
                    let weighted = |i: usize| to_float(turns[i]) * corners[i].z;
                    let z = (weighted(0) + weighted(1) + weighted(2)) / to_float(area);
                    self.step(x as usize * EDGE + y as usize, z, area > 0);
                }
            }
        }
    }

    /// Adds a crossing of a column at the coordinate z.
    fn step(&mut self, column: usize, z: f64, is_exit: bool) {
        if z > 0.0 && z <= f64::from(BLOCK - 1) {
            let mut carry = 1 << z.ceil() as u32;
            for bits in &mut self.entries {
                let before = bits[column];
                bits[column] ^= carry;
                carry &= if is_exit { !before } else { before };
            }
        }
    }

    /// Finds the sides of all voxels near the band, from all triangles near the block. `squared`
    /// and `nearest` are the squared distance and the nearest triangle of each voxel.
    pub fn find(&mut self, squared: &[f32], nearest: &[u32], near: &NearTriangles) {
        for column in 0..EDGE * EDGE {
            self.is_known[column] = self.is_crossed(column);
            self.inside[column] = self.sides_of_crossed_column(column, 0);
        }
        self.spread_sides(squared);
        for column in 0..EDGE * EDGE {
            if !self.is_known[column]
                && let Some(is_inside) = side_by_line_of_sight(column, squared, nearest, near)
            {
                self.set(column, is_inside);
                self.spread_sides(squared);
            }
        }
        self.resolve_contradictions(squared);
    }

    /// A bit for each voxel of a column: whether the voxel is inside. Columns and bits are ordered
    /// as in [`Sides`].
    pub fn inside(&self, column: usize) -> u64 {
        self.inside[column]
    }

    /// The steps of a column at which the winding number changes.
    fn steps(&self, column: usize) -> u64 {
        self.entries.iter().fold(0, |all, bits| all | bits[column])
    }

    /// Whether the winding number changes in a column.
    fn is_crossed(&self, column: usize) -> bool {
        self.steps(column) != 0
    }

    /// The sides of a column's voxels if the least winding number in the column is `least`. A voxel
    /// is inside if its winding number is positive.
    fn sides_of_crossed_column(&self, column: usize, least: i32) -> u64 {
        let steps = self.steps(column);
        let change = |z: usize| {
            let bit = |i: usize| (self.entries[i][column] >> z & 1) as i32;
            bit(0) + 2 * bit(1) - 4 * bit(2)
        };
        let (mut winding, mut lowest) = (0, 0);
        for z in ones(steps) {
            winding += change(z);
            lowest = lowest.min(winding);
        }
        let (mut winding, mut inside) = (least - lowest, 0);
        let mut all_from = u64::MAX;
        for z in ones(steps) {
            let from = u64::MAX << z;
            inside |= if winding > 0 { all_from & !from } else { 0 };
            winding += change(z);
            all_from = from;
        }
        inside | if winding > 0 { all_from } else { 0 }
    }

    /// Sets the side of a column that crosses no triangle.
    fn set(&mut self, column: usize, is_inside: bool) {
        self.inside[column] = if is_inside { u64::MAX } else { 0 };
        self.is_known[column] = true;
    }

    /// Spreads the known sides over the block: along +x and +y, and then back.
    fn spread_sides(&mut self, squared: &[f32]) {
        for x in 0..EDGE {
            for y in 0..EDGE {
                let column = x * EDGE + y;
                if x > 0 {
                    self.pass_side(column - EDGE, column, squared);
                }
                if y > 0 {
                    self.pass_side(column - 1, column, squared);
                }
            }
        }
        for x in (0..EDGE).rev() {
            for y in (0..EDGE).rev() {
                let column = x * EDGE + y;
                if x < EDGE - 1 {
                    self.pass_side(column + EDGE, column, squared);
                }
                if y < EDGE - 1 {
                    self.pass_side(column + 1, column, squared);
                }
            }
        }
    }

    /// Passes the side of a column on to a neighbour that crosses no triangle, if the surface
    /// cannot pass between two adjacent voxels of the columns.
    fn pass_side(&mut self, from: usize, to: usize, squared: &[f32]) {
        if self.is_known[from] && !self.is_known[to] {
            let distance = |column: usize, z: usize| squared[column * EDGE + z].sqrt();
            let apart = (0..EDGE).find(|&z| distance(from, z) + distance(to, z) > APART);
            if let Some(z) = apart {
                self.set(to, self.inside[from] >> z & 1 == 1);
            }
        }
    }

    /// If neighbouring deep voxels are on different sides, puts connected deep voxels on the same
    /// side, for which they [vote](Self::vote).
    fn resolve_contradictions(&mut self, squared: &[f32]) {
        if !self.is_consistent(squared) {
            let bits = |column: &[f32]| {
                let bits = column.iter().enumerate();
                bits.fold(0, |all, (z, &squared)| all | u64::from(squared > DEEP) << z)
            };
            let deep: Vec<u64> = squared.chunks_exact(EDGE).map(bits).collect();
            let voted = self.vote(&deep);
            for column in 0..EDGE * EDGE {
                self.apply_vote(column, voted[column], deep[column]);
            }
        }
    }

    /// Whether all neighbouring deep voxels are on the same side.
    fn is_consistent(&self, squared: &[f32]) -> bool {
        let is_deep = |column: usize, z: usize| squared[column * EDGE + z] > DEEP;
        let agree = |a: usize, b: usize| {
            let mut differences = ones(self.inside[a] ^ self.inside[b]);
            !differences.any(|z| is_deep(a, z) && is_deep(b, z))
        };
        (0..EDGE * EDGE).all(|column| {
            let mut changes = ones((self.inside[column] ^ self.inside[column] << 1) & !1);
            !changes.any(|z| is_deep(column, z - 1) && is_deep(column, z))
                && (column < EDGE || agree(column - EDGE, column))
                && (column % EDGE == 0 || agree(column - 1, column))
        })
    }

    /// The sides of deep voxels. All voxels of a connected set get the same side: the side on which
    /// most of the set's voxels in crossed columns are. If the two sides have equally many of these
    /// voxels, the set gets the side on which the majority of all its voxels are.
    fn vote(&self, deep: &[u64]) -> Vec<u64> {
        let mut voted = vec![0; EDGE * EDGE];
        let mut unvisited = deep.to_vec();
        let mut connected: Vec<[usize; 3]> = Vec::new();
        for column in 0..EDGE * EDGE {
            while unvisited[column] != 0 {
                let z = unvisited[column].trailing_zeros() as usize;
                unvisited[column] &= unvisited[column] - 1;
                connected.clear();
                connected.push([column / EDGE, column % EDGE, z]);
                let mut next = 0;
                // The number of votes for the inside minus the number of votes for the outside,
                // among all voxels, and among the voxels in crossed columns.
                let (mut all, mut of_crossed) = (0, 0);
                while let Some(&at) = connected.get(next) {
                    next += 1;
                    let column = at[0] * EDGE + at[1];
                    let vote = if self.inside[column] >> at[2] & 1 == 1 { 1 } else { -1 };
                    all += vote;
                    of_crossed += if self.is_crossed(column) { vote } else { 0 };
                    for axis in 0..3 {
                        for step in [-1, 1] {
                            let mut to = at;
                            to[axis] = at[axis].wrapping_add_signed(step);
                            if to[axis] < EDGE && unvisited[to[0] * EDGE + to[1]] >> to[2] & 1 == 1
                            {
                                unvisited[to[0] * EDGE + to[1]] ^= 1 << to[2];
                                connected.push(to);
                            }
                        }
                    }
                }
                let votes: i32 = if of_crossed == 0 { all } else { of_crossed };
                if votes > 0 {
                    connected.iter().for_each(|&[x, y, z]| voted[x * EDGE + y] |= 1 << z);
                }
            }
        }
        voted
    }

    /// Sets the sides of a column's voxels. For deep voxels, it takes the sides from the vote. For
    /// the other voxels, it takes them from one of the candidates: from the one whose sides agree
    /// with the vote at the largest number of deep voxels.
    fn apply_vote(&mut self, column: usize, voted: u64, deep: u64) {
        let candidates = if self.is_crossed(column) {
            [0, -1, 1].map(|least| self.sides_of_crossed_column(column, least))
        } else {
            [self.inside[column], 0, u64::MAX]
        };
        let wrong = |sides: &u64| ((sides ^ voted) & deep).count_ones();
        let best = candidates.into_iter().min_by_key(wrong).unwrap_or(0);
        self.inside[column] = voted & deep | best & !deep;
    }
}

/// Whether a column that crosses no triangle is inside the mesh. A line of sight goes from one of
/// the column's voxels in the band to the triangle that is nearest to this voxel. The column
/// is outside the mesh if the first triangle on this line faces the voxel. Returns `None` if the
/// column has no such voxel, or if the line hits no triangle.
fn side_by_line_of_sight(
    column: usize,
    squared: &[f32],
    nearest: &[u32],
    near: &NearTriangles,
) -> Option<bool> {
    let mut voxels = column * EDGE..(column + 1) * EDGE;
    let voxel = voxels.find(|&voxel| (ON_SURFACE..BAND * BAND).contains(&squared[voxel]))?;
    let at = [column / EDGE, column % EDGE, voxel % EDGE].map(|at| at as i32);
    let at = IVec3::from(at).as_dvec3();
    let places = |corners| near.places(corners).map(|place| place - at);
    let [a, b, c] = places(near.triangles[nearest[voxel] as usize].corners);
    let [share_a, share_b, share_c] = shares([a, b, c]).map(f64::from);
    let point = a * share_a + b * share_b + c * share_c;
    let inwards = (a + b + c) / 3.0 - point;
    // The line must not end on an edge, which it could miss because of rounding errors.
    let to = point + inwards * (INWARDS / inwards.length()).min(1.0);
    let hits = near.triangles.iter().filter_map(|triangle| {
        let [a, b, c] = places(triangle.corners);
        let towards = triangle.normal.dot(to);
        let along = triangle.normal.dot(a) / towards;
        // The signs show on which side of each edge the line passes.
        let around = [a.cross(b).dot(to), b.cross(c).dot(to), c.cross(a).dot(to)];
        let is_hit = around.iter().all(|&v| v >= 0.0) || around.iter().all(|&v| v <= 0.0);
        (is_hit && along > 0.0).then_some((along, towards > 0.0))
    });
    hits.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, is_inside)| is_inside)
}

/// Rounds the coordinates of a vertex.
fn rounded(at: DVec3) -> Place {
    let scale = f64::from(1 << FRACTION);
    let round = |at: f64| (at * scale + (OFFSET as f64 + 0.5)) as i64 - OFFSET;
    [round(at.x), round(at.y)]
}

/// The columns of a block whose coordinate is between the least and the greatest of three
/// coordinates.
fn columns(a: i64, b: i64, c: i64) -> RangeInclusive<i64> {
    let first = ((a.min(b).min(c) - 1) >> FRACTION) + 1;
    let last = a.max(b).max(c) >> FRACTION;
    first.max(0)..=last.min(i64::from(BLOCK) - 1)
}

/// Twice the signed area of a triangle: positive if `c` is to the left of the line from `a` to `b`.
fn turn(a: Place, b: Place, c: Place) -> i128 {
    let product = |x: i64, y: i64| i128::from(x) * i128::from(y);
    product(b[0] - a[0], c[1] - a[1]) - product(b[1] - a[1], c[0] - a[0])
}

/// Converts a [`turn`]. The conversion is fast if the turn fits into 64 bits, which is the case for
/// all but very large triangles.
fn to_float(turn: i128) -> f64 {
    i64::try_from(turn).map_or(turn as f64, |turn| turn as f64)
}

/// The sign of the [`turn`] to a point on the line from `a` to `b`, after the point is shifted by a
/// very small step along x and by a much smaller step along y.
fn shifted_turn(a: Place, b: Place) -> i64 {
    let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
    if dy != 0 { -dy } else { dx }
}
