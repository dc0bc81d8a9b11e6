//! Computes the distances of one block by finding the nearest triangle of every voxel within the
//! band.
//!
//! Each triangle is compared with the voxels at the corners of the lattice cubes that the triangle
//! touches. From these voxels, triangles spread from voxel to voxel, nearest first: a voxel
//! compares the triangles of its 26 neighbours. If no triangle touched a voxel's neighbour, the
//! lattice edge between the two voxels does not cross the surface, so both are on the same side of
//! the surface.

use std::ops::Range;

use glam::{DVec3, IVec3, Vec4};

use super::triangle::{Triangle, TriangleDistances};
use super::{BAND, BLOCK, LEAF, Leaf, VOXELS, place_in_leaf};

/// Width, in voxels, of the margin around a block in which triangles spread.
pub const MARGIN: i32 = BAND as i32 + 1;
/// Number of voxels along the edge of a block with its margin, plus one voxel at each end that no
/// triangle reaches.
const EDGE: i32 = BLOCK + 2 * MARGIN + 2;
/// Number of leaves along the edge of a block.
const LEAVES: i32 = BLOCK / LEAF;
/// Distances that differ by less than this number of voxels are treated as equal. The triangle that
/// faces the voxel more directly then decides on which side of the surface the voxel is.
const EQUAL: f32 = 1e-4;
/// The largest [`margin`] of a voxel from which a triangle can spread to become the nearest
/// triangle of a voxel of the block.
const MOST_USEFUL: f32 = BAND - 1.0;
/// An f64 coordinate counts as an integer if it is within this distance of that integer.
const ROUNDING: f64 = 1e-6;
/// A triangle may touch a voxel if the square of its distance, computed in f32, is less than this.
const TOUCHING: f32 = 1e-8;
/// Added to the limit on a squared distance, because some computed distances are slightly too
/// large.
const SLACK: f32 = 0.1;

/// The coordinates of a voxel within a [`Band`].
type VoxelOffset = [u8; 3];

/// The nearest known triangle of a voxel, and the side of the surface on which the voxel is.
#[derive(Debug, Clone, Copy)]
struct KnownVoxel {
    /// The squared distance of the voxel from the nearest known triangle.
    squared: f32,
    /// The number of that triangle in the block's list, or one of the marks below.
    number: u32,
    /// Negative inside. The absolute value is the distance of the voxel from the plane of the
    /// nearest triangle that touches the voxel's cubes. The larger this distance is, the more
    /// directly the triangle faces the voxel.
    height: f32,
}

/// Marks a voxel at the border, to which no triangle spreads.
const BORDER: u32 = u32::MAX;
/// Marks a voxel that was visited, but has no triangle yet.
const VISITED: u32 = u32::MAX - 1;
/// Marks a voxel that was not visited.
const UNKNOWN: u32 = u32::MAX - 2;

impl KnownVoxel {
    fn marked(number: u32) -> Self {
        Self { squared: f32::INFINITY, number, height: 0.0 }
    }

    fn has_triangle(self) -> bool {
        self.number < UNKNOWN
    }

    fn is_in_band(self) -> bool {
        self.squared < BAND * BAND
    }

    fn is_inside(self) -> bool {
        self.height < 0.0
    }
}

/// The steps from the lowest corner of a cube to its corners, with z varying fastest.
const CORNERS: [VoxelOffset; 8] = {
    let mut corners = [[0; 3]; 8];
    let mut i = 0;
    while i < 8 {
        corners[i as usize] = [i >> 2, i >> 1 & 1, i & 1];
        i += 1;
    }
    corners
};

/// Four [`KnownVoxel`]s.
#[derive(Debug, Clone, Copy)]
struct FourVoxels {
    squared: Vec4,
    /// The numbers, stored as the bits of floats.
    numbers: Vec4,
    heights: Vec4,
}

impl FourVoxels {
    fn of(known: [KnownVoxel; 4]) -> Self {
        Self {
            squared: known.map(|known| known.squared).into(),
            numbers: known.map(|known| f32::from_bits(known.number)).into(),
            heights: known.map(|known| known.height).into(),
        }
    }

