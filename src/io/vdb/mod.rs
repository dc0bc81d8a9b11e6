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
//! grid says whether its vectors rotate with the grid. Colours and texture coordinates do not.
//!
//! Distances, velocities and colours are stored in half precision if their range allows it. This
//! changes a distance by less than 0.002 voxels. Only values in the band are stored. With
//! compression, zlib also encodes them.
//!
//! The writer reads the mesh in parts, and keeps all values of the band in memory or, if the mesh
//! exceeds the memory limit, in scratch files. With compression, it also keeps one encoded grid in
//! memory. This module also reads the metadata of grids, including those in files of other
//! programs.

mod archive;
mod read;
mod tree;
mod values;

use std::io::{self, Write};
use std::ops::Range;
use std::path::Path;

use glam::IVec3;
use half::f16;
use rayon::prelude::*;

use crate::particles::{AttributeInfo, AttributeKind, colour_attribute};
use crate::surface::level_set::{
    BAND, Leaf, NearestPoint, VOXELS, for_each_part, lattice_of, part_bytes,
};
use crate::surface::mesh::source::{Lattice, MeshSource};
use crate::system::scratch::Lists;

use super::encode::write_pieces;
use super::names::unique_names;
use archive::{CONTRAVARIANT_RELATIVE, GridHead, INVARIANT, header};
pub use read::{GridInfo, read_grids};
use tree::{TreeLeaf, sort_key, topology};
use values::{Kind, inactive_record_bytes, put_inactive_record, put_zipped};

/// The name of the grid with the distances.
const SURFACE: &str = "surface";
/// The names that Houdini expects for the velocity and the first colour.
pub const HOUDINI_NAMES: [&str; 2] = ["v", "Cd"];
/// Voxel edge lengths for which distances are stored in half precision.
const HALF_SIZES: Range<f64> = 1e-4..1e4;
/// Velocities are stored in half precision if their greatest absolute component is in this range.
const HALF_VELOCITIES: Range<f32> = 1e-2..6e4;
/// Approximate maximum number of voxels in the band per vertex of a mesh. Spray can reach this
/// number. Large bodies have about 6 voxels per vertex.
const VOXELS_PER_VERTEX: u64 = 11;
/// Approximate maximum size, in bytes, of the leaves per vertex of a mesh. Spray can reach this
/// size. The leaves of large bodies take about 4 bytes per vertex.
const LEAF_BYTES_PER_VERTEX: u64 = 25;
/// Number of leaves that are encoded together.
const LEAVES_PER_CHUNK: usize = 64;

/// A grid with one or more components of an attribute.
#[derive(Debug, Clone, PartialEq)]
struct AttributeGrid {
    name: String,
    attribute: usize,
    components: Range<usize>,
}

/// The values of all grids at the active voxels, block by block, in memory or in scratch files.
struct StoredValues {
    /// The distances, encoded as in the file.
    distances: Lists<u8>,
    /// The numbers of each grid of an attribute.
    grids: Vec<Lists<f32>>,
}

/// The values of a block's active voxels, leaf by leaf.
struct BlockValues {
    distances: Vec<u8>,
    grids: Vec<Vec<f32>>,
}

/// A leaf, and where the values of its active voxels are stored.
struct StoredLeaf {
    tree: TreeLeaf,
    block: u32,
    /// The index of the leaf's first active voxel among the active voxels of the block.
    first: u32,
}

