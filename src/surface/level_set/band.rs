//! Computes the signed distances of the voxels of one block.
//!
//! Each triangle is compared with all voxels within its [`Reach`]. [`Sides`] finds the side of the
//! surface on which each voxel is.

use glam::{DVec3, IVec3, Vec4};
use multiversion::multiversion;

use super::near::{NearTriangle, NearTriangles};
use super::reach::Reach;
use super::sides::Sides;
use super::triangle::{Triangles, VOXELS_PER_GROUP};
use super::{BAND, BLOCK, LEAF, Leaf, first_voxel};

/// The distance from a block, in voxels, within which a triangle can affect the block's distances.
pub const MARGIN: f64 = BAND as f64 + 0.01;
/// Number of voxels along the edge of a block.
const SIDE: usize = BLOCK as usize;
/// Number of voxels along the edge of a leaf.
const EDGE: usize = LEAF as usize;
/// Number of leaves along the edge of a block.
const LEAVES: usize = SIDE / EDGE;
/// Number of lanes for two triangles.
const PAIR: usize = 2 * VOXELS_PER_GROUP;
/// The least cosine of the angle between the normals of two triangles that are compared together.
const NEARLY_PARALLEL: f64 = 0.9;

/// The distances of the voxels of a block from the triangles near the block.
pub struct Band {
    near: NearTriangles,
    sides: Sides,
    /// The squared distance of each voxel from the nearest triangle, with z varying fastest; the
    /// square of [`BAND`] outside the band.
    squared: Vec<f32>,
    /// The index in `near` of the nearest triangle of each voxel in the band.
    nearest: Vec<u32>,
    /// For each leaf, with z varying fastest, whether a triangle was compared with its voxels.
    touched: [bool; LEAVES.pow(3)],
    /// Memory for [`Reach::groups`].
    groups: Vec<[i8; 4]>,
}

impl Band {
    pub fn new() -> Self {
        let voxels = SIDE.pow(3);
        Self {
            near: NearTriangles::default(),
            sides: Sides::new(),
            squared: vec![BAND * BAND; voxels],
            nearest: vec![0; voxels],
            touched: [false; LEAVES.pow(3)],
            // There is room for one more group, because `Reach::groups` stores a group before it
            // checks whether the group is needed.
            groups: vec![[0; 4]; voxels / VOXELS_PER_GROUP + 1],
        }
    }

    /// Begins a block with this number of triangles nearby.
    pub fn begin(&mut self, triangles: usize) {
        self.near.clear(triangles);
        self.sides.clear();
    }

    /// Adds triangle number `number` of the mesh. `place` returns the position of a vertex,
    /// relative to the block's first voxel.
    pub fn add(&mut self, vertices: [u32; 3], number: u32, place: impl Fn(u32) -> DVec3) {
        let corners = self.near.add(vertices, number, place);
        self.sides.cross(self.near.places(corners));
    }

    /// The leaves of the block that contain voxels of the band. All triangles near the block must
    /// have been added.
    pub fn leaves(&mut self, block: IVec3) -> Vec<Leaf> {
        self.near.find_spreads();
        let near = std::mem::take(&mut self.near);
        let mut index = 0;
        while index < near.triangles.len() {
            index += match &near.triangles[index..] {
                [a, b, ..] if are_alike(a, b) => self.compare::<2, PAIR>(&near, index),
                _ => self.compare::<1, VOXELS_PER_GROUP>(&near, index),
            };
        }
        self.near = near;
        self.sides.find(&self.squared, &self.nearest, &self.near);
        let mut leaves = Vec::new();
        for index in 0..self.touched.len() {
            if std::mem::take(&mut self.touched[index]) {
                let at = [index / (LEAVES * LEAVES), index / LEAVES % LEAVES, index % LEAVES];
                leaves.extend(self.leaf(block, at));
            }
        }
        leaves
    }

    /// Compares N triangles, from number `index` on, with all voxels within their reach. Returns N.
    fn compare<const N: usize, const LANES: usize>(
        &mut self,
        near: &NearTriangles,
        index: usize,
    ) -> usize {
        let group = &near.triangles[index..][..N];
        let Some(reach) = Reach::of(near, group) else { return N };
        self.mark_leaves(reach.first, reach.last());
        let from = reach.first.as_dvec3();
        let mut triangles = Triangles::<LANES>::new();
        for (i, triangle) in group.iter().enumerate() {
            let corners = near.places(triangle.corners).map(|corner| corner - from);
            triangles.set(i, corners, triangle.normal);
        }
        let groups = reach.groups(&mut self.groups);
        let voxels = (&mut *self.squared, &mut *self.nearest);
        compare_groups(&triangles, index as u32, &self.groups[..groups], reach.first, voxels);
        N
    }