    fn voxels(self) -> [KnownVoxel; 4] {
        let (squared, numbers) = (self.squared.to_array(), self.numbers.to_array());
        let heights = self.heights.to_array();
        std::array::from_fn(|i| KnownVoxel {
            squared: squared[i],
            number: numbers[i].to_bits(),
            height: heights[i],
        })
    }

    /// For each voxel, the nearer of two triangles that touch the voxel's cubes; at equal
    /// distances, the triangle that faces the voxel more directly.
    #[inline(always)]
    fn or(self, found: Self) -> Self {
        let equal = (found.squared.sqrt() * 2.0 + EQUAL) * EQUAL;
        let faces_more = found.heights.abs().cmpgt(self.heights.abs());
        let is_nearer = found.squared.cmplt(self.squared - equal);
        let is_better = is_nearer | found.squared.cmplt(self.squared + equal) & faces_more;
        Self {
            squared: Vec4::select(is_better, found.squared.min(self.squared), self.squared),
            numbers: Vec4::select(is_better, found.numbers, self.numbers),
            heights: Vec4::select(is_better, found.heights, self.heights),
        }
    }
}

/// Compares triangles with the corners of a cube, in the order of [`CORNERS`].
fn nearest_of(
    known: [KnownVoxel; 8],
    low: VoxelOffset,
    numbers: Range<u32>,
    triangles: &[Triangle],
) -> [KnownVoxel; 8] {
    let [a, b, c, d, e, f, g, h] = known;
    let mut nearest = [[a, b, c, d], [e, f, g, h]].map(FourVoxels::of);
    let [x, y, z] = splat(low);
    let (y, z) = (y + Vec4::new(0.0, 0.0, 1.0, 1.0), z + Vec4::new(0.0, 1.0, 0.0, 1.0));
    for number in numbers {
        let triangle = &triangles[number as usize];
        let bits = Vec4::splat(f32::from_bits(number));
        for (nearest, x) in nearest.iter_mut().zip([x, x + 1.0]) {
            let TriangleDistances { squared, heights } = triangle.distances([x, y, z]);
            *nearest = nearest.or(FourVoxels { squared, numbers: bits, heights });
        }
    }
    let [[a, b, c, d], [e, f, g, h]] = nearest.map(FourVoxels::voxels);
    [a, b, c, d, e, f, g, h]
}

fn splat(place: VoxelOffset) -> [Vec4; 3] {
    place.map(|at| Vec4::splat(f32::from(at)))
}

/// The voxels of a block and its margin.
pub struct Band {
    voxels: Vec<KnownVoxel>,
    /// All visited voxels.
    visited: Vec<VoxelOffset>,
}

/// The triangles near a block, with coordinates relative to the block's [`band_corner`]. Triangles
/// that are too flat are left out.
#[derive(Debug, Default)]
pub struct BlockTriangles {
    triangles: Vec<Triangle>,
    /// For each triangle, the least and the greatest coordinates of the corners of the cubes that
    /// the triangle touches.
    boxes: Vec<[VoxelOffset; 2]>,
    /// The number of each triangle in the mesh.
    numbers: Vec<u32>,
}

impl BlockTriangles {
    pub fn add(&mut self, corners: [DVec3; 3], number: u32) {
        if let Some(triangle) = Triangle::new(corners) {
            let [a, b, c] = corners;
            let [low, high] = [a.min(b).min(c), a.max(b).max(c)]
                .map(|at| at.clamp(DVec3::ZERO, DVec3::splat(f64::from(EDGE - 1))));
            // Casts round down.
            let low = low.to_array().map(|at| ((at + ROUNDING) as u8).max(1));
            let up = |at: f64| (at - ROUNDING) as u8 + 1;
            let high = high.to_array().map(|at| up(at).min(EDGE as u8 - 2));
            self.triangles.push(triangle);
            self.boxes.push([low, high]);
            self.numbers.push(number);
        }
    }
}

