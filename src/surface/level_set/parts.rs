//! Reads a mesh in parts, so that a large mesh needs memory for only one part.
//!
//! A part consists of some blocks and of all pieces of the mesh near them. The blocks of a part are
//! consecutive along the Morton curve, so most of its pieces belong to no other part. A mesh whose
//! pieces have no outlines is read as a whole.

use std::collections::BTreeSet;
use std::io;
use std::ops::Range;

use glam::{DVec3, IVec3};
use hashbrown::{HashMap, HashSet};
use rayon::prelude::*;

use crate::grid::MortonKey;
use crate::surface::mesh::source::{Lattice, MeshSource, Outline, PieceOutline};

use super::band::MARGIN;
use super::{FARTHEST, LevelSet, TOO_FAR, block_of, invalid};

/// Maximum number of triangles in the pieces of a part with more than one block, for a mesh in
/// files and for a mesh in memory.
const TRIANGLES_AT_ONCE: [u64; 2] = [1 << 20, 1 << 21];
/// Approximate memory, in bytes for each vertex, to read a part without attributes and to list its
/// triangles by blocks. A mesh has two triangles for each vertex.
const VERTEX_BYTES: u64 = 108;

/// Approximate memory, in bytes, that [`for_each_part`] needs for a mesh with this number of
/// vertices, whose attributes have `components` components in total. `in_files` says whether the
/// mesh is in files, and is `None` if the mesh's pieces have no outlines.
pub fn part_bytes(vertices: u64, components: u64, in_files: Option<bool>) -> u64 {
    let [files, memory] = TRIANGLES_AT_ONCE.map(|triangles| triangles / 2);
    let most = in_files.map_or(u64::MAX, |in_files| if in_files { files } else { memory });
    (VERTEX_BYTES + components * size_of::<f32>() as u64) * vertices.min(most)
}

/// Blocks, and the pieces with triangles near these blocks. The pieces are in ascending order.
struct Part {
    blocks: HashSet<IVec3>,
    pieces: BTreeSet<usize>,
}

/// Calls `take` with each part of a closed mesh. Each block is in exactly one part. A part takes 24
/// bytes for each vertex, 12 bytes for each triangle, and the memory of all attributes. `at_once`
/// replaces the usual maximum number of triangles in the pieces of a part with more than one block.
/// The distances do not depend on the division into parts.
///
/// # Errors
/// If `mesh` cannot be read; [`io::ErrorKind::OutOfMemory`] if there is too little memory;
/// [`io::ErrorKind::InvalidInput`] for a mesh with too many vertices or triangles, or with
/// coordinates that are not finite or too large; and the errors of `take`.
pub fn for_each_part(
    mesh: &dyn MeshSource,
    lattice: Lattice,
    at_once: Option<u64>,
    mut take: impl FnMut(LevelSet) -> io::Result<()>,
) -> io::Result<()> {
    let [in_files, in_memory] = TRIANGLES_AT_ONCE;
    let usual = if mesh.scratch_folder().is_some() { in_files } else { in_memory };
    let at_once = at_once.unwrap_or(usual);
    let Outline { vertices, triangles, pieces, .. } = mesh.outline();
    if vertices > u64::from(u32::MAX) || triangles >= u64::from(u32::MAX) {
        return Err(invalid("a level set needs a mesh of at most 4294967295 triangles"));
    }
    let outlines = || (0..pieces).map(|piece| mesh.piece_outline(piece)).collect();
    let outlines: Option<Vec<PieceOutline>> = (triangles > at_once).then(outlines).flatten();
    let Some(outlines) = outlines else { return take(whole(mesh, lattice)?) };
    let mut firsts = vec![0];
    firsts.extend(outlines.iter().scan(0, |end, outline| {
        *end += outline.vertices;
        Some(*end)
    }));
    parts(&outlines, lattice, at_once)?
        .into_iter()
        .try_for_each(|part| take(read_part(mesh, lattice, &firsts, part)?))
}

