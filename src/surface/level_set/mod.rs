//! A level set: the signed distance from a closed mesh at the voxels of a lattice, negative inside,
//! in a band of three voxels on either side of the surface.
//!
//! Space is cut into blocks of 64³ voxels, which do not depend on each other. [`Band`] computes the
//! distances of one. Only the 8³ voxels of a [`Leaf`] with a voxel in the band are stored; all other
//! voxels are inside or outside.

mod band;
mod triangle;

use std::io;
use std::ops::Range;

use glam::{DVec3, IVec3};
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::surface::mesh::source::{Lattice, MeshSource, Outline};

use band::{Band, band_corner};
use triangle::Triangle;

/// Half the width of the band, in voxels.
pub const BAND: f32 = 3.0;
/// Voxels along the edge of a leaf.
pub const LEAF: i32 = 8;
/// Voxels of a leaf.
pub const VOXELS: usize = (LEAF * LEAF * LEAF) as usize;
/// Voxels along the edge of a block.
const BLOCK: i32 = 64;
/// Largest coordinate of a voxel.
const FARTHEST: f64 = (1 << 30) as f64;

/// A voxel in the band.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeafVoxel {
    /// The distance from the surface in voxels, negative inside.
    pub distance: f32,
    /// The triangle with the nearest point.
    pub triangle: u32,
    /// The shares of its corners in that point; their sum is 1.
    pub shares: [f32; 3],
}

/// 8³ voxels, numbered with z fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Leaf {
    /// The coordinates of the first voxel, which are multiples of 8.
    pub corner: IVec3,
    /// Bits of the voxels in the band.
    pub active: [u64; VOXELS / 64],
    /// Bits of the voxels inside the surface.
    pub inside: [u64; VOXELS / 64],
    /// The voxels in the band, in order.
    pub voxels: Vec<LeafVoxel>,
}

impl Leaf {
    fn at(corner: IVec3) -> Self {
        Self { corner, active: [0; 8], inside: [0; 8], voxels: Vec::new() }
    }

    /// The number of voxels inside the surface that are not in the band.
    pub fn inside_the_surface(&self) -> usize {
        let words = self.inside.iter().zip(&self.active);
        words.map(|(inside, active)| (inside & !active).count_ones() as usize).sum()
    }

    /// The least and the greatest coordinates of the voxels in the band.
    pub fn bounds(&self) -> [IVec3; 2] {
        let is_active = |i: &usize| self.active[i / 64] >> (i % 64) & 1 == 1;
        let place = |i: usize| {
            IVec3::new(i as i32 / (LEAF * LEAF), i as i32 / LEAF % LEAF, i as i32 % LEAF)
        };
        let mut places = (0..VOXELS).filter(is_active).map(place);
        let first = places.next().unwrap_or_default();
        let [low, high] = places.fold([first; 2], |[low, high], at| [low.min(at), high.max(at)]);
        [self.corner + low, self.corner + high]
    }

    /// Whether voxel number `i` is inside the surface.
    pub fn is_inside(&self, i: usize) -> bool {
        self.inside[i / 64] >> (i % 64) & 1 == 1
    }
}

/// A mesh in memory, with the triangles of each block.
#[derive(Debug)]
pub struct LevelSet {
    /// The positions of the vertices, in voxels.
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    blocks: Vec<IVec3>,
    /// For each block the range of its triangles in `lists`.
    ranges: Vec<Range<usize>>,
    lists: Vec<u32>,
}

impl LevelSet {
    /// Reads a closed mesh into memory: 24 bytes for each vertex, and about 30 for each triangle.
    ///
    /// # Errors
    /// Those of `mesh`; [`io::ErrorKind::OutOfMemory`]; and [`io::ErrorKind::InvalidInput`] for a
    /// mesh with too many vertices or that extends too far.
    pub fn new(mesh: &dyn MeshSource, lattice: Lattice) -> io::Result<Self> {
        let (positions, triangles) = gathered(mesh, lattice)?;
        let mut numbers: HashMap<IVec3, u32> = HashMap::new();
        let mut blocks = Vec::new();
        let mut counts: Vec<usize> = Vec::new();
        each_block(&positions, &triangles, |block, _| {
            let number = *numbers.entry(block).or_insert_with(|| {
                blocks.push(block);
                counts.push(0);
                blocks.len() as u32 - 1
            });
            counts[number as usize] += 1;
        });
        let ends = counts.iter().scan(0, |end, count| {
            *end += count;
            Some(*end)
        });
        let ranges: Vec<_> = ends.zip(&counts).map(|(end, count)| end - count..end).collect();
        let mut lists = Vec::new();
        let all = ranges.last().map_or(0, |range| range.end);
        lists.try_reserve_exact(all).map_err(|_| io::ErrorKind::OutOfMemory)?;
        lists.resize(all, 0);
        let mut next: Vec<_> = ranges.iter().map(|range| range.start).collect();
        each_block(&positions, &triangles, |block, triangle| {
            let next = &mut next[numbers[&block] as usize];
            lists[*next] = triangle;
            *next += 1;
        });
        Ok(Self { positions, triangles, blocks, ranges, lists })
    }

    /// The corners of a triangle.
    pub fn corners(&self, triangle: u32) -> [u32; 3] {
        self.triangles[triangle as usize]
    }

    /// Calls `make` with the leaves of each block, on all threads, and returns the results in an
    /// order that depends only on the mesh.
    pub fn map<T: Send>(&self, make: impl Fn(Vec<Leaf>) -> T + Sync) -> Vec<T> {
        let block = |band: &mut Band, (&block, range): (&IVec3, &Range<usize>)| {
            make(self.leaves(band, block, &self.lists[range.clone()]))
        };
        self.blocks.par_iter().zip(&self.ranges).map_init(Band::new, block).collect()
    }