fn index([x, y, z]: VoxelOffset) -> usize {
    let edge = EDGE as usize;
    (usize::from(x) * edge + usize::from(y)) * edge + usize::from(z)
}

fn coordinates(place: VoxelOffset) -> IVec3 {
    place.map(i32::from).into()
}

/// The distance of a voxel from the block, minus one, so that neighbours of the block's voxels
/// count as part of the block.
fn margin(place: VoxelOffset) -> f32 {
    let from_low = coordinates(place) - (MARGIN + 1);
    let from_high = from_low - (BLOCK - 1);
    let outside = (-from_low).max(from_high).max(IVec3::ZERO);
    if outside == IVec3::ZERO {
        return 0.0;
    }
    (outside.as_vec3().length() - 1.0).max(0.0)
}

/// The squared distance below which a voxel visits a neighbour that may be `reach` voxels from the
/// surface.
///
/// A voxel at a distance d ≥ 1 has a neighbour across a face with a squared distance of at most
/// d² + 1 - 2 d / √3: this neighbour lies along the axis on which the nearest point is farthest
/// away.
fn passing_on(reach: f32) -> f32 {
    if reach < 1.0 {
        return 0.0;
    }
    reach * reach - 2.0 * reach / 3f32.sqrt() + 1.0 + SLACK
}

/// A step to a neighbour, and the difference between the indices of both voxels.
#[derive(Debug, Clone, Copy)]
struct Step {
    along: [i8; 3],
    offset: isize,
}

impl Step {
    fn from(self, place: VoxelOffset) -> VoxelOffset {
        let [x, y, z] = self.along;
        let [a, b, c] = place;
        [a.wrapping_add_signed(x), b.wrapping_add_signed(y), c.wrapping_add_signed(z)]
    }
}

/// The number of a voxel's neighbours across its faces.
const FACES: usize = 6;

/// The steps to a voxel's 26 neighbours, with the neighbours across its faces first.
const AROUND: [Step; 26] = {
    let mut steps = [Step { along: [0; 3], offset: 0 }; 26];
    let (mut faces, mut others) = (0, FACES);
    let mut i = 0;
    while i < 27 {
        let along = [i / 9 - 1, i / 3 % 3 - 1, i % 3 - 1];
        let [x, y, z] = along;
        let offset = (x as isize * EDGE as isize + y as isize) * EDGE as isize + z as isize;
        let step = Step { along, offset };
        match x * x + y * y + z * z {
            0 => {}
            1 => {
                steps[faces] = step;
                faces += 1;
            }
            _ => {
                steps[others] = step;
                others += 1;
            }
        }
        i += 1;
    }
    steps
};

/// The voxel that has the coordinates (0, 0, 0) in a block's [`Band`].
pub fn band_corner(block: IVec3) -> IVec3 {
    block * BLOCK - MARGIN - 1
}

impl Band {
    pub fn new() -> Self {
        let mut voxels = vec![KnownVoxel::marked(UNKNOWN); EDGE.pow(3) as usize];
        let last = EDGE as u8 - 1;
        for x in 0..=last {
            for y in 0..=last {
                let is_inner = |at| at > 0 && at < last;
                let step = if is_inner(x) && is_inner(y) { usize::from(last) } else { 1 };
                for z in (0..=last).step_by(step) {
                    voxels[index([x, y, z])] = KnownVoxel::marked(BORDER);
                }
            }
        }
        Self { voxels, visited: Vec::new() }
    }

    /// The leaves of a block that contain voxels of the band.
    pub fn leaves(&mut self, block: IVec3, near: &BlockTriangles) -> Vec<Leaf> {
        self.touch(near);
        self.spread(&near.triangles);
        let mut has_band = [false; LEAVES.pow(3) as usize];
        for &place in self.visited.iter().filter(|&&place| self.voxels[index(place)].is_in_band()) {
            let at = (coordinates(place) - (MARGIN + 1)).div_euclid(IVec3::splat(LEAF));
            if at.min_element() >= 0 && at.max_element() < LEAVES {
                has_band[((at.x * LEAVES + at.y) * LEAVES + at.z) as usize] = true;
            }
        }
        let corner = |i: usize| {
            let i = i as i32;
            IVec3::new(i / (LEAVES * LEAVES), i / LEAVES % LEAVES, i % LEAVES) * LEAF
        };
        let corners = (0..has_band.len()).filter(|&i| has_band[i]).map(corner);
        let leaves = corners.map(|corner| self.leaf(block, corner, &near.numbers)).collect();
        for place in self.visited.drain(..) {
            self.voxels[index(place)] = KnownVoxel::marked(UNKNOWN);
        }
        leaves
    }

