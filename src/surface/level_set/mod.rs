//! A level set: the signed distances of the voxels of a lattice from a closed mesh, in a band of
//! three voxels on either side of the surface. Distances are negative inside the mesh.
//!
//! Space is divided into blocks of 64³ voxels, which do not depend on each other. `Band` computes
//! the distances of one block. A [`Leaf`] of 8³ voxels is stored only if one of its voxels is in
//! the band.

mod band;
mod near;
mod parts;
mod reach;
mod sides;
mod triangle;
mod volume;

use std::io;

use glam::{DVec3, IVec3};
use hashbrown::{HashMap, HashSet};
use rayon::prelude::*;

use crate::surface::mesh::source::{Lattice, Outline};

use band::{Band, MARGIN};
#[cfg(test)]
pub use parts::wavy_sheet::WavySheet;
pub use parts::{for_each_part, part_bytes};
pub use volume::Volume;

/// Half the width of the band, in voxels.
pub const BAND: f32 = 3.0;
/// Number of voxels along the edge of a leaf.
pub const LEAF: i32 = 8;
/// Number of voxels in a leaf.
pub const VOXELS: usize = (LEAF * LEAF * LEAF) as usize;
/// Number of voxels along the edge of a block.
const BLOCK: i32 = 64;
/// Number of voxels from the first voxel of block 0 to the lattice's origin. Tanks often begin at
/// the origin; if a block began there, many triangles would be near two blocks.
const SHIFT: i32 = LEAF;
/// Upper limit, in voxels, on the magnitude of vertex coordinates. With this limit, differences
/// between coordinates fit into an i32.
const FARTHEST: f64 = (1 << 29) as f64;
/// Upper limit on the error of a cross product, relative to the lengths of both vectors.
const NORMAL_ERROR: f64 = 1e-14;
const TOO_FAR: &str = "a vertex is not finite, or more than 2^29 cells from the grid's origin; \
                       use larger cells";
/// The lattice of an empty mesh.
const UNIT: Lattice = Lattice { origin: [0.0; 3], step: 1.0 };
/// Number of blocks that are computed together, per thread.
const BLOCKS_PER_THREAD: usize = 8;
/// Number of triangles that one task assigns to blocks.
const TRIANGLES_TOGETHER: usize = 1 << 14;

/// 8³ voxels, numbered with z varying fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Leaf {
    /// The coordinates of the first voxel, which are multiples of 8.
    pub corner: IVec3,
    /// A bit for each voxel: whether it is in the band.
    pub active: [u64; VOXELS / 64],
    /// A bit for each voxel: whether it is inside the surface.
    pub inside: [u64; VOXELS / 64],
    /// For each voxel in the band, its distance from the surface in voxels, negative inside.
    pub distances: Vec<f32>,
    /// For each voxel in the band, the number of the nearest triangle.
    pub triangles: Vec<u32>,
}

impl Leaf {
    fn at(corner: IVec3) -> Self {
        Self {
            corner,
            active: [0; VOXELS / 64],
            inside: [0; VOXELS / 64],
            distances: Vec::new(),
            triangles: Vec::new(),
        }
    }

    /// Whether voxel number `i` is inside the surface.
    fn is_inside(&self, i: usize) -> bool {
        self.inside[i / 64] >> (i % 64) & 1 == 1
    }
}

/// The coordinates of voxel number `i` of a leaf, relative to the leaf's first voxel.
pub fn place_in_leaf(i: usize) -> IVec3 {
    let i = i as i32;
    IVec3::new(i / (LEAF * LEAF), i / LEAF % LEAF, i % LEAF)
}

/// The point of a triangle that is nearest to a voxel.
#[derive(Debug, Clone, Copy)]
pub struct NearestPoint {
    /// The vertices of the triangle.
    pub corners: [u32; 3],
    /// The weight of each vertex in the nearest point; the sum of the weights is 1.
    pub shares: [f32; 3],
}

