//! OpenVDB's `.vdb`: the surface as a level set, and attributes as further grids.
//!
//! | grid | values |
//! |---|---|
//! | `surface` | class "level set": the signed distance in the mesh's unit of length, negative inside, in a band of three voxels on either side |
//! | `v`, `Cd` and others | class "unknown": at the voxels of the band, the attribute's value at the nearest point of the surface |
//!
//! The voxels are the cells of the particles' grid. Attributes with one component are float or int32
//! grids, and those with three are vec3s grids; others are a grid for each component.
//!
//! Distances, velocities and colours are stored in half precision, which moves a distance by less
//! than 0.002 voxels, unless their range exceeds it. Only values of the band are stored; with
//! compression, they are also encoded by zlib.
//!
//! The writer keeps the mesh in memory, and the encoded values of all leaves.

mod archive;
mod tree;
mod values;

use std::io::{self, Write};
use std::ops::Range;

use glam::IVec3;

use crate::particles::{AttributeInfo, AttributeKind, colour_attribute};
use crate::surface::level_set::{BAND, Leaf, LeafVoxel, LevelSet, VOXELS};
use crate::surface::mesh::source::{Lattice, MeshSource, Outline};

use super::names::unique_names;
use archive::{GridHead, header};
use tree::{TreeLeaf, sort_key, topology};
use values::{Kind, put_sides};

/// The name of the grid of distances.
const SURFACE: &str = "surface";
/// The lattice of an empty mesh.
const UNIT: Lattice = Lattice { origin: [0.0; 3], step: 1.0 };
/// Sizes of voxels for which half precision is enough.
const HALF_SIZES: Range<f64> = 1e-4..1e4;
/// Largest velocity in half precision.
const HALF_MOST: f32 = 6e4;

/// A grid, and the source of its values.
struct Grid {
    name: String,
    kind: Kind,
    /// `None` for distances.
    source: Option<AttributeSource>,
}

/// Some components of an attribute.
struct AttributeSource {
    index: usize,
    /// Components of each vertex.
    stride: usize,
    components: Range<usize>,
    kind: AttributeKind,
}

impl AttributeSource {
    /// The attribute at the nearest point of the surface to a voxel: interpolated between the
    /// corners of the triangle, or an integer of the nearest corner.
    fn put(&self, out: &mut Vec<f32>, voxel: &LeafVoxel, corners: [u32; 3], values: &[f32]) {
        let LeafVoxel { shares, .. } = voxel;
        let value = |corner: u32, component| values[corner as usize * self.stride + component];
        if self.kind.is_whole() {
            let nearest = (0..3).max_by(|&a, &b| shares[a].total_cmp(&shares[b])).unwrap_or(0);
            out.extend(self.components.clone().map(|component| value(corners[nearest], component)));
            return;
        }
        out.extend(self.components.clone().map(|component| {
            let all = corners.iter().zip(shares);
            let mean = all.map(|(&corner, share)| value(corner, component) * share).sum();
            if self.kind.is_colour() { self.kind.share(mean) } else { mean }
        }));
    }
}

/// The leaves of a block, encoded for each grid.
struct EncodedBlock {
    leaves: Vec<EncodedLeaf>,
    /// For each grid the leaves' bytes, one after another.
    bytes: Vec<Vec<u8>>,
}

struct EncodedLeaf {
    leaf: TreeLeaf,
    /// The least and the greatest coordinates of its active voxels.
    bounds: [IVec3; 2],
    /// For each grid the place in the block's bytes.
    ranges: Vec<Range<usize>>,
}

