//! The distances of one block: every voxel within the band learns its nearest triangle.
//!
//! Voxels at the corners of the lattice's cubes that a triangle touches are compared with it. From
//! there the triangles spread from voxel to voxel, nearest first: a voxel compares those of its 26
//! neighbours. The lattice's edge between such a voxel and a neighbour that no triangle touched does
//! not cross the surface, so that both are on one side of it.

use glam::{IVec3, Vec3};

use super::triangle::{NearestPoint, Triangle};
use super::{BAND, BLOCK, LEAF, Leaf, LeafVoxel, VOXELS};

/// Voxels around a block in which triangles spread.
const MARGIN: i32 = BAND as i32 + 1;
/// Voxels along the edge of a block with its margin, and one more at each end that no triangle
/// reaches.
const EDGE: i32 = BLOCK + 2 * MARGIN + 2;
/// Distances that differ by less are equal, and the triangle that faces the voxel more decides on
/// which side it is.
const EQUAL: f32 = 1e-4;
/// A triangle whose squared distance is less by at most this is not compared.
const NO_NEARER: f32 = 1e-3;
/// The largest [`margin`] of a voxel from which a triangle can be the nearest of one of the block's.
const MOST_USEFUL: f32 = BAND - 1.0;
/// Marks a voxel without a triangle.
const NONE: u32 = u32::MAX;

