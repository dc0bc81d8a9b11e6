//! OpenVDB's `.vdb`: the surface is a level set, and each attribute is stored in additional grids.
//!
//! | grid | values |
//! |---|---|
//! | `surface` | class "level set": the signed distance in the mesh's unit of length, negative inside, in a band of three voxels on either side |
//! | `v`, `Cd` and others | class "unknown": at the voxels of the band, the attribute's value at the nearest point of the surface |
//!
//! The voxels are the cells of the particles' grid. An attribute with one component is stored as a
//! float grid or, if it contains integers, as an int32 or int64 grid. An attribute with three
//! floating-point components is stored as a vec3s grid. The first colour is also stored as a vec3s
//! grid, without its alpha. Other attributes have one grid per component. The metadata of a vec3s
//! grid says whether its vectors rotate with the grid; only colours do not.
//!
//! Distances, velocities and colours are stored in half precision if their range allows it. This
//! changes a distance by less than 0.002 voxels. Only values in the band are stored. With
//! compression, zlib also encodes them.
//!
//! The writer keeps in memory the positions and triangles of the mesh, the distances and nearest
//! triangles of all voxels in the band, and up to 16 values per vertex. With compression, it also
//! keeps one encoded grid. This module also reads the metadata of grids, including those in files
//! of other programs.

mod archive;
mod read;
mod tree;
mod values;

use std::io::{self, Write};
use std::ops::Range;

use glam::IVec3;
use rayon::prelude::*;

use crate::particles::{AttributeInfo, AttributeKind, colour_attribute};
use crate::surface::level_set::{BAND, Leaf, LevelSet, NearestPoint, VOXELS, lattice_of};
use crate::surface::mesh::source::{Lattice, MeshSource};

use super::encode::{in_order, write_pieces};
use super::names::unique_names;
use archive::{CONTRAVARIANT_RELATIVE, GridHead, INVARIANT, header};
pub use read::{GridInfo, read_grids};
use tree::{TreeLeaf, sort_key, topology};
use values::{Kind, put_sides, put_zipped, sides_bytes};

/// The name of the grid with the distances.
const SURFACE: &str = "surface";
/// The names that Houdini expects for the velocity and the first colour.
pub const HOUDINI_NAMES: [&str; 2] = ["v", "Cd"];
/// Voxel edge lengths for which distances are stored in half precision.
const HALF_SIZES: Range<f64> = 1e-4..1e4;
/// Velocities are stored in half precision if their greatest absolute component is in this range.
const HALF_VELOCITIES: Range<f32> = 1e-2..6e4;
/// Maximum number of values per vertex that are in memory at the same time.
const NUMBERS_AT_ONCE: usize = 16;
/// Number of leaves that are encoded together.
const LEAVES_PER_CHUNK: usize = 64;

/// A grid with one or more components of an attribute.
#[derive(Debug, Clone, PartialEq)]
struct AttributeGrid {
    name: String,
    attribute: usize,
    components: Range<usize>,
}

/// The values of one or more components of an attribute at all vertices.
struct AttributeValues {
    components: Range<usize>,
    kind: AttributeKind,
    values: Vec<f32>,
}

/// The distances and nearest triangles of a block's active voxels, leaf by leaf.
struct StoredBlock {
    /// The distances, encoded as in the file.
    distances: Vec<u8>,
    /// The nearest triangles. Empty for a mesh without attributes.
    triangles: Vec<u32>,
}

/// A leaf, and where the values of its active voxels are stored.
struct StoredLeaf {
    tree: TreeLeaf,
    block: u32,
    /// The index of the leaf's first active voxel among the active voxels of the block.
    first: u32,
}

/// Writes the grids of a file in order.
struct GridWriter<'a> {
    out: &'a mut dyn Write,
    /// Number of bytes written so far.
    at: u64,
    mesh: &'a dyn MeshSource,
    lattice: Lattice,
    zip: bool,
    /// All leaves, in the order of the tree.
    leaves: &'a [StoredLeaf],
    /// The number of active voxels.
    voxels: u64,
    /// The least and the greatest coordinates of the active voxels along each axis.
    bounds: [IVec3; 2],
}