/// Writes a closed mesh as a level set, with a grid for each attribute.
///
/// # Errors
/// Those of `mesh` and `out`; and before anything is written those of [`LevelSet::new`], and
/// [`io::ErrorKind::InvalidInput`] for a mesh with triangles but without a lattice.
pub fn write_mesh(out: &mut dyn Write, mesh: &dyn MeshSource, zip: bool) -> io::Result<()> {
    let Outline { lattice, triangles, .. } = mesh.outline();
    let lattice = lattice.or((triangles == 0).then_some(UNIT)).ok_or_else(|| {
        io::Error::new(
            io::ErrorKind::InvalidInput,
            "a .vdb is made from particles, not from a mesh",
        )
    })?;
    let values = attribute_values(mesh)?;
    let level_set = LevelSet::new(mesh, lattice)?;
    let grids = grids(&mesh.attributes(), &values, lattice.step);
    let encode = |leaves: Vec<Leaf>| {
        mesh.go_on()?;
        Ok(encoded(&leaves, &grids, &values, &level_set, (lattice, zip)))
    };
    let blocks = level_set.map(encode).into_iter().collect::<io::Result<Vec<_>>>()?;
    drop(values);

    let all = blocks.iter().enumerate();
    let all = all.flat_map(|(block, encoded)| encoded.leaves.iter().map(move |leaf| (block, leaf)));
    let mut leaves: Vec<(usize, &EncodedLeaf)> = all.collect();
    leaves.sort_by_cached_key(|(_, encoded)| sort_key(&encoded.leaf.corner));
    let of_tree: Vec<_> = leaves.iter().map(|(_, encoded)| encoded.leaf.clone()).collect();
    let active =
        of_tree.iter().flat_map(|leaf| leaf.active).map(|word| u64::from(word.count_ones()));
    let voxels = active.sum();
    let least = leaves.iter().map(|(_, leaf)| leaf.bounds[0]).reduce(IVec3::min);
    let greatest = leaves.iter().map(|(_, leaf)| leaf.bounds[1]).reduce(IVec3::max);
    let bounds = [least, greatest].map(Option::unwrap_or_default);

    let mut at = 0;
    let mut put = |bytes: &[u8]| {
        at += bytes.len() as u64;
        out.write_all(bytes).map(|()| at)
    };
    let mut end = put(&header(id(&blocks, leaves.len(), voxels), grids.len()))?;
    for (number, Grid { name, kind, .. }) in grids.iter().enumerate() {
        let background = BAND * lattice.step as f32;
        let tree = topology(&of_tree, *kind, background, zip);
        let bytes = |&(block, encoded): &(usize, &EncodedLeaf)| -> &[u8] {
            &blocks[block].bytes[number][encoded.ranges[number].clone()]
        };
        let total = leaves.iter().map(|leaf| bytes(leaf).len() as u64).sum();
        let head = GridHead { name: name.clone(), kind: *kind, lattice, zip, voxels, bounds };
        put(&head.bytes(end, tree.len() as u64, total))?;
        put(&tree)?;
        for leaf in &leaves {
            end = put(bytes(leaf))?;
        }
    }
    Ok(())
}

/// Numbers that tell files apart, from their content.
fn id(blocks: &[EncodedBlock], leaves: usize, voxels: u64) -> [u32; 4] {
    let mut values = crc32fast::Hasher::new();
    blocks.iter().flat_map(|block| &block.bytes).for_each(|bytes| values.update(bytes));
    [values.finalize(), leaves as u32, (voxels >> 32) as u32, voxels as u32]
}

/// The values of all attributes at all vertices.
fn attribute_values(mesh: &dyn MeshSource) -> io::Result<Vec<Vec<f32>>> {
    let infos = mesh.attributes();
    let mut all = vec![Vec::new(); infos.len()];
    if infos.is_empty() {
        return Ok(all);
    }
    for (values, info) in all.iter_mut().zip(&infos) {
        let numbers = (mesh.vertex_count() as usize).saturating_mul(info.components);
        values.try_reserve_exact(numbers).map_err(|_| io::ErrorKind::OutOfMemory)?;
    }
    for piece in 0..mesh.pieces() {
        let vertices = mesh.vertices(piece)?;
        all.iter_mut().zip(&vertices.attributes).for_each(|(all, values)| all.extend(&values[..]));
    }
    Ok(all)
}