/// Divides a mesh with these pieces into parts.
fn parts(outlines: &[PieceOutline], lattice: Lattice, at_once: u64) -> io::Result<Vec<Part>> {
    let mut near: HashMap<IVec3, Vec<usize>> = HashMap::new();
    for (piece, outline) in outlines.iter().enumerate().filter(|(_, o)| o.triangles > 0) {
        let [low, high] = outline.bounds.map(|corner| in_voxels(corner, lattice));
        if !is_within(low) || !is_within(high) {
            return Err(invalid(TOO_FAR));
        }
        let [low, high] = [block_of(low - MARGIN), block_of(high + MARGIN)];
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    near.entry(IVec3::new(x, y, z)).or_default().push(piece);
                }
            }
        }
    }
    let mut near: Vec<_> = near.into_iter().collect();
    near.sort_unstable_by_key(|&(block, _)| morton_key(block));
    let mut all: Vec<Part> = Vec::new();
    let mut triangles = 0;
    for (block, pieces) in near {
        let more = |part: Option<&Part>| {
            let new = pieces.iter().filter(|piece| part.is_none_or(|p| !p.pieces.contains(*piece)));
            new.map(|&piece| outlines[piece].triangles).sum::<u64>()
        };
        let of_block = more(all.last());
        if all.is_empty() || triangles + of_block > at_once {
            triangles = more(None);
            all.push(Part { blocks: HashSet::new(), pieces: BTreeSet::new() });
        } else {
            triangles += of_block;
        }
        let part = all.last_mut().expect("a part was added");
        part.blocks.insert(block);
        part.pieces.extend(pieces);
    }
    Ok(all)
}

/// The place of a block along the Morton curve. Blocks may be too far from the origin for one
/// [`MortonKey`], so the curve runs through cubes of blocks, which are in lexicographic order.
fn morton_key(block: IVec3) -> ([i32; 3], MortonKey) {
    const CUBE: i32 = 1 << (MortonKey::AXIS_BITS - 1);
    let cube = IVec3::splat(CUBE);
    (block.div_euclid(cube).to_array(), MortonKey::of(block.rem_euclid(cube)))
}

fn in_voxels(position: [f64; 3], lattice: Lattice) -> DVec3 {
    (DVec3::from(position) - DVec3::from(lattice.origin)) / lattice.step
}

/// Whether a place in voxels is finite and not too far from the origin.
fn is_within(place: DVec3) -> bool {
    place.abs().cmplt(DVec3::splat(FARTHEST)).all()
}

/// Reads a whole mesh.
fn whole(mesh: &dyn MeshSource, lattice: Lattice) -> io::Result<LevelSet> {
    let pieces = 0..mesh.pieces();
    let mut part = read_vertices(mesh, lattice, pieces.clone().collect())?;
    let triangles = |piece| -> io::Result<Vec<[u32; 3]>> {
        let triangles = mesh.triangles(piece)?.into_iter();
        Ok(triangles.map(|corners| corners.map(|vertex| vertex as u32)).collect())
    };
    let triangles: Vec<_> = pieces.into_par_iter().map(triangles).collect::<io::Result<_>>()?;
    part.triangles = joined(&triangles)?;
    Ok(part)
}

/// Reads the pieces of a part. `firsts` are the numbers of the first vertices of all pieces of the
/// mesh, followed by the number of vertices.
fn read_part(
    mesh: &dyn MeshSource,
    lattice: Lattice,
    firsts: &[u64],
    Part { blocks, pieces }: Part,
) -> io::Result<LevelSet> {
    let own_pieces: Vec<usize> = pieces.iter().copied().collect();
    let triangles = own_pieces.par_iter().map(|&piece| mesh.triangles(piece));
    let triangles: Vec<_> = triangles.collect::<io::Result<_>>()?;
    let piece_of = |vertex: u64| firsts.partition_point(|&first| first <= vertex) - 1;
    // The corners of a piece's triangles are mostly in that piece.
    let others = |(piece, triangles): (&usize, &Vec<[u64; 3]>)| {
        let own = firsts[*piece]..firsts[piece + 1];
        let corners = triangles.iter().flatten().filter(|corner| !own.contains(corner));
        corners.map(|&corner| piece_of(corner)).collect::<HashSet<_>>()
    };
    let others: Vec<_> = pieces.iter().zip(&triangles).map(others).collect();
    let of_vertices: BTreeSet<usize> =
        pieces.into_iter().chain(others.into_iter().flatten()).collect();
    let mut part = read_vertices(mesh, lattice, of_vertices.iter().copied().collect())?;
    // For each piece, the range of its vertices in the mesh, and the number of its first vertex in
    // this part.
    let mut of_part = 0;
    let numbers: Vec<(Range<u64>, u64)> = of_vertices
        .iter()
        .map(|&piece| {
            let (range, first) = (firsts[piece]..firsts[piece + 1], of_part);
            of_part += range.end - range.start;
            (range, first)
        })
        .collect();
    let corners = |triangles: Vec<[u64; 3]>| -> Vec<[u32; 3]> {
        // Most consecutive corners are in the same piece.
        let mut last = &numbers[0];
        let mut number = |vertex: u64| {
            if !last.0.contains(&vertex) {
                last = &numbers[numbers.partition_point(|(range, _)| range.end <= vertex)];
            }
            (last.1 + vertex - last.0.start) as u32
        };
        triangles.into_iter().map(|corners| corners.map(&mut number)).collect()
    };
    let triangles: Vec<_> = triangles.into_par_iter().map(corners).collect();
    part.triangles = joined(&triangles)?;
    part.part = Some(blocks);
    Ok(part)
}