/// Writes a closed mesh as a level set, with a grid for each attribute.
///
/// # Errors
/// The errors of `mesh`, `out` and [`LevelSet::new`], and [`io::ErrorKind::InvalidInput`] for a
/// mesh with triangles but without a lattice. The errors of [`LevelSet::new`] and the error for the
/// missing lattice occur before anything is written.
pub fn write_mesh(out: &mut dyn Write, mesh: &dyn MeshSource, zip: bool) -> io::Result<()> {
    let outline = mesh.outline();
    let lattice = lattice_of(&outline).ok_or_else(|| {
        io::Error::new(
            io::ErrorKind::InvalidInput,
            "a .vdb needs the grid of the particles, which this mesh lacks; reconstruct the \
             particles with a .vdb as the output",
        )
    })?;
    let attributes = outline.attributes;
    let level_set = LevelSet::new(mesh, lattice)?;
    let distance = Kind::Distance { half: HALF_SIZES.contains(&lattice.step) };
    let stored = |leaves| {
        mesh.go_on()?;
        Ok(StoredBlock::new(leaves, distance, lattice, !attributes.is_empty()))
    };
    let blocks = level_set.map(stored)?;
    let count = blocks.iter().map(|(_, leaves)| leaves.len()).sum();
    let mut leaves: Vec<StoredLeaf> = Vec::with_capacity(count);
    let mut all = Vec::with_capacity(blocks.len());
    for (number, (block, of_block)) in (0..).zip(blocks) {
        leaves.extend(of_block.into_iter().map(|leaf| StoredLeaf { block: number, ..leaf }));
        all.push(block);
    }
    let blocks: Vec<StoredBlock> = all;
    leaves.par_sort_unstable_by_key(|leaf| sort_key(leaf.tree.corner));
    let all_bounds = leaves.par_iter().filter_map(|leaf| leaf.tree.bounds());
    let bounds = all_bounds.reduce_with(|[a, b], [c, d]| [a.min(c), b.max(d)]).unwrap_or_default();
    let voxels = leaves.iter().map(|leaf| leaf.tree.active_count() as u64).sum();

    let grids = attribute_grids(&attributes);
    let head = header(id(&blocks, &leaves, voxels), 1 + grids.len());
    out.write_all(&head)?;
    let at = head.len() as u64;
    let mut writer = GridWriter { out, at, mesh, lattice, zip, leaves: &leaves, voxels, bounds };
    let size = distance.bytes();
    writer.write(SURFACE, distance, None, |leaf, out| {
        let distances = &blocks[leaf.block as usize].distances[leaf.first as usize * size..];
        out.extend(&distances[..leaf.tree.active_count() * size]);
    })?;
    for grids in grid_batches(&grids) {
        let values = AttributeValues::read(mesh, grids)?;
        for grid in grids {
            let info = &attributes[grid.attribute];
            let kind = values.kind_of(grid, info);
            let vectors = if info.is_direction() { CONTRAVARIANT_RELATIVE } else { INVARIANT };
            let vector_type = (grid.components.len() == 3).then_some(vectors);
            writer.write(&grid.name, kind, vector_type, |leaf, out| {
                let triangles = &blocks[leaf.block as usize].triangles[leaf.first as usize..];
                let mut numbers = Vec::with_capacity(VOXELS * grid.components.len());
                for (voxel, &triangle) in leaf.tree.active_voxels().zip(triangles) {
                    values.put(&mut numbers, grid, level_set.nearest_point(triangle, voxel));
                }
                kind.put_all(out, &numbers);
            })?;
        }
    }
    Ok(())
}

impl StoredBlock {
    fn new(
        leaves: Vec<Leaf>,
        distance: Kind,
        lattice: Lattice,
        with_triangles: bool,
    ) -> (Self, Vec<StoredLeaf>) {
        let (mut distances, mut triangles) = (Vec::new(), Vec::new());
        let (size, mut end) = (lattice.step as f32, 0);
        let leaf = |leaf: Leaf| {
            let of_leaf: Vec<f32> = leaf.distances.iter().map(|voxels| voxels * size).collect();
            distance.put_all(&mut distances, &of_leaf);
            if with_triangles {
                triangles.extend(&leaf.triangles);
            }
            let first = end;
            end += leaf.distances.len() as u32;
            let Leaf { corner, active, inside, .. } = leaf;
            StoredLeaf { tree: TreeLeaf { corner, active, inside }, block: 0, first }
        };
        let leaves = leaves.into_iter().map(leaf).collect();
        distances.shrink_to_fit();
        triangles.shrink_to_fit();
        (Self { distances, triangles }, leaves)
    }
}

