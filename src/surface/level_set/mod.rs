//! A level set: the signed distances of the voxels of a lattice from a closed mesh, in a band of
//! three voxels on either side of the surface. Distances are negative inside the mesh.
//!
//! Space is divided into blocks of 64³ voxels, which do not depend on each other. `Band` computes
//! the distances of one block. A [`Leaf`] of 8³ voxels is stored only if one of its voxels is in
//! the band.

mod band;
mod triangle;
mod volume;

use std::io;

use glam::{DVec3, IVec3};
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::surface::mesh::source::{Indexed, Lattice, MeshSource, Outline};

use band::{Band, BlockTriangles, MARGIN, band_corner};
pub use volume::Volume;

/// Half the width of the band, in voxels.
pub const BAND: f32 = 3.0;
/// Number of voxels along the edge of a leaf.
pub const LEAF: i32 = 8;
/// Number of voxels in a leaf.
pub const VOXELS: usize = (LEAF * LEAF * LEAF) as usize;
/// Number of voxels along the edge of a block.
const BLOCK: i32 = 64;
/// Upper limit, in voxels, on the magnitude of vertex coordinates. With this limit, differences
/// between coordinates fit into an i32.
const FARTHEST: f64 = (1 << 29) as f64;
const TOO_FAR: &str = "a vertex is not finite, or more than 2^29 cells from the grid's origin; \
                       use larger cells";
/// The lattice of an empty mesh.
const UNIT: Lattice = Lattice { origin: [0.0; 3], step: 1.0 };
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

/// The nearest point of a triangle to a voxel.
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

/// A closed mesh in memory, with its positions in voxels.
#[derive(Debug)]
pub struct LevelSet {
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

/// A block, and lists of the triangles near it. The triangle numbers are in ascending order within
/// each list and from list to list.
type BlockLists = (IVec3, Vec<Vec<u32>>);

impl LevelSet {
    /// Reads a closed mesh into memory, which takes 24 bytes for each vertex and 12 bytes for each
    /// triangle.
    ///
    /// # Errors
    /// If `mesh` cannot be read; [`io::ErrorKind::OutOfMemory`] if there is too little memory;
    /// [`io::ErrorKind::InvalidInput`] for a mesh with too many vertices or triangles, or with
    /// coordinates that are not finite or too large.
    pub fn new(mesh: &dyn MeshSource, lattice: Lattice) -> io::Result<Self> {
        let (positions, triangles) = gathered(mesh)?;
        let origin = DVec3::from(lattice.origin);
        let voxel = |position: [f64; 3]| (DVec3::from(position) - origin) / lattice.step;
        // `collect` reuses the memory of the array.
        let positions: Vec<DVec3> = positions.into_iter().map(voxel).collect();
        if !positions.par_iter().all(|place| place.abs().cmplt(DVec3::splat(FARTHEST)).all()) {
            return Err(invalid(TOO_FAR));
        }
        Ok(Self { positions, triangles })
    }

    /// The nearest point of a triangle to a voxel.
    pub fn nearest_point(&self, triangle: u32, voxel: IVec3) -> NearestPoint {
        let corners = self.triangles[triangle as usize];
        let from_voxel = |vertex| self.position(vertex) - voxel.as_dvec3();
        NearestPoint { corners, shares: triangle::shares(corners.map(from_voxel)) }
    }

    fn position(&self, vertex: u32) -> DVec3 {
        self.positions[vertex as usize]
    }

    /// Calls `make` with the leaves of each block, on all threads, and returns the results in an
    /// order that depends only on the mesh. While it runs, its lists take about 6 bytes for each
    /// triangle.
    ///
    /// # Errors
    /// If `make` fails for a block.
    pub fn map<T: Send>(
        &self,
        make: impl Fn(Vec<Leaf>) -> io::Result<T> + Sync,
    ) -> io::Result<Vec<T>> {
        let block = |band: &mut Band, (block, lists): BlockLists| {
            let corner = band_corner(block).as_dvec3();
            let mut near = BlockTriangles::default();
            for number in lists.into_iter().flatten() {
                let corners = self.triangles[number as usize];
                near.add(corners.map(|vertex| self.position(vertex) - corner), number);
            }
            make(band.leaves(block, &near))
        };
        self.blocks().into_par_iter().map_init(Band::new, block).collect()
    }