/// The lattice of the samples from which a mesh was made, if it is known. For an empty mesh, whose
/// lattice does not matter, `UNIT` replaces an unknown lattice.
pub fn lattice_of(outline: &Outline) -> Option<Lattice> {
    outline.lattice.or((outline.triangles == 0).then_some(UNIT))
}

/// A closed mesh, or all of its triangles near some blocks, in memory. Positions are in voxels.
#[derive(Debug, Default)]
pub struct LevelSet {
    positions: Vec<DVec3>,
    /// The values of each attribute of the mesh, with the components of each vertex contiguous.
    /// Integers are stored as their 32 bits.
    pub attributes: Vec<Vec<f32>>,
    triangles: Vec<[u32; 3]>,
    /// The blocks near which all triangles are in memory; `None` for a whole mesh.
    part: Option<HashSet<IVec3>>,
}

/// A block, and lists of the triangles near it. The triangle numbers are in ascending order within
/// each list and from list to list.
type BlockLists = (IVec3, Vec<Vec<u32>>);

impl LevelSet {
    /// The point of a triangle that is nearest to a voxel.
    #[inline]
    pub fn nearest_point(&self, triangle: u32, voxel: IVec3) -> NearestPoint {
        let corners = self.triangles[triangle as usize];
        let from_voxel = |vertex| self.position(vertex) - voxel.as_dvec3();
        NearestPoint { corners, shares: triangle::shares(corners.map(from_voxel)) }
    }

    fn position(&self, vertex: u32) -> DVec3 {
        self.positions[vertex as usize]
    }

    /// Calls `make` with the leaves of each block, on all threads, and `take` with the results, one
    /// after another. The order depends only on the mesh. The results of a few blocks are in memory
    /// at a time. The lists of triangles near each block take about 6 bytes for each triangle.
    ///
    /// # Errors
    /// If `make` or `take` fails for a block.
    pub fn for_each_block<T: Send>(
        &self,
        make: impl Fn(Vec<Leaf>) -> io::Result<T> + Sync,
        mut take: impl FnMut(T) -> io::Result<()>,
    ) -> io::Result<()> {
        let block = |band: &mut Band, (block, lists): BlockLists| {
            let corner = first_voxel(block).as_dvec3();
            band.begin(lists.iter().map(Vec::len).sum());
            for number in lists.into_iter().flatten() {
                let corners = self.triangles[number as usize];
                band.add(corners, number, |vertex| self.position(vertex) - corner);
            }
            make(band.leaves(block))
        };
        let mut blocks = self.blocks().into_iter();
        let at_once = BLOCKS_PER_THREAD * rayon::current_num_threads();
        loop {
            let next: Vec<_> = blocks.by_ref().take(at_once).collect();
            if next.is_empty() {
                return Ok(());
            }
            let made = next.into_par_iter().map_init(Band::new, &block);
            made.collect::<io::Result<Vec<T>>>()?.into_iter().try_for_each(&mut take)?;
        }
    }

    /// The blocks with triangles nearby, in the order of their first triangles.
    fn blocks(&self) -> Vec<BlockLists> {
        let lists = |(chunk, triangles): (usize, &[[u32; 3]])| {
            let mut lists = BlocksByPlace::default();
            for (number, corners) in (chunk * TRIANGLES_TOGETHER..).zip(triangles) {
                let corners = corners.map(|vertex| self.position(vertex));
                each_block_near(corners, |block| {
                    if self.part.as_ref().is_none_or(|part| part.contains(&block)) {
                        lists.of(block).push(number as u32);
                    }
                });
            }
            lists.blocks
        };
        let chunks = self.triangles.par_chunks(TRIANGLES_TOGETHER).enumerate();
        let chunks: Vec<Vec<(IVec3, Vec<u32>)>> = chunks.map(lists).collect();
        let mut all = BlocksByPlace::default();
        chunks.into_iter().flatten().for_each(|(block, list)| all.of(block).push(list));
        all.blocks
    }
}