impl AttributeValues {
    /// Reads the components that `grids` contain. All grids must belong to the same attribute.
    fn read(mesh: &dyn MeshSource, grids: &[AttributeGrid]) -> io::Result<Self> {
        let attribute = grids[0].attribute;
        let AttributeInfo { components: stride, kind, .. } = mesh.attributes()[attribute];
        let components = grids[0].components.start..grids[grids.len() - 1].components.end;
        let mut values = Vec::new();
        let numbers = (mesh.vertex_count() as usize).saturating_mul(components.len());
        values.try_reserve_exact(numbers).map_err(|_| io::ErrorKind::OutOfMemory)?;
        let make = |piece, out: &mut Vec<f32>| {
            let vertices = mesh.vertices(piece)?;
            let all = vertices.attributes[attribute].chunks_exact(stride);
            all.for_each(|values| out.extend_from_slice(&values[components.clone()]));
            Ok(())
        };
        in_order(mesh.pieces(), make, |piece| {
            values.extend_from_slice(piece);
            Ok(())
        })?;
        Ok(Self { components, kind, values })
    }

    /// The type of the values of `grid`.
    fn kind_of(&self, grid: &AttributeGrid, info: &AttributeInfo) -> Kind {
        match self.kind {
            AttributeKind::Signed => Kind::Int32,
            AttributeKind::Unsigned | AttributeKind::Wide => Kind::Int64,
            _ => {
                let half = self.kind.is_colour() || info.is_velocity() && self.fits_half();
                Kind::Real { components: grid.components.len(), half }
            }
        }
    }

    /// Whether the greatest absolute value is within [`HALF_VELOCITIES`], or all values are 0.
    fn fits_half(&self) -> bool {
        let greatest = self.values.par_iter().map(|value| value.abs());
        let greatest = greatest.reduce(|| 0.0, |a, b| if a > b || a.is_nan() { a } else { b });
        greatest == 0.0 || HALF_VELOCITIES.contains(&greatest)
    }

    /// Appends the attribute's value at `point` of the surface, interpolated between the corners of
    /// the triangle. Integers are not interpolated but taken from the nearest corner.
    fn put(&self, out: &mut Vec<f32>, grid: &AttributeGrid, point: NearestPoint) {
        let NearestPoint { corners, shares } = point;
        let (first, stride) = (self.components.start, self.components.len());
        let value = |corner: usize, component: usize| {
            self.values[corners[corner] as usize * stride + component - first]
        };
        for component in grid.components.clone() {
            let number = if self.kind.is_whole() {
                let nearest = (0..3).max_by(|&a, &b| shares[a].total_cmp(&shares[b]));
                value(nearest.unwrap_or(0), component)
            } else {
                let mean = (0..3).map(|corner| value(corner, component) * shares[corner]).sum();
                if self.kind.is_colour() { self.kind.share(mean) } else { mean }
            };
            out.push(number);
        }
    }
}

