//! The side of a closed mesh on which each voxel of a block is.
//!
//! A column is a line of voxels along z. The side changes where the column crosses a triangle.
//! Crossings are found in integers, and each column counts as shifted by an infinitely small step,
//! so that a column crosses an edge or a vertex exactly as often as it crosses the surface there.
//! Columns without crossings get their side from neighbouring columns.

use std::ops::RangeInclusive;

use glam::{DVec3, IVec3};

use super::near::NearTriangles;
use super::triangle::shares;
use super::{BAND, BLOCK};

/// Number of bits after the binary point of a [`Place`].
const FRACTION: u32 = 20;
/// Added to a coordinate before it is rounded, because converting a positive number to an integer
/// rounds down without a function call.
const OFFSET: i64 = 1 << (52 - FRACTION);
/// Number of voxels along the edge of a block.
const SIDE: usize = BLOCK as usize;
/// Two neighbouring voxels are on the same side if the sum of their distances, in voxels, is greater
/// than this. Distances are rounded, so the limit is more than 1.
const APART: f32 = 1.001;
/// Minimum weight of each corner of a triangle in a point that is surely not on an edge.
const WITHIN: f32 = 1e-3;

/// The coordinates x and y of a vertex, in multiples of 2^-[`FRACTION`] voxels.
type Place = [i64; 2];

/// For each column of a block, with y varying fastest, a word in which bit z stands for voxel z.
pub struct Sides {
    /// For each step from voxel z - 1 to voxel z, the number of exits minus the number of entries,
    /// modulo 4: the lower bit.
    low: Vec<u64>,
    /// The upper bit of the same number.
    high: Vec<u64>,
    /// Whether each voxel is inside.
    inside: Vec<u64>,
    /// Whether `inside` is known.
    is_known: Vec<bool>,
}

impl Sides {
    pub fn new() -> Self {
        let none = || vec![0; SIDE * SIDE];
        Self { low: none(), high: none(), inside: none(), is_known: vec![false; SIDE * SIDE] }
    }

    /// Forgets all crossings.
    pub fn clear(&mut self) {
        self.low.fill(0);
        self.high.fill(0);
    }

    /// Adds the crossings of a triangle, with coordinates relative to the block's first voxel.
    pub fn cross(&mut self, corners: [DVec3; 3]) {
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
                    let weighted = |i: usize| turns[i] as f64 * corners[i].z;
                    let z = (weighted(0) + weighted(1) + weighted(2)) / area as f64;
                    self.step(x as usize * SIDE + y as usize, z, area > 0);
                }
            }
        }
    }

    /// Adds a crossing of a column at the coordinate z.
    fn step(&mut self, column: usize, z: f64, is_exit: bool) {
        if z > 0.0 && z <= f64::from(BLOCK - 1) {
            let bit = 1 << z.ceil() as u32;
            let low = &mut self.low[column];
            self.high[column] ^= if is_exit { *low & bit } else { !*low & bit };
            *low ^= bit;
        }
    }

    /// Finds the sides of all voxels near the band, from all triangles near the block. `squared` and
    /// `nearest` are the squared distance and the nearest triangle of each voxel.
    pub fn find(&mut self, squared: &[f32], nearest: &[u32], near: &NearTriangles) {
        for column in 0..SIDE * SIDE {
            self.is_known[column] = self.low[column] != 0;
            if self.is_known[column] {
                self.inside[column] = self.crossed(column);
            }
        }
        self.spread(squared);
        for column in 0..SIDE * SIDE {
            if !self.is_known[column]
                && let Some(is_inside) = facing(column, squared, nearest, near)
            {
                self.set(column, is_inside);
            }
        }
        self.spread(squared);
    }

    /// For each voxel of a column, a bit that says whether it is inside. The order is that of
    /// [`Sides`].
    pub fn inside(&self, column: usize) -> u64 {
        self.inside[column]
    }

    /// The sides of a column that crosses the surface.
    fn crossed(&self, column: usize) -> u64 {
        let steps = self.low[column];
        let begins_with_exit = self.high[column] >> steps.trailing_zeros() & 1 == 0;
        // The parity of the number of steps up to each voxel.
        let mut odd = steps;
        for shift in [1, 2, 4, 8, 16, 32] {
            odd ^= odd << shift;
        }
        if begins_with_exit { !odd } else { odd }
    }

    /// Sets the side of a column that crosses no triangle.
    fn set(&mut self, column: usize, is_inside: bool) {
        self.inside[column] = if is_inside { u64::MAX } else { 0 };
        self.is_known[column] = true;
    }

    /// Spreads the known sides over the block: along +x and +y, and then back.
    fn spread(&mut self, squared: &[f32]) {
        for x in 0..SIDE {
            for y in 0..SIDE {
                let column = x * SIDE + y;
                if x > 0 {
                    self.pass(column - SIDE, column, squared);
                }
                if y > 0 {
                    self.pass(column - 1, column, squared);
                }
            }
        }
        for x in (0..SIDE).rev() {
            for y in (0..SIDE).rev() {
                let column = x * SIDE + y;
                if x < SIDE - 1 {
                    self.pass(column + SIDE, column, squared);
                }
                if y < SIDE - 1 {
                    self.pass(column + 1, column, squared);
                }
            }
        }
    }

    /// Passes a side from a column to a neighbour that crosses no triangle, at two voxels between
    /// which the surface cannot be.
    fn pass(&mut self, from: usize, to: usize, squared: &[f32]) {
        if self.is_known[from] && !self.is_known[to] {
            let distance = |column: usize, z: usize| squared[column * SIDE + z].sqrt();
            let apart = (0..SIDE).find(|&z| distance(from, z) + distance(to, z) > APART);
            if let Some(z) = apart {
                self.set(to, self.inside[from] >> z & 1 == 1);
            }
        }
    }
}

/// Whether a column that crosses no triangle is inside: the side of a triangle that has the nearest
/// point of a voxel of the column in its interior, if there is such a voxel in the band.
fn facing(column: usize, squared: &[f32], nearest: &[u32], near: &NearTriangles) -> Option<bool> {
    let voxels = column * SIDE..(column + 1) * SIDE;
    voxels.filter(|&voxel| squared[voxel] < BAND * BAND).find_map(|voxel| {
        let triangle = near.triangles[nearest[voxel] as usize];
        let at = [column / SIDE, column % SIDE, voxel % SIDE].map(|at| at as i32);
        let at = IVec3::from(at).as_dvec3();
        let [a, b, c] = near.places(triangle.corners).map(|place| place - at);
        let height = -triangle.normal.dot(a);
        let is_sure = height.abs() > f64::from(WITHIN)
            && shares([a, b, c]).iter().all(|&share| share > WITHIN);
        is_sure.then_some(height < 0.0)
    })
}

/// Rounds the coordinates of a vertex.
fn rounded(at: DVec3) -> Place {
    let scale = f64::from(1 << FRACTION);
    let round = |at: f64| (at * scale + (OFFSET as f64 + 0.5)) as i64 - OFFSET;
    [round(at.x), round(at.y)]
}

/// The columns of a block whose coordinate is between those of three places.
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

/// The sign of the [`turn`] to a point on the line from `a` to `b`, after the point is shifted by a
/// very small step along x and by a much smaller step along y.
fn shifted_turn(a: Place, b: Place) -> i64 {
    let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
    if dy != 0 { -dy } else { dx }
}