/// A list for each block. The blocks are in the order in which `of` was first called for them.
#[derive(Debug)]
struct BlocksByPlace<T> {
    blocks: Vec<(IVec3, Vec<T>)>,
    numbers: HashMap<IVec3, usize>,
    /// The number of the block for which `of` was called last.
    last: usize,
}

impl<T> Default for BlocksByPlace<T> {
    fn default() -> Self {
        Self { blocks: Vec::new(), numbers: HashMap::new(), last: 0 }
    }
}

impl<T> BlocksByPlace<T> {
    fn of(&mut self, block: IVec3) -> &mut Vec<T> {
        // Consecutive triangles of a mesh are mostly in the same block.
        if self.blocks.get(self.last).is_none_or(|&(last, _)| last != block) {
            self.last = *self.numbers.entry(block).or_insert_with(|| {
                self.blocks.push((block, Vec::new()));
                self.blocks.len() - 1
            });
        }
        &mut self.blocks[self.last].1
    }
}

/// Calls `take` with each block that is near a triangle: at most [`MARGIN`] voxels away from the
/// triangle's bounding box and from its plane.
fn each_block_near([a, b, c]: [DVec3; 3], mut take: impl FnMut(IVec3)) {
    let [low, high] = [block_of(a.min(b).min(c) - MARGIN), block_of(a.max(b).max(c) + MARGIN)];
    if low == high {
        return take(low);
    }
    let normal = (b - a).cross(c - a);
    // Half the extent, along the normal, of a block that is enlarged by the margin on each side.
    let extent = normal.abs().element_sum() * (f64::from(BLOCK) / 2.0 + MARGIN);
    // The test allows for the error of the normal, because the normal of a triangle whose corners
    // are almost on a line has no correct digits.
    let error = NORMAL_ERROR * (b - a).length() * (c - a).length();
    let is_near = |block: IVec3| {
        let from_corner = (first_voxel(block) + BLOCK / 2).as_dvec3() - a;
        normal.dot(from_corner).abs() <= extent + error * from_corner.length()
    };
    for x in low.x..=high.x {
        for y in low.y..=high.y {
            for z in low.z..=high.z {
                let block = IVec3::new(x, y, z);
                if is_near(block) {
                    take(block);
                }
            }
        }
    }
}

/// The coordinates of a block's first voxel.
fn first_voxel(block: IVec3) -> IVec3 {
    block * BLOCK - SHIFT
}

/// The block that contains a place.
fn block_of(place: DVec3) -> IVec3 {
    // The sum is positive, and converting a positive number to an integer rounds down without a
    // function call.
    let blocks = (place + (2.0 * FARTHEST + f64::from(SHIFT))).as_uvec3() / BLOCK as u32;
    blocks.as_ivec3() - 2 * FARTHEST as i32 / BLOCK
}