impl GridWriter<'_> {
    /// Writes a grid. `put` appends the values of the active voxels of a leaf.
    fn write(
        &mut self,
        name: &str,
        kind: Kind,
        vector_type: Option<&'static str>,
        put: impl Fn(&StoredLeaf, &mut Vec<u8>) + Sync,
    ) -> io::Result<()> {
        let Self { mesh, leaves, zip, lattice, voxels, bounds, .. } = *self;
        let encode = |chunk: usize, out: &mut Vec<u8>| {
            mesh.go_on()?;
            let mut values = Vec::new();
            let numbers =
                chunk * LEAVES_PER_CHUNK..leaves.len().min((chunk + 1) * LEAVES_PER_CHUNK);
            for leaf in &leaves[numbers] {
                let TreeLeaf { active, inside, .. } = &leaf.tree;
                out.extend(active.iter().flat_map(|word| word.to_le_bytes()));
                put_sides(out, kind, leaf.tree.sides(), &inside.map(|word| !word));
                if zip {
                    values.clear();
                    put(leaf, &mut values);
                    put_zipped(out, &values);
                } else {
                    put(leaf, out);
                }
            }
            Ok(())
        };
        let chunks = leaves.len().div_ceil(LEAVES_PER_CHUNK);
        let zipped: Option<Vec<Vec<u8>>> = zip
            .then(|| {
                let chunk = |chunk| {
                    let mut bytes = Vec::new();
                    encode(chunk, &mut bytes).map(|()| bytes)
                };
                (0..chunks).into_par_iter().map(chunk).collect::<io::Result<_>>()
            })
            .transpose()?;
        let bytes = match &zipped {
            Some(chunks) => chunks.iter().map(|bytes| bytes.len() as u64).sum(),
            None => {
                let mask = VOXELS as u64 / 8;
                let sides = |leaf: &StoredLeaf| sides_bytes(kind, leaf.tree.sides(), mask);
                let masks = leaves.iter().map(|leaf| mask + sides(leaf)).sum::<u64>();
                masks + voxels * kind.bytes() as u64
            }
        };
        let tree = leaves.par_iter().map(|leaf| &leaf.tree);
        let tree = topology(tree, kind, BAND * lattice.step as f32, zip);
        let name = name.to_owned();
        let head = GridHead { name, kind, vector_type, lattice, zip, voxels, bounds };
        let head = head.bytes(self.at, tree.len() as u64, bytes);
        self.out.write_all(&head)?;
        self.out.write_all(&tree)?;
        match zipped {
            Some(chunks) => chunks.iter().try_for_each(|bytes| self.out.write_all(bytes))?,
            None => write_pieces(self.out, chunks, encode)?,
        }
        self.at += (head.len() + tree.len()) as u64 + bytes;
        Ok(())
    }
}

/// An identifier of the file, derived from the distances, the corners of the leaves, and the number
/// of active voxels.
fn id(blocks: &[StoredBlock], leaves: &[StoredLeaf], voxels: u64) -> [u32; 4] {
    let mut distances = crc32fast::Hasher::new();
    blocks.iter().for_each(|block| distances.update(&block.distances));
    let mut places = crc32fast::Hasher::new();
    let corners = leaves.iter().flat_map(|leaf| leaf.tree.corner.to_array());
    corners.for_each(|corner| places.update(&corner.to_le_bytes()));
    [distances.finalize(), places.finalize(), (voxels >> 32) as u32, voxels as u32]
}

/// The names of attributes in the file. The velocity and the first colour are stored under
/// Houdini's names. Other attributes keep their names if these are free.
pub fn attribute_names(infos: &[AttributeInfo]) -> Vec<String> {
    let colour = colour_attribute(infos);
    let known = |(index, info): (usize, &AttributeInfo)| {
        let [velocity, first_colour] = HOUDINI_NAMES;
        if info.is_velocity() {
            Some(velocity)
        } else {
            (colour == Some(index)).then_some(first_colour)
        }
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

/// The number of times that the writer reads all vertices of a mesh to store their attributes.
pub fn attribute_readings(infos: &[AttributeInfo]) -> usize {
    grid_batches(&attribute_grids(infos)).count()
}

/// The grids that store the attributes.
fn attribute_grids(infos: &[AttributeInfo]) -> Vec<AttributeGrid> {
    let mut grids = Vec::new();
    let first_colour = colour_attribute(infos);
    for (attribute, (info, name)) in infos.iter().zip(attribute_names(infos)).enumerate() {
        // The alpha of the first colour is not stored, because `Cd` has three components.
        let components = if first_colour == Some(attribute) { 3 } else { info.components };
        match components {
            1 => grids.push(AttributeGrid { name, attribute, components: 0..1 }),
            3 if !info.kind.is_whole() => {
                grids.push(AttributeGrid { name, attribute, components: 0..3 })
            }
            _ => grids.extend((0..components).map(|component| AttributeGrid {
                name: format!("{name}_{component}"),
                attribute,
                components: component..component + 1,
            })),
        }
    }
    let names = unique_names(grids.iter().map(|grid| &*grid.name), &[SURFACE], str::to_owned);
    grids.iter_mut().zip(names).for_each(|(grid, name)| grid.name = name);
    grids
}

/// Divides the grids into runs whose values are read at once. All grids of a run belong to the same
/// attribute.
fn grid_batches(grids: &[AttributeGrid]) -> impl Iterator<Item = &[AttributeGrid]> {
    let of_attributes = grids.chunk_by(|a, b| a.attribute == b.attribute);
    of_attributes.flat_map(|grids| grids.chunks(NUMBERS_AT_ONCE))
}