    /// All blocks with triangles nearby, in the order of their first triangles.
    fn blocks(&self) -> Vec<BlockLists> {
        let lists = |(chunk, triangles): (usize, &[[u32; 3]])| {
            let mut lists = BlocksByPlace::default();
            for (number, corners) in (chunk * TRIANGLES_TOGETHER..).zip(triangles) {
                let corners = corners.map(|vertex| self.position(vertex));
                each_block_near(corners, |block| lists.of(block).push(number as u32));
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
}

impl<T> Default for BlocksByPlace<T> {
    fn default() -> Self {
        Self { blocks: Vec::new(), numbers: HashMap::new() }
    }
}

impl<T> BlocksByPlace<T> {
    fn of(&mut self, block: IVec3) -> &mut Vec<T> {
        let number = *self.numbers.entry(block).or_insert_with(|| {
            self.blocks.push((block, Vec::new()));
            self.blocks.len() - 1
        });
        &mut self.blocks[number].1
    }
}

/// Calls `take` with each block that is near a triangle: at most [`MARGIN`] voxels away from the
/// triangle's bounding box and from its plane.
fn each_block_near([a, b, c]: [DVec3; 3], mut take: impl FnMut(IVec3)) {
    let reach = f64::from(MARGIN);
    let [low, high] = [block_of(a.min(b).min(c) - reach), block_of(a.max(b).max(c) + reach + 1.0)];
    if low == high {
        return take(low);
    }
    let normal = (b - a).cross(c - a);
    // Half the extent along the normal of a block that is enlarged by `reach` on each side.
    let extent = normal.abs().element_sum() * (f64::from(BLOCK) / 2.0 + reach);
    let is_near = |block: IVec3| {
        let centre = (block.as_dvec3() + 0.5) * f64::from(BLOCK);
        normal.dot(centre - a).abs() <= extent
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

/// The block that contains a place.
fn block_of(place: DVec3) -> IVec3 {
    // The sum is positive, and converting a positive number to an integer rounds down without a
    // function call.
    let blocks = (place + 2.0 * FARTHEST).as_uvec3() / BLOCK as u32;
    blocks.as_ivec3() - 2 * FARTHEST as i32 / BLOCK
}

fn invalid(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, what.to_owned())
}

/// The positions of all vertices, and all triangles.
fn gathered(mesh: &dyn MeshSource) -> io::Result<Indexed> {
    let Outline { vertices, triangles, pieces, .. } = mesh.outline();
    if vertices > u64::from(u32::MAX) || triangles >= u64::from(u32::MAX) {
        return Err(invalid("a level set needs a mesh of at most 4294967295 triangles"));
    }
    if let Some(indexed) = mesh.at_once()? {
        return Ok(indexed);
    }
    let mut positions = Vec::new();
    let mut all: Vec<[u32; 3]> = Vec::new();
    positions.try_reserve_exact(vertices as usize).map_err(|_| io::ErrorKind::OutOfMemory)?;
    all.try_reserve_exact(triangles as usize).map_err(|_| io::ErrorKind::OutOfMemory)?;
    for piece in 0..pieces {
        positions.extend_from_slice(&mesh.vertices(piece)?.positions);
    }
    for piece in 0..pieces {
        all.extend(mesh.triangles(piece)?.into_iter().map(|corners| corners.map(|v| v as u32)));
    }
    Ok((positions, all))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::Mesh;

    /// The distance of a voxel from the surface, computed from the shares of the nearest triangle's
    /// corners.
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
    fn octahedron(centre: [f64; 3], radius: f64) -> Mesh {
        let corner = |axis: usize, sign: f64| -> [f64; 3] {
            std::array::from_fn(|k| centre[k] + if k == axis { sign * radius } else { 0.0 })
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

    #[test]
    fn distances_of_an_octahedron_are_exact_and_negative_inside() {
        const RADIUS: f64 = 61.3;
        let centre = [0.25, -0.125, 64.5];
        let lattice = Lattice { origin: [0.0; 3], step: 1.0 };
        let level_set = LevelSet::new(&octahedron(centre, RADIUS), lattice).unwrap();
        let mut checked = 0;
        for leaf in level_set.map(Ok).unwrap().into_iter().flatten() {
            let mut distances = leaf.distances.iter();
            for i in 0..VOXELS {
                let at = leaf.corner + place_in_leaf(i);
                let from_centre = (at.as_dvec3() - DVec3::from(centre)).abs().element_sum();
                let inside = from_centre < RADIUS;
                assert_eq!(leaf.is_inside(i), inside, "{at}");
                let exact = distance(&level_set, at);
                let is_active = leaf.active[i / 64] >> (i % 64) & 1 == 1;
                if (exact - 3.0).abs() > 1e-4 {
                    assert_eq!(is_active, exact < 3.0, "{at}: {exact}");
                }
                if is_active {
                    let expected = if inside { -exact } else { exact };
                    let found = f64::from(*distances.next().unwrap());
                    assert!((found - expected).abs() < 1e-4, "{at}: {found}, not {expected}");
                    checked += 1;
                }
            }
        }
        // The band is six voxels thick.
        let area = 8.0 * 3f64.sqrt() / 4.0 * (2f64.sqrt() * RADIUS).powi(2);
        assert!((f64::from(checked) / (6.0 * area) - 1.0).abs() < 0.05, "{checked} of {area}");
    }

    #[test]
    fn a_mesh_that_is_not_finite_or_too_far_away_is_refused() {
        let lattice = Lattice { origin: [0.0; 3], step: 1.0 };
        for far in [f64::NAN, f64::INFINITY, 1e9] {
            for axis in 0..3 {
                let mut mesh = octahedron([0.0; 3], 5.0);
                mesh.positions[0][axis] = far;
                let fault = LevelSet::new(&mesh, lattice).unwrap_err();
                assert_eq!(fault.kind(), io::ErrorKind::InvalidInput, "{far} along {axis}");
            }
        }
    }

    #[test]
    fn blocks_are_near_the_plane_of_a_large_triangle_and_not_only_its_box() {
        let corners = [[0.0; 3], [4000.0, 0.0, 4000.0], [0.0, 4000.0, 4000.0]].map(DVec3::from);
        let mut blocks = 0;
        each_block_near(corners, |_| blocks += 1);
        assert!((62 * 62..10 * 62 * 62).contains(&blocks), "{blocks}");
    }
}