/// The vertices of `pieces`, without triangles.
fn read_vertices(
    mesh: &dyn MeshSource,
    lattice: Lattice,
    pieces: Vec<usize>,
) -> io::Result<LevelSet> {
    let read = |piece: usize| {
        let vertices = mesh.vertices(piece)?;
        let places = vertices.positions.iter().map(|&position| in_voxels(position, lattice));
        let places: Vec<DVec3> = places.collect();
        if !places.iter().all(|&place| is_within(place)) {
            return Err(invalid(TOO_FAR));
        }
        Ok((places, vertices.attributes.into_iter().map(|values| values.into_owned()).collect()))
    };
    let read: Vec<(Vec<DVec3>, Vec<Vec<f32>>)> =
        pieces.into_par_iter().map(read).collect::<io::Result<_>>()?;
    let (places, of_pieces): (Vec<_>, Vec<_>) = read.into_iter().unzip();
    let attribute = |i: usize| joined(of_pieces.iter().map(|attributes| &attributes[i]));
    let attributes = (0..mesh.attributes().len()).map(attribute).collect::<io::Result<_>>()?;
    Ok(LevelSet { positions: joined(&places)?, attributes, ..LevelSet::default() })
}

/// The items of all lists, or an error if memory is full.
fn joined<'a, T: Copy + 'a>(
    lists: impl IntoIterator<Item = &'a Vec<T>, IntoIter: Clone>,
) -> io::Result<Vec<T>> {
    let lists = lists.into_iter();
    let mut all = Vec::new();
    let count = lists.clone().map(Vec::len).sum();
    all.try_reserve_exact(count).map_err(|_| io::ErrorKind::OutOfMemory)?;
    lists.for_each(|list| all.extend_from_slice(list));
    Ok(all)
}

/// A mesh for tests whose pieces have outlines.
#[cfg(test)]
pub mod wavy_sheet {
    use super::*;
    use crate::particles::AttributeInfo;
    use crate::surface::mesh::source::{Vertices, bounds_of};

    /// The lattice of the sheet.
    pub const LATTICE: Lattice = Lattice { origin: [0.0; 3], step: 1.0 };
    /// Number of vertices along the edge of a piece.
    const EDGE: usize = 24;
    /// Number of pieces along each axis.
    pub const PIECES: usize = 12;

    /// A wavy surface, whose squares are divided into pieces. Both sides have the same triangles,
    /// in opposite directions, so the mesh is closed.
    pub struct WavySheet;

    fn vertex(x: usize, y: usize) -> [f64; 3] {
        let [x, y] = [x, y].map(|place| place as f64 - 100.3);
        [x, y, 9.0 * libm::sin(0.11 * x) + 6.0 * libm::cos(0.17 * y) + 1e-3 * x * y]
    }

    impl WavySheet {
        /// The vertices of a piece, as coordinates in the grid of vertices.
        fn squares(piece: usize) -> impl Iterator<Item = [usize; 2]> {
            let [x, y] = [piece / PIECES, piece % PIECES].map(|place| place * EDGE);
            (0..EDGE * EDGE).map(move |i| [x + i / EDGE, y + i % EDGE])
        }

        fn number([x, y]: [usize; 2]) -> u64 {
            let piece = x / EDGE * PIECES + y / EDGE;
            (piece * EDGE * EDGE + x % EDGE * EDGE + y % EDGE) as u64
        }
    }