/// The values from which the identifier of the file is computed. The identifier does not depend on
/// the order in which blocks are added.
#[derive(Default)]
struct FileId {
    /// For each block, the first voxel of its first leaf, and the checksum of its distances.
    blocks: Vec<([i32; 3], u32)>,
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

/// Approximate maximum memory and scratch file size, in bytes, for writing a mesh whose
/// attributes have `components` components in total. `in_files` says whether the mesh is in files.
/// It is `None` for a reduced mesh.
pub fn writing_bytes(vertices: u64, components: u64, in_files: Option<bool>) -> [u64; 2] {
    let memory = part_bytes(vertices, components, in_files) + LEAF_BYTES_PER_VERTEX * vertices;
    let of_voxel = size_of::<f16>() as u64 + components * size_of::<f32>() as u64;
    let values = VOXELS_PER_VERTEX * of_voxel * vertices;
    if in_files == Some(true) { [memory, values] } else { [memory + values, 0] }
}

/// Writes a closed mesh as a level set, with a grid for each attribute.
///
/// # Errors
/// The errors of `mesh`, `out` and [`for_each_part`], the errors of scratch files, and
/// [`io::ErrorKind::InvalidInput`] for a mesh with triangles but without a lattice. After the first
/// bytes are written, only errors of `out`, errors of scratch files, and the error of a cancelled
/// mesh can occur.
pub fn write_mesh(out: &mut dyn Write, mesh: &dyn MeshSource, zip: bool) -> io::Result<()> {
    write_in_parts(out, mesh, zip, None)
}

/// Writes a mesh like [`write_mesh`], in parts of [`for_each_part`] with `at_once` triangles.
fn write_in_parts(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    zip: bool,
    at_once: Option<u64>,
) -> io::Result<()> {
    let outline = mesh.outline();
    let lattice = lattice_of(&outline).ok_or_else(|| {
        io::Error::new(
            io::ErrorKind::InvalidInput,
            "a .vdb needs the grid of the particles, which this mesh lacks; reconstruct the \
             particles with a .vdb as the output",
        )
    })?;
    let attributes = outline.attributes;
    let grids = attribute_grids(&attributes);
    let distance = Kind::Distance { half: HALF_SIZES.contains(&lattice.step) };
    let in_scratch = |fault| in_scratch(mesh, fault);
    let mut values = StoredValues::new(grids.len(), mesh.scratch_folder()).map_err(in_scratch)?;
    let (mut leaves, mut id): (Vec<StoredLeaf>, FileId) = Default::default();
    let mut greatest = vec![0.0; grids.len()];
    for_each_part(mesh, lattice, at_once, |part| {
        for (greatest, grid) in greatest.iter_mut().zip(&grids) {
            if attributes[grid.attribute].is_velocity() {
                *greatest =
                    greater(*greatest, greatest_magnitude(&part.attributes[grid.attribute]));
            }
        }
        let put = |voxel, triangle, to: &mut [Vec<f32>]| {
            let point = part.nearest_point(triangle, voxel);
            for (grid, to) in grids.iter().zip(to) {
                let (info, values) =
                    (&attributes[grid.attribute], &part.attributes[grid.attribute]);
                put_values(to, info, values, &grid.components, point);
            }
        };
        let make = |leaves| {
            mesh.go_on()?;
            Ok(BlockValues::new(leaves, distance, lattice, grids.len(), put))
        };
        part.for_each_block(make, |(block, of_block)| {
            let Some(first) = of_block.first() else { return Ok(()) };
            id.add(first.tree.corner, &block.distances);
            let number = values.push(block).map_err(in_scratch)?;
            leaves.extend(of_block.into_iter().map(|leaf| StoredLeaf { block: number, ..leaf }));
            Ok(())
        })
    })?;
    leaves.par_sort_unstable_by_key(|leaf| sort_key(leaf.tree.corner));
    let all_bounds = leaves.par_iter().filter_map(|leaf| leaf.tree.bounds());
    let bounds = all_bounds.reduce_with(|[a, b], [c, d]| [a.min(c), b.max(d)]).unwrap_or_default();
    let voxels = leaves.iter().map(|leaf| leaf.tree.active_count() as u64).sum();

    let head = header(id.of_file(&leaves, voxels), 1 + grids.len());
    out.write_all(&head)?;
    let at = head.len() as u64;
    let mut writer = GridWriter { out, at, mesh, lattice, zip, leaves: &leaves, voxels, bounds };
    let size = distance.bytes();
    writer.write(SURFACE, distance, None, |leaf, out| {
        let distances = values.distances.items(leaf.block as usize, leaf.range(size));
        out.extend_from_slice(&distances.map_err(in_scratch)?);
        Ok(())
    })?;
    for ((grid, numbers), greatest) in grids.iter().zip(&values.grids).zip(greatest) {
        let info = &attributes[grid.attribute];
        let kind = kind_of(grid, info, greatest);
        let vectors = if info.is_direction() { CONTRAVARIANT_RELATIVE } else { INVARIANT };
        let vector_type = (grid.components.len() == 3).then_some(vectors);
        writer.write(&grid.name, kind, vector_type, |leaf, out| {
            let range = leaf.range(grid.components.len());
            let numbers = numbers.items(leaf.block as usize, range);
            kind.put_all(out, &numbers.map_err(in_scratch)?);
            Ok(())
        })?;
    }
    Ok(())
}

/// Adds the folder of scratch files, if there is one, to an error of a scratch file.
fn in_scratch(mesh: &dyn MeshSource, fault: io::Error) -> io::Error {
    match mesh.scratch_folder() {
        Some(folder) => io::Error::other(format!(
            "cannot use scratch files in {}: {fault}; use another folder for them",
            folder.display()
        )),
        None => fault,
    }
}

impl StoredValues {
    /// Prepares to store the distances and the values of `grids` grids, in scratch files in
    /// `folder` if there is one.
    fn new(grids: usize, folder: Option<&Path>) -> io::Result<Self> {
        let mut distances = Lists::in_memory();
        let mut grids: Vec<_> = (0..grids).map(|_| Lists::in_memory()).collect();
        if let Some(folder) = folder {
            distances.move_to_file(folder)?;
            grids.iter_mut().try_for_each(|grid| grid.move_to_file(folder))?;
        }
        Ok(Self { distances, grids })
    }