/// The names of attributes: Houdini's for the velocity and the first colour, and others as they are
/// unless that name is taken.
pub fn attribute_names(infos: &[AttributeInfo]) -> Vec<String> {
    let colour = colour_attribute(infos);
    let known = |(index, info): (usize, &AttributeInfo)| {
        if info.is_velocity() { Some("v") } else { (colour == Some(index)).then_some("Cd") }
    };
    let known: Vec<_> = infos.iter().enumerate().map(known).collect();
    let taken: Vec<_> = known.iter().copied().flatten().chain([SURFACE]).collect();
    let others = infos.iter().zip(&known).filter(|(_, known)| known.is_none());
    let others = unique_names(others.map(|(info, _)| &*info.name), &taken, str::to_owned);
    let mut others = others.into_iter();
    let name =
        |known: Option<&str>| known.map_or_else(|| others.next(), |name| Some(name.to_owned()));
    known.into_iter().filter_map(name).collect()
}

fn grids(infos: &[AttributeInfo], values: &[Vec<f32>], size: f64) -> Vec<Grid> {
    let half = HALF_SIZES.contains(&size);
    let mut grids =
        vec![Grid { name: SURFACE.to_owned(), kind: Kind::Distance { half }, source: None }];
    let names = attribute_names(infos);
    for (index, (&AttributeInfo { components: stride, kind, .. }, name)) in
        infos.iter().zip(names).enumerate()
    {
        let is_small = || values[index].iter().all(|value| value.abs() < HALF_MOST);
        let half = kind.is_colour() || infos[index].is_velocity() && is_small();
        let mut add = |name, components: Range<usize>| {
            let of_grid = if kind.is_whole() {
                Kind::Whole
            } else {
                Kind::Real { components: components.len(), half }
            };
            let source = Some(AttributeSource { index, stride, components, kind });
            grids.push(Grid { name, kind: of_grid, source });
        };
        // The alpha of a colour is not stored.
        match if kind.is_colour() { 3 } else { stride } {
            1 => add(name, 0..1),
            3 if !kind.is_whole() => add(name, 0..3),
            components => (0..components).for_each(|c| add(format!("{name}_{c}"), c..c + 1)),
        }
    }
    grids
}

fn encoded(
    leaves: &[Leaf],
    grids: &[Grid],
    values: &[Vec<f32>],
    level_set: &LevelSet,
    (lattice, zip): (Lattice, bool),
) -> EncodedBlock {
    let mut bytes = vec![Vec::new(); grids.len()];
    let mut numbers = Vec::new();
    let size = lattice.step as f32;
    let leaf = |leaf: &Leaf| {
        let sides = [leaf.inside_the_surface(), VOXELS - leaf.voxels.len()];
        let outside = leaf.inside.map(|word| !word);
        let ranges = grids.iter().zip(&mut bytes).map(|(grid, out)| {
            let start = out.len();
            out.extend(leaf.active.iter().flat_map(|word| word.to_le_bytes()));
            put_sides(out, grid.kind, sides, &outside);
            numbers.clear();
            for voxel in &leaf.voxels {
                match &grid.source {
                    None => numbers.push(voxel.distance * size),
                    Some(source) => {
                        let corners = level_set.corners(voxel.triangle);
                        source.put(&mut numbers, voxel, corners, &values[source.index]);
                    }
                }
            }
            grid.kind.put(out, &numbers, zip);
            start..out.len()
        });
        let ranges = ranges.collect();
        let of_tree = TreeLeaf {
            corner: leaf.corner,
            active: leaf.active,
            inside: [leaf.is_inside(0), leaf.is_inside(VOXELS - 1)],
        };
        EncodedLeaf { leaf: of_tree, bounds: leaf.bounds(), ranges }
    };
    let leaves = leaves.iter().map(leaf).collect();
    EncodedBlock { leaves, bytes }
}