    impl MeshSource for WavySheet {
        fn outline(&self) -> Outline {
            let pieces = PIECES * PIECES;
            let triangles = (0..pieces).map(|piece| self.triangles(piece).unwrap().len() as u64);
            Outline {
                vertices: (pieces * EDGE * EDGE) as u64,
                triangles: triangles.sum(),
                pieces,
                lattice: Some(LATTICE),
                attributes: vec![AttributeInfo::new("velocity", 3)],
                ..Outline::default()
            }
        }

        fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
            let positions: Vec<_> = Self::squares(piece).map(|[x, y]| vertex(x, y)).collect();
            let velocities: Vec<_> = positions.iter().flatten().map(|&x| x as f32 / 3.0).collect();
            let attributes = vec![velocities.into()];
            Ok(Vertices { positions: positions.into(), attributes, ..Vertices::default() })
        }

        fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
            let side = EDGE * PIECES;
            let squares = Self::squares(piece).filter(|[x, y]| x + 1 < side && y + 1 < side);
            let of_square = |[x, y]: [usize; 2]| {
                let [a, b, c, d] =
                    [[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]].map(Self::number);
                [[a, b, c], [a, c, d], [c, b, a], [d, c, a]]
            };
            Ok(squares.flat_map(of_square).collect())
        }

        fn piece_outline(&self, piece: usize) -> Option<PieceOutline> {
            let near = Self::squares(piece).flat_map(|[x, y]| {
                [vertex(x, y), vertex(x + 1, y), vertex(x + 1, y + 1), vertex(x, y + 1)]
            });
            Some(PieceOutline {
                bounds: bounds_of(&near.collect::<Vec<_>>())?,
                vertices: (EDGE * EDGE) as u64,
                triangles: self.triangles(piece).unwrap().len() as u64,
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::wavy_sheet::{LATTICE, PIECES, WavySheet};
    use super::*;
    use crate::surface::level_set::{Leaf, place_in_leaf};

    /// All leaves in the order of their corners, with the point of the mesh that is nearest to each
    /// voxel; and the number of parts.
    fn leaves(at_once: u64) -> (Vec<(Leaf, Vec<DVec3>)>, usize) {
        let (mut all, mut parts) = (Vec::new(), 0);
        for_each_part(&WavySheet, LATTICE, Some(at_once), |part| {
            parts += 1;
            let mut leaves: Vec<Leaf> = Vec::new();
            part.for_each_block(Ok, |of_block: Vec<Leaf>| {
                leaves.extend(of_block);
                Ok(())
            })?;
            for leaf in leaves {
                let active = (0..512).filter(|i| leaf.active[i / 64] >> (i % 64) & 1 == 1);
                let nearest = active.zip(&leaf.triangles).map(|(i, &triangle)| {
                    let nearest = part.nearest_point(triangle, leaf.corner + place_in_leaf(i));
                    let corners = nearest.corners.map(|corner| part.position(corner));
                    corners.into_iter().zip(nearest.shares).map(|(p, s)| p * f64::from(s)).sum()
                });
                let nearest = nearest.collect();
                all.push((Leaf { triangles: Vec::new(), ..leaf }, nearest));
            }
            Ok(())
        })
        .unwrap();
        all.sort_by_key(|(leaf, _)| leaf.corner.to_array());
        (all, parts)
    }

    #[test]
    fn a_mesh_in_parts_has_the_leaves_of_the_whole_mesh() {
        let (whole, parts) = leaves(u64::MAX);
        assert!(parts == 1 && whole.len() > 1000, "{parts}, {}", whole.len());
        for at_once in [1, 20_000, 100_000] {
            let (divided, parts) = leaves(at_once);
            assert!(parts > 2, "{parts}");
            assert!(divided == whole, "{at_once}");
        }
    }

    #[test]
    fn parts_have_few_pieces_in_common() {
        let outlines: Vec<_> =
            (0..PIECES * PIECES).map(|piece| WavySheet.piece_outline(piece).unwrap()).collect();
        let parts = parts(&outlines, LATTICE, 100_000).unwrap();
        let read: usize = parts.iter().map(|part| part.pieces.len()).sum();
        assert!((4..=10).contains(&parts.len()), "{}", parts.len());
        assert!(read < 2 * outlines.len(), "{read} of {}", outlines.len());
    }
}