    fn leaves(&self, band: &mut Band, block: IVec3, list: &[u32]) -> Vec<Leaf> {
        let corner = band_corner(block).as_dvec3();
        let place = |vertex: u32| (self.positions[vertex as usize] - corner).as_vec3();
        let triangles: Vec<_> =
            list.iter().map(|&t| Triangle::new(self.corners(t).map(place))).collect();
        let mut leaves = band.leaves(block, &triangles);
        let voxels = leaves.iter_mut().flat_map(|leaf| &mut leaf.voxels);
        voxels.for_each(|voxel| voxel.triangle = list[voxel.triangle as usize]);
        leaves
    }
}

/// Calls `take` with each triangle and each block whose voxels can be near it.
fn each_block(positions: &[DVec3], triangles: &[[u32; 3]], mut take: impl FnMut(IVec3, u32)) {
    for (number, triangle) in (0..).zip(triangles) {
        let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
        let low = (a.min(b).min(c) - f64::from(BAND)).floor().as_ivec3();
        let high = (a.max(b).max(c) + f64::from(BAND)).ceil().as_ivec3();
        let edge = IVec3::splat(BLOCK);
        let (low, high) = (low.div_euclid(edge), high.div_euclid(edge));
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    take(IVec3::new(x, y, z), number);
                }
            }
        }
    }
}

/// All positions in voxels, and all triangles.
fn gathered(mesh: &dyn MeshSource, lattice: Lattice) -> io::Result<(Vec<DVec3>, Vec<[u32; 3]>)> {
    let Outline { vertices, triangles, pieces, .. } = mesh.outline();
    let invalid = |what: &str| io::Error::new(io::ErrorKind::InvalidInput, what.to_owned());
    if vertices > u64::from(u32::MAX) || triangles >= u64::from(u32::MAX) {
        return Err(invalid("a level set needs a mesh of at most 4294967295 triangles"));
    }
    let mut positions: Vec<DVec3> = Vec::new();
    let mut all: Vec<[u32; 3]> = Vec::new();
    positions.try_reserve_exact(vertices as usize).map_err(|_| io::ErrorKind::OutOfMemory)?;
    all.try_reserve_exact(triangles as usize).map_err(|_| io::ErrorKind::OutOfMemory)?;
    let voxel =
        |position: [f64; 3]| (DVec3::from(position) - DVec3::from(lattice.origin)) / lattice.step;
    if let Some((places, faces)) = mesh.at_once()? {
        positions.extend(places.into_iter().map(voxel));
        all.extend(faces);
    } else {
        for piece in 0..pieces {
            positions.extend(mesh.vertices(piece)?.positions.iter().copied().map(voxel));
        }
        for piece in 0..pieces {
            all.extend(mesh.triangles(piece)?.into_iter().map(|corners| corners.map(|v| v as u32)));
        }
    }
    if positions.iter().any(|place| !(place.abs().max_element() < FARTHEST)) {
        return Err(invalid("the mesh extends over more than 2^30 voxels; use larger cells"));
    }
    Ok((positions, all))
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::surface::mesh::Mesh;

    #[test]
    fn level_set_distances_match_the_nearest_triangle_with_the_right_sign() {
        const RADIUS: f64 = 61.3;
        let corner = |axis: usize, sign: f64| -> [f64; 3] {
            std::array::from_fn(|k| if k == axis { sign * RADIUS } else { 0.25 })
        };
        let positions: Vec<_> =
            [0, 1, 2].into_iter().flat_map(|k| [corner(k, 1.0), corner(k, -1.0)]).collect();
        let faces = |[x, y, z]: [u32; 3]| {
            let odd = (x + y + z) % 2 == 1;
            if odd { [x, 4 + z, 2 + y] } else { [x, 2 + y, 4 + z] }
        };
        let triangles: Vec<_> = (0..8).map(|i| faces([i & 1, i >> 1 & 1, i >> 2])).collect();
        let mesh = Mesh { positions: positions.clone(), triangles, ..Mesh::default() };
        let lattice = Lattice { origin: [0.0; 3], step: 1.0 };
        let level_set = LevelSet::new(&mesh, lattice).unwrap();
        let place = |vertex: u32| DVec3::from(positions[vertex as usize]).as_vec3();
        let all: Vec<_> =
            (0..8).map(|t| Triangle::new(level_set.corners(t).map(place)).unwrap()).collect();
        let mut checked = 0;
        for leaf in level_set.map(|leaves| leaves).into_iter().flatten() {
            let mut voxels = leaf.voxels.iter();
            for i in (0..VOXELS).filter(|i| leaf.active[i / 64] >> (i % 64) & 1 == 1) {
                let i = i as i32;
                let at = leaf.corner + IVec3::new(i / 64, i / 8 % 8, i % 8);
                let at: Vec3 = at.as_vec3();
                let nearest = all.iter().map(|t| t.nearest(at).squared).fold(f32::MAX, f32::min);
                let inside = all.iter().all(|t| t.height(at) < 0.0);
                let expected = if inside { -nearest.sqrt() } else { nearest.sqrt() };
                let found = voxels.next().unwrap().distance;
                assert!((found - expected).abs() < 1e-3, "{at}: {found}, not {expected}");
                checked += 1;
            }
        }
        // A band of six voxels around the area.
        let area = 8.0 * 3f64.sqrt() / 4.0 * (2f64.sqrt() * RADIUS).powi(2);
        assert!((f64::from(checked) / (6.0 * area) - 1.0).abs() < 0.05, "{checked} of {area}");
    }
}
