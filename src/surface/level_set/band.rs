//! The distances of one block: every voxel within the band learns its nearest triangle.
//!
//! Voxels at the corners of the lattice's cubes that a triangle touches are compared with it. From
//! there the triangles spread from voxel to voxel, nearest first: a voxel compares those of its 26
//! neighbours. The lattice's edge between such a voxel and a neighbour that no triangle touched does
//! not cross the surface, so that both are on one side of it.

use glam::{DVec3, IVec3, Vec4};

use super::triangle::{Distances, Triangle};
use super::{BAND, BLOCK, LEAF, Leaf, VOXELS, place_in_leaf};

/// Voxels around a block in which triangles spread.
pub const MARGIN: i32 = BAND as i32 + 1;
/// Voxels along the edge of a block with its margin, and one more at each end that no triangle
/// reaches.
const EDGE: i32 = BLOCK + 2 * MARGIN + 2;
/// Leaves along the edge of a block.
const LEAVES: i32 = BLOCK / LEAF;
/// Distances that differ by less are equal, and the triangle that faces the voxel more decides on
/// which side it is.
const EQUAL: f32 = 1e-4;
/// The largest [`margin`] of a voxel from which a triangle can be the nearest of one of the block's.
const MOST_USEFUL: f32 = BAND - 1.0;
/// Marks a voxel without a triangle.
const NONE: u32 = u32::MAX;

/// The nearest triangle of a voxel.
#[derive(Debug, Clone, Copy)]
struct NearestTriangle {
    /// The triangle's number in the block's list, or [`NONE`].
    number: u32,
    /// The square of its distance.
    squared: f32,
}

impl NearestTriangle {
    const NONE: Self = Self { number: NONE, squared: f32::INFINITY };

    fn is_in_band(self) -> bool {
        self.squared < BAND * BAND
    }
}

/// What is known of the voxels of a block and its margin.
pub struct Band {
    nearest: Vec<NearestTriangle>,
    /// The distance of the nearest triangle's plane from voxels that a triangle touched: the larger
    /// it is, the more the triangle faces the voxel.
    facing: Vec<f32>,
    inside: Vec<bool>,
    /// Whether the voxel was visited, or never is: those at the border.
    listed: Vec<bool>,
    /// All visited voxels.
    visited: Vec<usize>,
}

/// The triangles near a block, relative to its [`band_corner`], without those that are too flat.
#[derive(Debug, Default)]
pub struct BlockTriangles {
    triangles: Vec<Triangle>,
    /// The least and the greatest corner of the cubes that each triangle touches.
    boxes: Vec<[IVec3; 2]>,
    /// The number of each triangle in the mesh.
    numbers: Vec<u32>,
}

impl BlockTriangles {
    pub fn add(&mut self, corners: [DVec3; 3], number: u32) {
        if let Some(triangle) = Triangle::new(corners) {
            let [a, b, c] = corners;
            let low = a.min(b).min(c).floor().as_ivec3().max(IVec3::ONE);
            let high = a.max(b).max(c).ceil().as_ivec3().min(IVec3::splat(EDGE - 2));
            self.triangles.push(triangle);
            self.boxes.push([low, high]);
            self.numbers.push(number);
        }
    }
}

fn index(at: IVec3) -> usize {
    ((at.x * EDGE + at.y) * EDGE + at.z) as usize
}

fn place(index: usize) -> IVec3 {
    let (index, edge) = (index as i32, EDGE);
    IVec3::new(index / (edge * edge), index / edge % edge, index % edge)
}

/// The distance of a voxel from the block; less than that by one, so that neighbours of the block's
/// voxels count as in it.
fn margin(at: IVec3) -> f32 {
    let from_low = at - (MARGIN + 1);
    let from_high = from_low - (BLOCK - 1);
    let outside = (-from_low).max(from_high).max(IVec3::ZERO);
    if outside == IVec3::ZERO {
        return 0.0;
    }
    (outside.as_vec3().length() - 1.0).max(0.0)
}

fn is_border(voxel: usize) -> bool {
    let at = place(voxel);
    at.min_element() == 0 || at.max_element() == EDGE - 1
}