    /// Adds the values of a block, and returns its number.
    fn push(&mut self, BlockValues { distances, grids }: BlockValues) -> io::Result<u32> {
        let number = self.distances.len() as u32;
        self.distances.push(distances)?;
        self.grids.iter_mut().zip(grids).try_for_each(|(all, of_block)| all.push(of_block))?;
        Ok(number)
    }
}

impl BlockValues {
    /// Collects the distances and the leaves of a block, and its values in `grids` grids of
    /// attributes. For a voxel and its nearest triangle, `put` appends the numbers of each grid.
    fn new(
        leaves: Vec<Leaf>,
        distance: Kind,
        lattice: Lattice,
        grids: usize,
        put: impl Fn(IVec3, u32, &mut [Vec<f32>]),
    ) -> (Self, Vec<StoredLeaf>) {
        let (mut distances, mut grids) = (Vec::new(), vec![Vec::new(); grids]);
        let (size, mut end) = (lattice.step as f32, 0);
        let leaf = |leaf: Leaf| {
            let Leaf { corner, active, inside, distances: in_voxels, triangles } = leaf;
            let of_leaf: Vec<f32> = in_voxels.iter().map(|voxels| voxels * size).collect();
            distance.put_all(&mut distances, &of_leaf);
            let tree = TreeLeaf { corner, active, inside };
            if !grids.is_empty() {
                let voxels = tree.active_voxels().zip(triangles);
                voxels.for_each(|(voxel, triangle)| put(voxel, triangle, &mut grids));
            }
            let first = end;
            end += in_voxels.len() as u32;
            StoredLeaf { tree, block: 0, first }
        };
        let leaves = leaves.into_iter().map(leaf).collect();
        distances.shrink_to_fit();
        grids.iter_mut().for_each(Vec::shrink_to_fit);
        (Self { distances, grids }, leaves)
    }
}

impl StoredLeaf {
    /// The range of the leaf's values in the list of its block, if each voxel has `width` items.
    fn range(&self, width: usize) -> Range<usize> {
        let first = self.first as usize;
        first * width..(first + self.tree.active_count()) * width
    }
}

impl FileId {
    /// Adds a block's distances. `corner` is the first voxel of the block's first leaf.
    fn add(&mut self, corner: IVec3, distances: &[u8]) {
        self.blocks.push((corner.to_array(), crc32fast::hash(distances)));
    }