    /// Marks the leaves of the voxels from `first` to `last`.
    fn mark_leaves(&mut self, first: IVec3, last: IVec3) {
        let [first, last] = [first / LEAF, last / LEAF].map(IVec3::as_usizevec3);
        for x in first.x..=last.x {
            for y in first.y..=last.y {
                for z in first.z..=last.z {
                    self.touched[(x * LEAVES + y) * LEAVES + z] = true;
                }
            }
        }
    }

    /// Returns the leaf with the coordinates `at`, counted in leaves, if one of its voxels is in
    /// the band. Resets the distances of its voxels.
    fn leaf(&mut self, block: IVec3, at: [usize; 3]) -> Option<Leaf> {
        const WITHIN: &str = "a leaf is in its block";
        let [x, y, z] = at.map(|at| at * EDGE);
        let column = |row: usize| (x + row / EDGE) * SIDE + y + row % EDGE;
        let corner = IVec3::new(x as i32, y as i32, z as i32);
        let mut leaf = Leaf::at(first_voxel(block) + corner);
        let mut count = 0;
        for row in 0..EDGE * EDGE {
            let start = column(row) * SIDE + z;
            let squared = self.squared[start..].first_chunk::<EDGE>().expect(WITHIN);
            let mut active = 0;
            for (i, &squared) in squared.iter().enumerate() {
                active |= u64::from(squared < BAND * BAND) << i;
            }
            count += active.count_ones() as usize;
            let inside = self.sides.inside(column(row)) >> z & 0xff;
            leaf.active[row / EDGE] |= active << (row % EDGE * EDGE);
            leaf.inside[row / EDGE] |= inside << (row % EDGE * EDGE);
        }
        if count == 0 {
            return None;
        }
        leaf.distances.reserve_exact(count);
        leaf.triangles.reserve_exact(count);
        for row in 0..EDGE * EDGE {
            let bits = |words: &[u64; EDGE]| (words[row / EDGE] >> (row % EDGE * EDGE)) as u8;
            let (active, inside) = (bits(&leaf.active), bits(&leaf.inside));
            if active == 0 {
                continue;
            }
            let start = column(row) * SIDE + z;
            let squared = self.squared[start..].first_chunk_mut::<EDGE>().expect(WITHIN);
            let nearest = self.nearest[start..].first_chunk::<EDGE>().expect(WITHIN);
            for i in (0..EDGE).filter(|i| active >> i & 1 == 1) {
                let distance = squared[i].sqrt();
                leaf.distances.push(if inside >> i & 1 == 1 { -distance } else { distance });
                leaf.triangles.push(self.near.triangles[nearest[i] as usize].number);
            }
            *squared = [BAND * BAND; EDGE];
        }
        Some(leaf)
    }
}

/// Compares triangles with groups of [`VOXELS_PER_GROUP`] voxels. `index` is the number of the
/// first triangle. The first voxels of the groups are relative to `first`, the triangles' origin.
/// `voxels` are the squared distances and the nearest triangles of all voxels of the block.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn compare_groups<const LANES: usize>(
    triangles: &Triangles<LANES>,
    index: u32,
    groups: &[[i8; 4]],
    first: IVec3,
    voxels: (&mut [f32], &mut [u32]),
) {
    const WITHIN: &str = "all voxels of a group are in the block";
    let (squared, nearest) = voxels;
    for group in groups {
        let [x, y, z] = [i32::from(group[0]), i32::from(group[1]), i32::from(group[2])];
        let voxel = ((first.x + x) * BLOCK + first.y + y) * BLOCK + first.z + z;
        let found = triangles.squared_distances([x as f32, y as f32, z as f32]);
        let squared = &mut squared[voxel as usize..];
        let squared = squared.first_chunk_mut::<VOXELS_PER_GROUP>().expect(WITHIN);
        let nearest = &mut nearest[voxel as usize..];
        let nearest = nearest.first_chunk_mut::<VOXELS_PER_GROUP>().expect(WITHIN);
        let mut known = Vec4::from_array(*squared);
        // The bits of the triangle numbers, stored as floats. `select` copies them unchanged.
        let mut numbers = Vec4::from_array(nearest.map(f32::from_bits));
        for (number, found) in (index..).zip(found.as_chunks::<VOXELS_PER_GROUP>().0) {
            let found = Vec4::from_array(*found);
            let number = Vec4::splat(f32::from_bits(number));
            numbers = Vec4::select(found.cmplt(known), number, numbers);
            known = found.min(known);
        }
        *squared = known.to_array();
        *nearest = numbers.to_array().map(f32::to_bits);
    }
}

/// Whether two triangles share an edge and are nearly parallel.
fn are_alike(a: &NearTriangle, b: &NearTriangle) -> bool {
    let shared = b.corners.iter().filter(|corner| a.corners.contains(corner)).count();
    shared == 2 && a.normal.dot(b.normal) > NEARLY_PARALLEL
}