/// The offsets of a voxel's 26 neighbours, those across its faces first.
const AROUND: [isize; 26] = {
    let mut offsets = [0; 26];
    let (mut faces, mut others) = (0, FACES);
    let mut i = 0;
    while i < 27 {
        let (x, y, z) = (i / 9 - 1, i / 3 % 3 - 1, i % 3 - 1);
        let offset = (x * EDGE as isize + y) * EDGE as isize + z;
        match x * x + y * y + z * z {
            0 => {}
            1 => {
                offsets[faces] = offset;
                faces += 1;
            }
            _ => {
                offsets[others] = offset;
                others += 1;
            }
        }
        i += 1;
    }
    offsets
};

/// The number of a voxel's neighbours across its faces.
const FACES: usize = 6;

/// The voxel of a block's [`Band`] with the coordinates (0, 0, 0).
pub fn band_corner(block: IVec3) -> IVec3 {
    block * BLOCK - MARGIN - 1
}

impl Band {
    pub fn new() -> Self {
        let voxels = EDGE.pow(3) as usize;
        Self {
            nearest: vec![NearestTriangle::NONE; voxels],
            facing: vec![0.0; voxels],
            inside: vec![false; voxels],
            listed: (0..voxels).map(is_border).collect(),
            visited: Vec::new(),
        }
    }

    /// The leaves of a block with voxels in the band.
    pub fn leaves(&mut self, block: IVec3, near: &BlockTriangles) -> Vec<Leaf> {
        self.touch(near);
        self.spread(&near.triangles);
        let mut with_band = [false; LEAVES.pow(3) as usize];
        let in_band = self.visited.iter().filter(|&&voxel| self.nearest[voxel].is_in_band());
        for &voxel in in_band {
            let at = (place(voxel) - (MARGIN + 1)).div_euclid(IVec3::splat(LEAF));
            if at.min_element() >= 0 && at.max_element() < LEAVES {
                with_band[((at.x * LEAVES + at.y) * LEAVES + at.z) as usize] = true;
            }
        }
        let corner = |i: usize| {
            let i = i as i32;
            IVec3::new(i / (LEAVES * LEAVES), i / LEAVES % LEAVES, i % LEAVES) * LEAF
        };
        let wanted = (0..with_band.len()).filter(|&i| with_band[i]).map(corner);
        let leaves = wanted.map(|corner| self.leaf(block, corner, &near.numbers)).collect();
        self.forget();
        leaves
    }

    /// Returns to the state of a new band.
    fn forget(&mut self) {
        for voxel in self.visited.drain(..) {
            self.nearest[voxel] = NearestTriangle::NONE;
            self.listed[voxel] = false;
        }
    }

    /// Compares each triangle with the corners of the cubes that it touches.
    fn touch(&mut self, near: &BlockTriangles) {
        for (number, (triangle, &[low, high])) in (0..).zip(near.triangles.iter().zip(&near.boxes))
        {
            // Four voxels at a time, as most triangles are in one cube.
            for x in low.x..=high.x {
                for y in (low.y..=high.y).step_by(2) {
                    for z in (low.z..=high.z).step_by(2) {
                        let four = [(y, z), (y, z + 1), (y + 1, z), (y + 1, z + 1)];
                        let places = [
                            Vec4::splat(x as f32),
                            four.map(|(y, _)| y as f32).into(),
                            four.map(|(_, z)| z as f32).into(),
                        ];
                        let Distances { squared, heights } = triangle.distances(places);
                        for (i, (y, z)) in four.into_iter().enumerate() {
                            if y <= high.y && z <= high.z {
                                let at = IVec3::new(x, y, z);
                                let nearest = NearestTriangle { number, squared: squared[i] };
                                self.learn_touching(at, nearest, heights[i]);
                            }
                        }
                    }
                }
            }
        }
    }