    /// Compares each triangle with the corners of the cubes that it touches.
    fn touch(&mut self, near: &BlockTriangles) {
        let mut first = 0;
        for boxes in near.boxes.chunk_by(|a, b| a == b) {
            let [low, high] = boxes[0];
            let numbers = first..first + boxes.len() as u32;
            first = numbers.end;
            for x in (low[0]..=high[0]).step_by(2) {
                for y in (low[1]..=high[1]).step_by(2) {
                    for z in (low[2]..=high[2]).step_by(2) {
                        self.touch_cube([x, y, z], high, numbers.clone(), &near.triangles);
                    }
                }
            }
        }
    }

    /// Compares triangles with the corners of a cube, except for corners that are beyond `high` or
    /// too far from the block.
    fn touch_cube(
        &mut self,
        low: VoxelOffset,
        high: VoxelOffset,
        numbers: Range<u32>,
        triangles: &[Triangle],
    ) {
        let places = CORNERS.map(|along| std::array::from_fn(|axis| low[axis] + along[axis]));
        let is_within = coordinates(low).min_element() > MARGIN
            && coordinates(low).max_element() < MARGIN + BLOCK;
        let is_useful = places.map(|place: VoxelOffset| {
            (0..3).all(|axis| place[axis] <= high[axis])
                && (is_within || margin(place) <= MOST_USEFUL)
        });
        let before: [KnownVoxel; 8] = std::array::from_fn(|i| {
            if is_useful[i] { self.voxels[index(places[i])] } else { KnownVoxel::marked(BORDER) }
        });
        let after = nearest_of(before, low, numbers.clone(), triangles);
        for i in (0..CORNERS.len()).filter(|&i| is_useful[i]) {
            if !before[i].has_triangle() {
                self.visited.push(places[i]);
            }
            self.voxels[index(places[i])] = after[i];
            // The squared distance may be that of another triangle that is equally near.
            if after[i].squared < 4.0 * TOUCHING {
                for number in numbers.clone() {
                    let triangle = &triangles[number as usize];
                    if triangle.distances(splat(places[i])).squared.x < TOUCHING {
                        self.touch_around(places[i], number, triangle);
                    }
                }
            }
        }
    }

    /// Compares a triangle that touches a voxel with all neighbours of the voxel, because the
    /// triangle may touch their cubes as well.
    fn touch_around(&mut self, place: VoxelOffset, number: u32, triangle: &Triangle) {
        for step in &AROUND {
            let to = step.from(place);
            if self.voxels[index(to)].number != BORDER && margin(to) <= MOST_USEFUL {
                let TriangleDistances { squared, heights } = triangle.distances(splat(to));
                let found = KnownVoxel { squared: squared.x, number, height: heights.x };
                self.learn(to, found);
            }
        }
    }

    /// Compares a voxel with a triangle that touches one of its cubes, and stores the triangle if
    /// it is the nearest so far.
    fn learn(&mut self, place: VoxelOffset, found: KnownVoxel) {
        let known = &mut self.voxels[index(place)];
        if !known.has_triangle() {
            self.visited.push(place);
        }
        *known = FourVoxels::of([*known; 4]).or(FourVoxels::of([found; 4])).voxels()[0];
    }