/// What is known of the voxels of a block and its margin.
pub struct Band {
    /// The number of the nearest triangle in the block's list.
    nearest: Vec<u32>,
    /// The square of its distance.
    squared: Vec<f32>,
    /// The distance of the nearest triangle's plane: the larger it is, the more the triangle faces
    /// the voxel.
    facing: Vec<f32>,
    inside: Vec<bool>,
    /// Whether the voxel is in a list of voxels to be compared, or never is.
    listed: Vec<bool>,
    /// The voxels that never are: those at the border.
    border: Vec<bool>,
    /// The distance of the voxel from the block.
    margin: Vec<f32>,
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
fn margin(voxel: usize) -> f32 {
    let from_low = place(voxel) - (MARGIN + 1);
    let from_high = from_low - (BLOCK - 1);
    let outside = (-from_low).max(from_high).max(IVec3::ZERO);
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
            nearest: vec![NONE; voxels],
            squared: vec![f32::INFINITY; voxels],
            facing: vec![0.0; voxels],
            inside: vec![false; voxels],
            listed: vec![false; voxels],
            border: (0..voxels).map(is_border).collect(),
            margin: (0..voxels).map(margin).collect(),
        }
    }

    /// The leaves of a block, by its triangles relative to the [`band_corner`]; those without area are
    /// `None`.
    pub fn leaves(&mut self, block: IVec3, triangles: &[Option<Triangle>]) -> Vec<Leaf> {
        self.nearest.fill(NONE);
        self.squared.fill(f32::INFINITY);
        self.facing.fill(0.0);
        self.listed.copy_from_slice(&self.border);
        let touched = self.touch(triangles);
        self.spread(triangles, touched);
        let leaves = BLOCK / LEAF;
        let corners = (0..leaves.pow(3))
            .map(|i| IVec3::new(i / leaves.pow(2), i / leaves % leaves, i % leaves) * LEAF);
        corners.filter_map(|corner| self.leaf(block, corner, triangles)).collect()
    }

    /// Compares each triangle with the corners of the cubes that it touches, and returns these.
    fn touch(&mut self, triangles: &[Option<Triangle>]) -> Vec<usize> {
        let mut touched = Vec::new();
        let last = Vec3::splat((EDGE - 2) as f32);
        for (number, triangle) in triangles.iter().enumerate() {
            let Some(triangle) = triangle else { continue };
            let [low, high] = triangle.bounds();
            let low = low.floor().max(Vec3::ONE).as_ivec3();
            let high = high.ceil().min(last).as_ivec3();
            for x in low.x..=high.x {
                for y in low.y..=high.y {
                    for z in low.z..=high.z {
                        let at = IVec3::new(x, y, z);
                        if self.compare_touched(at, triangle, number as u32) {
                            touched.push(index(at));
                        }
                    }
                }
            }
        }
        touched
    }

    /// Compares a voxel with a triangle nearby, and returns whether it is the voxel's first.
    fn compare_touched(&mut self, at: IVec3, triangle: &Triangle, number: u32) -> bool {
        let (index, voxel) = (index(at), at.as_vec3());
        if self.margin[index] > MOST_USEFUL {
            return false;
        }
        let is_first = self.nearest[index] == NONE;
        if !is_first && triangle.least_squared(voxel) > self.squared[index] + EQUAL {
            return false;
        }
        let NearestPoint { squared, .. } = triangle.nearest(voxel);
        let (height, known) = (triangle.height(voxel), self.squared[index]);
        let equal = EQUAL * (2.0 * squared.sqrt() + EQUAL);
        let is_nearer = is_first || squared < known - equal;
        if is_nearer || squared < known + equal && height.abs() > self.facing[index] {
            self.nearest[index] = number;
            self.squared[index] = if is_nearer { squared } else { squared.min(known) };
            self.facing[index] = height.abs();
            self.inside[index] = height < 0.0;
        }
        is_first
    }

    fn spread(&mut self, triangles: &[Option<Triangle>], touched: Vec<usize>) {
        // A triangle that touches none of a voxel's cubes is at least one voxel away.
        let far = touched.iter().copied().filter(|&voxel| self.squared[voxel] > 1.0);
        let far: Vec<_> = far.map(|voxel| (voxel, self.nearest_around(triangles, voxel))).collect();
        self.set(far);
        let mut front = touched;
        while !front.is_empty() {
            let mut next = Vec::new();
            for voxel in front {
                // No nearest triangle of the block's voxels spreads through a voxel further on.
                let left = BAND - self.margin[voxel];
                if self.squared[voxel] >= left * left {
                    continue;
                }
                for &step in &AROUND[..FACES] {
                    let neighbour = voxel.wrapping_add_signed(step);
                    if self.nearest[neighbour] == NONE && !self.listed[neighbour] {
                        self.listed[neighbour] = true;
                        self.inside[neighbour] = self.inside[voxel];
                        next.push(neighbour);
                    }
                }
            }
            let found = next.iter().map(|&voxel| (voxel, self.nearest_around(triangles, voxel)));
            let found = found.collect();
            self.set(found);
            front = next;
        }
    }

    fn set(&mut self, found: Vec<(usize, (u32, f32))>) {
        for (voxel, (nearest, squared)) in found {
            (self.nearest[voxel], self.squared[voxel]) = (nearest, squared);
        }
    }

    /// The nearest of the triangles that a voxel and its 26 neighbours know.
    fn nearest_around(&self, triangles: &[Option<Triangle>], voxel: usize) -> (u32, f32) {
        let at = place(voxel).as_vec3();
        let (mut best, mut squared) = (self.nearest[voxel], self.squared[voxel]);
        for step in AROUND {
            let number = self.nearest[voxel.wrapping_add_signed(step)];
            if number == NONE || number == best {
                continue;
            }
            let triangle = triangles[number as usize].as_ref().expect("voxels know only triangles");
            if triangle.least_squared(at) >= squared - NO_NEARER {
                continue;
            }
            let nearest = triangle.nearest(at).squared;
            if nearest < squared {
                (best, squared) = (number, nearest);
            }
        }
        (best, squared)
    }

    /// A leaf of the block, if any of its voxels is within the band.
    fn leaf(&self, block: IVec3, corner: IVec3, triangles: &[Option<Triangle>]) -> Option<Leaf> {
        let at = |i: usize| {
            let i = i as i32;
            corner + MARGIN + 1 + IVec3::new(i / (LEAF * LEAF), i / LEAF % LEAF, i % LEAF)
        };
        let is_active = |voxel: usize| self.squared[voxel] < BAND * BAND;
        let first = (0..VOXELS).map(|i| index(at(i))).find(|&voxel| is_active(voxel))?;
        let mut leaf = Leaf::at(block * BLOCK + corner);
        for i in 0..VOXELS {
            let place = at(i);
            let voxel = index(place);
            let inside = if is_active(voxel) {
                let number = self.nearest[voxel];
                let triangle = triangles[number as usize].as_ref().expect("one is nearest");
                let NearestPoint { squared, shares } = triangle.nearest(place.as_vec3());
                let distance = if self.inside[voxel] { -squared.sqrt() } else { squared.sqrt() };
                leaf.active[i / 64] |= 1 << (i % 64);
                leaf.voxels.push(LeafVoxel { distance, triangle: number, shares });
                self.inside[voxel]
            } else {
                // No surface is between this voxel and the one before along an axis.
                let edge = LEAF as usize;
                let before =
                    [(i % edge, 1), (i / edge % edge, edge), (i / (edge * edge), edge * edge)]
                        .into_iter()
                        .find(|&(along, _)| along > 0);
                before.map_or(self.inside[first], |(_, step)| leaf.is_inside(i - step))
            };
            leaf.inside[i / 64] |= u64::from(inside) << (i % 64);
        }
        Some(leaf)
    }
}