    /// The identifier, derived from the distances, the corners of the leaves, and the number of
    /// active voxels.
    fn of_file(mut self, leaves: &[StoredLeaf], voxels: u64) -> [u32; 4] {
        self.blocks.sort_unstable();
        let [mut distances, mut places] = [(); 2].map(|()| crc32fast::Hasher::new());
        self.blocks.iter().for_each(|(_, sum)| distances.update(&sum.to_le_bytes()));
        let corners = leaves.iter().flat_map(|leaf| leaf.tree.corner.to_array());
        corners.for_each(|corner| places.update(&corner.to_le_bytes()));
        [distances.finalize(), places.finalize(), (voxels >> 32) as u32, voxels as u32]
    }
}

/// The type of the values of `grid`. `greatest` is the greatest absolute value of a velocity.
fn kind_of(grid: &AttributeGrid, info: &AttributeInfo, greatest: f32) -> Kind {
    match info.kind {
        AttributeKind::Signed => Kind::Int32,
        AttributeKind::Unsigned | AttributeKind::Wide => Kind::Int64,
        kind => {
            let fits_half = greatest == 0.0 || HALF_VELOCITIES.contains(&greatest);
            let half = kind.is_colour() || info.is_velocity() && fits_half;
            Kind::Real { components: grid.components.len(), half }
        }
    }
}

/// The greatest absolute value, or NaN if any value is NaN.
fn greatest_magnitude(values: &[f32]) -> f32 {
    values.par_iter().map(|value| value.abs()).reduce(|| 0.0, greater)
}

/// The greater of two numbers, or NaN if one of them is NaN.
fn greater(a: f32, b: f32) -> f32 {
    if a > b || a.is_nan() { a } else { b }
}

/// Appends some components of an attribute at a point of the surface, interpolated between the
/// corners of a triangle. Integers are not interpolated but taken from the nearest corner.
/// `values` are the attribute's values at all vertices.
fn put_values(
    out: &mut Vec<f32>,
    info: &AttributeInfo,
    values: &[f32],
    components: &Range<usize>,
    NearestPoint { corners, shares }: NearestPoint,
) {
    let value = |corner: usize, component: usize| {
        values[corners[corner] as usize * info.components + component]
    };
    for component in components.clone() {
        let number = if info.kind.is_whole() {
            let nearest = (0..3).max_by(|&a, &b| shares[a].total_cmp(&shares[b]));
            value(nearest.unwrap_or(0), component)
        } else {
            let mean = (0..3).map(|corner| value(corner, component) * shares[corner]).sum();
            if info.kind.is_colour() { info.kind.share(mean) } else { mean }
        };
        out.push(number);
    }
}

impl GridWriter<'_> {
    /// Writes a grid. `put` appends the values of the active voxels of a leaf.
    fn write(
        &mut self,
        name: &str,
        kind: Kind,
        vector_type: Option<&'static str>,
        put: impl Fn(&StoredLeaf, &mut Vec<u8>) -> io::Result<()> + Sync,
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
                put_inactive_record(out, kind, leaf.tree.sides(), &inside.map(|word| !word));
                if zip {
                    values.clear();
                    put(leaf, &mut values)?;
                    put_zipped(out, &values);
                } else {
                    put(leaf, out)?;
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
                let sides =
                    |leaf: &StoredLeaf| inactive_record_bytes(kind, leaf.tree.sides(), mask);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::level_set::WavySheet;

    #[test]
    fn a_mesh_in_parts_has_the_bytes_of_the_whole_mesh() {
        let written = |zip, at_once| {
            let mut bytes = Vec::new();
            write_in_parts(&mut bytes, &WavySheet, zip, Some(at_once)).unwrap();
            bytes
        };
        for zip in [false, true] {
            let whole = written(zip, u64::MAX);
            assert!(whole.len() > 1 << 20, "{}", whole.len());
            for at_once in [20_000, 100_000] {
                assert!(written(zip, at_once) == whole, "{at_once}");
            }
        }
    }
}