    /// Passes triangles on from the visited voxels to all voxels in the band.
    fn spread(&mut self, triangles: &[Triangle]) {
        // A triangle that touches none of a voxel's cubes is at least one voxel away.
        let is_far = |place: &VoxelOffset| self.voxels[index(*place)].squared > 1.0;
        let far: Vec<VoxelOffset> = self.visited.iter().copied().filter(is_far).collect();
        self.pull(triangles, &far);
        let mut front = self.visited.clone();
        while !front.is_empty() {
            let mut next = Vec::new();
            for place in front {
                let (at, known) = (index(place), self.voxels[index(place)]);
                for step in &AROUND[..FACES] {
                    let neighbour = &mut self.voxels[at.wrapping_add_signed(step.offset)];
                    if neighbour.number != UNKNOWN {
                        continue;
                    }
                    let to = step.from(place);
                    // The nearest triangles of the block's voxels do not spread through voxels that
                    // are farther from the surface than this.
                    if known.squared < passing_on(BAND - margin(to)) {
                        let height = if known.is_inside() { -1.0 } else { 1.0 };
                        *neighbour = KnownVoxel { height, ..KnownVoxel::marked(VISITED) };
                        next.push(to);
                    }
                }
            }
            self.visited.extend(&next);
            self.pull(triangles, &next);
            front = next;
        }
    }

    /// Stores for each voxel the nearest of the triangles that the voxel and its neighbours knew
    /// before this call.
    fn pull(&mut self, triangles: &[Triangle], places: &[VoxelOffset]) {
        let found: Vec<KnownVoxel> =
            places.iter().map(|&place| self.nearest_around(triangles, place)).collect();
        places.iter().zip(found).for_each(|(&place, found)| self.voxels[index(place)] = found);
    }

    /// The nearest of the triangles that a voxel and its 26 neighbours know.
    fn nearest_around(&self, triangles: &[Triangle], place: VoxelOffset) -> KnownVoxel {
        let voxel = index(place);
        let mut best = self.voxels[voxel];
        let mut numbers = [0; AROUND.len() + 3];
        let mut count = 0;
        for step in &AROUND {
            // This code has no branch, because the processor could hardly predict which neighbours
            // know a triangle.
            let known = self.voxels[voxel.wrapping_add_signed(step.offset)];
            numbers[count] = known.number;
            count += usize::from(known.has_triangle() & (known.number != best.number));
        }
        let first = numbers[0];
        numbers[count..].fill(first);
        let at = place.map(f32::from);
        for numbers in numbers[..count.next_multiple_of(4)].as_chunks::<4>().0 {
            let four = numbers.map(|number| &triangles[number as usize]);
            for (&number, squared) in numbers.iter().zip(Triangle::squared_of(four, at)) {
                if squared < best.squared {
                    best = KnownVoxel { squared, number, ..best };
                }
            }
        }
        best
    }

    /// The leaf at `corner` of the block. At least one of its voxels must be in the band.
    fn leaf(&self, block: IVec3, corner: IVec3, numbers: &[u32]) -> Leaf {
        let voxel = |i: usize| {
            let place = corner + (MARGIN + 1) + place_in_leaf(i);
            self.voxels[index(place.to_array().map(|at| at as u8))]
        };
        let mut leaf = Leaf::at(block * BLOCK + corner);
        let first = (0..VOXELS).map(voxel).find(|voxel| voxel.is_in_band());
        let first_inside = first.is_some_and(KnownVoxel::is_inside);
        for i in 0..VOXELS {
            let known = voxel(i);
            let inside = if known.is_in_band() {
                let distance = known.squared.sqrt();
                leaf.active[i / 64] |= 1 << (i % 64);
                leaf.distances.push(if known.is_inside() { -distance } else { distance });
                leaf.triangles.push(numbers[known.number as usize]);
                known.is_inside()
            } else {
                // The surface does not pass between this voxel and the previous voxel along an
                // axis.
                let edge = LEAF as usize;
                let before =
                    [(i % edge, 1), (i / edge % edge, edge), (i / (edge * edge), edge * edge)]
                        .into_iter()
                        .find(|&(along, _)| along > 0);
                before.map_or(first_inside, |(_, step)| leaf.is_inside(i - step))
            };
            leaf.inside[i / 64] |= u64::from(inside) << (i % 64);
        }
        leaf
    }
}