fn invalid(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, what.to_owned())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::surface::mesh::Mesh;

    /// The level set of a whole mesh.
    fn whole(mesh: &Mesh, lattice: Lattice) -> io::Result<LevelSet> {
        let mut whole = LevelSet::default();
        for_each_part(mesh, lattice, None, |part| {
            whole = part;
            Ok(())
        })?;
        Ok(whole)
    }

    /// All leaves.
    fn leaves(level_set: &LevelSet) -> Vec<Leaf> {
        let mut all = Vec::new();
        let take = |leaves| {
            all.extend::<Vec<Leaf>>(leaves);
            Ok(())
        };
        level_set.for_each_block(Ok, take).unwrap();
        all
    }

    /// The distance of a voxel from the surface, computed from the weights of the nearest
    /// triangle's corners.
    fn distance(level_set: &LevelSet, voxel: IVec3) -> f64 {
        let nearest = |triangle: u32| {
            let NearestPoint { corners, shares } = level_set.nearest_point(triangle, voxel);
            let share =
                |(&corner, share): (&u32, f32)| level_set.position(corner) * f64::from(share);
            let point: DVec3 = corners.iter().zip(shares).map(share).sum();
            point.distance(voxel.as_dvec3())
        };
        (0..level_set.triangles.len() as u32).map(nearest).fold(f64::MAX, f64::min)
    }

    /// An octahedron around `centre`, whose faces point outwards.
    fn octahedron(centre: [f64; 3], radii: [f64; 3]) -> Mesh {
        let corner = |axis: usize, sign: f64| -> [f64; 3] {
            std::array::from_fn(|k| centre[k] + if k == axis { sign * radii[k] } else { 0.0 })
        };
        let positions: Vec<_> =
            [0, 1, 2].into_iter().flat_map(|k| [corner(k, 1.0), corner(k, -1.0)]).collect();
        let faces = |[x, y, z]: [u32; 3]| {
            let odd = (x + y + z) % 2 == 1;
            if odd { [x, 4 + z, 2 + y] } else { [x, 2 + y, 4 + z] }
        };
        let triangles = (0..8).map(|i| faces([i & 1, i >> 1 & 1, i >> 2])).collect();
        Mesh { positions, triangles, ..Mesh::default() }
    }

    /// Compares the distance of each voxel in the band with the least distance from any triangle.
    /// Returns the number of voxels in the band.
    fn check_distances(level_set: &LevelSet) -> i32 {
        let mut checked = 0;
        for leaf in leaves(level_set) {
            let mut distances = leaf.distances.iter();
            for i in 0..VOXELS {
                let at = leaf.corner + place_in_leaf(i);
                let exact = distance(level_set, at);
                let is_active = leaf.active[i / 64] >> (i % 64) & 1 == 1;
                if (exact - 3.0).abs() > 1e-4 {
                    assert_eq!(is_active, exact < 3.0, "{at}: {exact}");
                }
                if is_active {
                    let found = f64::from(distances.next().unwrap().abs());
                    assert!((found - exact).abs() < 1e-4, "{at}: {found}, not {exact}");
                    checked += 1;
                }
            }
        }
        checked
    }

    /// Compares all distances and sides of an octahedron with the exact ones. Returns the number of
    /// voxels in the band.
    fn check_octahedron(centre: [f64; 3], radii: [f64; 3]) -> i32 {
        let lattice = Lattice { origin: [0.0; 3], step: 1.0 };
        let level_set = whole(&octahedron(centre, radii), lattice).unwrap();
        for leaf in leaves(&level_set) {
            for i in 0..VOXELS {
                let at = leaf.corner + place_in_leaf(i);
                let from_centre = (at.as_dvec3() - DVec3::from(centre)) / DVec3::from(radii);
                let inside = from_centre.abs().element_sum() < 1.0;
                if distance(&level_set, at) > 1e-5 {
                    assert_eq!(leaf.is_inside(i), inside, "{radii:?}: {at}");
                }
            }
        }
        check_distances(&level_set)
    }

    /// A closed mesh of `rings` rings of vertices, whose distances from the origin are random.
    fn lumpy_ball(radius: f64, rings: u32) -> Mesh {
        let mut state = u64::from(rings);
        let mut random = || {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
            (state >> 33) as f64 / f64::from(1u32 << 31)
        };
        let around = 2 * rings;
        let mut mesh = Mesh::default();
        for ring in 0..=rings + 1 {
            let (sin, cos) = libm::sincos(PI * f64::from(ring) / f64::from(rings + 1));
            let at_pole = ring == 0 || ring == rings + 1;
            for k in 0..if at_pole { 1 } else { around } {
                let (y, x) = libm::sincos(2.0 * PI * f64::from(k) / f64::from(around));
                let place = DVec3::new(x * sin, y * sin, cos) * radius * (0.8 + 0.4 * random());
                mesh.positions.push(place.to_array());
            }
        }
        let last = mesh.positions.len() as u32 - 1;
        for k in 0..around {
            let at = |ring: u32, k: u32| 1 + ring * around + k % around;
            mesh.triangles.push([0, at(0, k), at(0, k + 1)]);
            mesh.triangles.push([last, at(rings - 1, k + 1), at(rings - 1, k)]);
            for ring in 1..rings {
                let [a, b] = [at(ring - 1, k), at(ring - 1, k + 1)];
                let [c, d] = [at(ring, k), at(ring, k + 1)];
                mesh.triangles.extend([[a, c, d], [a, d, b]]);
            }
        }
        mesh
    }

    #[test]
    fn distances_of_small_random_triangles_are_exact() {
        for (radius, rings) in [(2.0, 4), (9.0, 8), (9.0, 16)] {
            let lattice = Lattice { origin: [0.3, -0.2, 0.1], step: 1.0 };
            let level_set = whole(&lumpy_ball(radius, rings), lattice).unwrap();
            assert!(check_distances(&level_set) > 300);
        }
    }

    #[test]
    fn distances_of_an_octahedron_are_exact_and_negative_inside() {
        const RADIUS: f64 = 61.3;
        let checked = check_octahedron([0.25, -0.125, 64.5], [RADIUS; 3]);
        // The band is six voxels thick.
        let area = 8.0 * 3f64.sqrt() / 4.0 * (2f64.sqrt() * RADIUS).powi(2);
        assert!((f64::from(checked) / (6.0 * area) - 1.0).abs() < 0.05, "{checked} of {area}");
    }

    #[test]
    fn distances_of_needles_and_blades_are_exact_and_negative_inside() {
        for centre in [[0.0; 3], [0.5, 0.0, 0.0], [0.25, -0.125, 56.0], [-8.0, 0.3, 0.7]] {
            for radii in [[40.0, 0.7, 0.7], [1.0, 30.0, 1.0], [0.6, 0.6, 20.0], [9.0, 9.0, 0.4]] {
                assert!(check_octahedron(centre, radii) > 500);
            }
            check_octahedron(centre, [0.2, 12.0, 9.0]);
        }
    }

    /// The surface of a box of `size` unit squares along each axis, each made of two triangles.
    fn tiled_box(low: [f64; 3], size: [u32; 3]) -> Mesh {
        let mut numbers = HashMap::new();
        let mut mesh = Mesh::default();
        let mut vertex = |at: [u32; 3]| {
            *numbers.entry(at).or_insert_with(|| {
                mesh.positions.push(std::array::from_fn(|k| low[k] + f64::from(at[k])));
                mesh.positions.len() as u32 - 1
            })
        };
        let mut triangles = Vec::new();
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for end in [0, size[axis]] {
                for i in 0..size[u] * size[v] {
                    let mut at = [0; 3];
                    (at[axis], at[u], at[v]) = (end, i % size[u], i / size[u]);
                    let [a, b, c, d] = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[du, dv]| {
                        let mut to = at;
                        (to[u], to[v]) = (at[u] + du, at[v] + dv);
                        vertex(to)
                    });
                    let square = [[a, b, c], [a, c, d]];
                    triangles.extend(if end > 0 {
                        square
                    } else {
                        square.map(|[a, b, c]| [a, c, b])
                    });
                }
            }
        }
        mesh.triangles = triangles;
        mesh
    }

    #[test]
    fn walls_midway_between_voxels_have_the_right_sides_in_every_block() {
        let lattice = Lattice { origin: [0.0; 3], step: 1.0 };
        for (low, size) in [([-20.5, 0.5, -70.5], [150, 6, 180]), ([3.5, -40.0, 0.5], [4, 140, 90])]
        {
            let level_set = whole(&tiled_box(low, size), lattice).unwrap();
            let (low, size) = (DVec3::from(low), DVec3::from(size.map(f64::from)));
            let mut checked = 0;
            // Each block reuses the memory of the blocks before it.
            for leaf in leaves(&level_set) {
                for i in 0..VOXELS {
                    let at = leaf.corner + place_in_leaf(i);
                    let from_faces = (at.as_dvec3() - low).min(low + size - at.as_dvec3());
                    let inside = from_faces.min_element();
                    if inside != 0.0 {
                        assert_eq!(leaf.is_inside(i), inside > 0.0, "{at}");
                        checked += 1;
                    }
                }
            }
            assert!(checked > 100_000, "{checked}");
        }
    }

    #[test]
    fn two_bodies_that_overlap_are_inside_in_both() {
        let radii = [12.0, 12.0, 30.0];
        // With the second pair, columns enter both bodies in the same step.
        for centres in [[[0.3, 0.2, 0.1], [9.3, 3.2, 10.1]], [[0.3, 0.2, 0.1], [0.5, 0.3, 0.4]]] {
            let [mut mesh, other] = centres.map(|centre| octahedron(centre, radii));
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(other.positions);
            mesh.triangles.extend(other.triangles.iter().map(|corners| corners.map(|v| v + first)));
            let lattice = Lattice { origin: [0.0; 3], step: 1.0 };
            let level_set = whole(&mesh, lattice).unwrap();
            let mut checked = 0;
            for leaf in leaves(&level_set) {
                for i in 0..VOXELS {
                    let at = (leaf.corner + place_in_leaf(i)).as_dvec3();
                    let [a, b] = centres.map(|centre| {
                        ((at - DVec3::from(centre)) / DVec3::from(radii)).abs().element_sum()
                    });
                    if (a - 1.0).abs() > 1e-5 && (b - 1.0).abs() > 1e-5 {
                        assert_eq!(leaf.is_inside(i), a.min(b) < 1.0, "{at}");
                        checked += 1;
                    }
                }
            }
            assert!(checked > 10_000, "{checked}");
        }
    }

    #[test]
    fn a_small_body_that_is_inside_out_changes_no_side_outside() {
        let mut mesh = octahedron([0.3, 0.2, 0.1], [12.0, 12.0, 30.0]);
        let small = octahedron([18.3, 0.2, 0.1], [2.3; 3]);
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(small.positions);
        mesh.triangles
            .extend(small.triangles.iter().map(|&[a, b, c]| [a, c, b].map(|v| v + first)));
        let lattice = Lattice { origin: [0.0; 3], step: 1.0 };
        let level_set = whole(&mesh, lattice).unwrap();
        let mut checked = 0;
        for leaf in leaves(&level_set) {
            for i in 0..VOXELS {
                let at = leaf.corner + place_in_leaf(i);
                let from_small = (at.as_dvec3() - DVec3::new(18.3, 0.2, 0.1)).abs().element_sum();
                if from_small > 2.3 && distance(&level_set, at) > 0.51 {
                    let from_centre = (at.as_dvec3() - DVec3::new(0.3, 0.2, 0.1)).abs();
                    let within = from_centre / DVec3::new(12.0, 12.0, 30.0);
                    assert_eq!(leaf.is_inside(i), within.element_sum() < 1.0, "{at}");
                    checked += 1;
                }
            }
        }
        assert!(checked > 10_000, "{checked}");
    }

    #[test]
    fn a_mesh_that_is_not_finite_or_too_far_away_is_refused() {
        let lattice = Lattice { origin: [0.0; 3], step: 1.0 };
        for far in [f64::NAN, f64::INFINITY, 1e9] {
            for axis in 0..3 {
                let mut mesh = octahedron([0.0; 3], [5.0; 3]);
                mesh.positions[0][axis] = far;
                let fault = whole(&mesh, lattice).unwrap_err();
                assert_eq!(fault.kind(), io::ErrorKind::InvalidInput, "{far} along {axis}");
            }
        }
    }

    #[test]
    fn only_blocks_near_the_plane_of_a_large_triangle_are_visited() {
        let corners = [[0.0; 3], [4000.0, 0.0, 4000.0], [0.0, 4000.0, 4000.0]].map(DVec3::from);
        let mut blocks = 0;
        each_block_near(corners, |_| blocks += 1);
        assert!((62 * 62..10 * 62 * 62).contains(&blocks), "{blocks}");
    }
}