    /// Takes a triangle that touches one of the voxel's cubes as its nearest, if it is.
    fn learn_touching(&mut self, at: IVec3, found: NearestTriangle, height: f32) {
        if margin(at) > MOST_USEFUL {
            return;
        }
        let voxel = index(at);
        let known = self.nearest[voxel];
        let is_first = known.number == NONE;
        let equal = EQUAL * (2.0 * found.squared.sqrt() + EQUAL);
        let is_nearer = is_first || found.squared < known.squared - equal;
        if is_nearer || found.squared < known.squared + equal && height.abs() > self.facing[voxel] {
            let squared = found.squared.min(known.squared);
            self.nearest[voxel] = NearestTriangle { number: found.number, squared };
            self.facing[voxel] = height.abs();
            self.inside[voxel] = height < 0.0;
        }
        if is_first {
            self.listed[voxel] = true;
            self.visited.push(voxel);
        }
    }

    /// Passes triangles on from the visited voxels to all voxels in the band.
    fn spread(&mut self, triangles: &[Triangle]) {
        // A triangle that touches none of a voxel's cubes is at least one voxel away.
        let touched = self.visited.iter().copied();
        let far: Vec<_> = touched.filter(|&voxel| self.nearest[voxel].squared > 1.0).collect();
        self.pull(triangles, &far);
        let mut front = 0..self.visited.len();
        while !front.is_empty() {
            for i in front.clone() {
                let voxel = self.visited[i];
                // No nearest triangle of the block's voxels spreads through a voxel further on.
                let left = BAND - margin(place(voxel));
                if self.nearest[voxel].squared >= left * left {
                    continue;
                }
                for &step in &AROUND[..FACES] {
                    let neighbour = voxel.wrapping_add_signed(step);
                    if !self.listed[neighbour] {
                        self.listed[neighbour] = true;
                        self.inside[neighbour] = self.inside[voxel];
                        self.visited.push(neighbour);
                    }
                }
            }
            front = front.end..self.visited.len();
            let next = self.visited[front.clone()].to_vec();
            self.pull(triangles, &next);
        }
    }

    /// Gives voxels the nearest of the triangles that they and their neighbours knew before.
    fn pull(&mut self, triangles: &[Triangle], voxels: &[usize]) {
        let found: Vec<_> =
            voxels.iter().map(|&voxel| self.nearest_around(triangles, voxel)).collect();
        voxels.iter().zip(found).for_each(|(&voxel, found)| self.nearest[voxel] = found);
    }

    /// The nearest of the triangles that a voxel and its 26 neighbours know.
    fn nearest_around(&self, triangles: &[Triangle], voxel: usize) -> NearestTriangle {
        let mut best = self.nearest[voxel];
        let mut numbers = [NONE; AROUND.len() + 3];
        let mut count = 0;
        for step in AROUND {
            let number = self.nearest[voxel.wrapping_add_signed(step)].number;
            let is_new =
                number != NONE && number != best.number && !numbers[..count].contains(&number);
            numbers[count] = number;
            count += usize::from(is_new);
        }
        if count == 0 {
            return best;
        }
        let first = numbers[0];
        numbers[count..].fill(first);
        let at = place(voxel).as_vec3().to_array();
        for numbers in numbers[..count.next_multiple_of(4)].as_chunks::<4>().0 {
            let four = numbers.map(|number| &triangles[number as usize]);
            for (&number, squared) in numbers.iter().zip(Triangle::squared_of(four, at)) {
                if squared < best.squared {
                    best = NearestTriangle { number, squared };
                }
            }
        }
        best
    }

    /// A leaf of the block that has voxels in the band.
    fn leaf(&self, block: IVec3, corner: IVec3, numbers: &[u32]) -> Leaf {
        let voxel = |i: usize| index(corner + (MARGIN + 1) + place_in_leaf(i));
        let mut leaf = Leaf::at(block * BLOCK + corner);
        let first = (0..VOXELS).map(voxel).find(|&voxel| self.nearest[voxel].is_in_band());
        let first_inside = first.is_some_and(|first| self.inside[first]);
        for i in 0..VOXELS {
            let voxel = voxel(i);
            let nearest = self.nearest[voxel];
            let inside = if nearest.is_in_band() {
                let distance = nearest.squared.sqrt();
                leaf.active[i / 64] |= 1 << (i % 64);
                leaf.distances.push(if self.inside[voxel] { -distance } else { distance });
                leaf.triangles.push(numbers[nearest.number as usize]);
                self.inside[voxel]
            } else {
                // No surface is between this voxel and the one before along an axis.
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
