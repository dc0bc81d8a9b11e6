//! A mesh for drawing: in memory, or in batches of triangles that are read again for each pass.

use std::borrow::Cow;
use std::io;
use std::ops::Range;

use rayon::prelude::*;

use crate::surface::mesh::source::MeshSource;
use crate::surface::mesh::source::{Corners, joined};
use crate::system::memory::zeroed_in_huge_pages;

use super::camera::FARTHEST;
use super::colour::ColourSource;
use super::colour::ValueStatistics;
use super::ranked::{AtomicSet, RankedSet};
use super::raster::ProjectedCorners;
use super::request::MeshMemory;
use super::request::PictureError;
use super::request::Scope;

/// Memory per vertex, in bytes: its position, and its corner in each view during drawing.
pub(super) const VERTEX_BYTES: u64 = size_of::<[f64; 3]>() as u64 + ProjectedCorners::BYTES;
pub(super) const TRIANGLE_BYTES: u64 = size_of::<[u32; 3]>() as u64;
/// Memory per triangle, in bytes, of a batch whose triangles share no corners.
const BATCH_BYTES: u64 = TRIANGLE_BYTES + 3 * VERTEX_BYTES;
/// Minimum number of triangles per batch, so that a batch has room for one piece with its vertices.
pub(super) const LEAST_BATCH: u64 = 1 << 17;
pub(super) const LEAST_BATCH_BYTES: u64 = LEAST_BATCH * BATCH_BYTES;
/// Number of pieces per thread that are read before they are joined.
const PIECES: usize = 16;

/// Number of positions per task.
const PLACES: usize = 1 << 12;

/// A mesh with its bounding box and its range of values.
pub(super) struct Shape<'a> {
    pub(super) mesh: &'a dyn MeshSource,
    pub(super) scope: Scope,
    /// The number of the first vertex of each piece; the last entry is the total number of
    /// vertices.
    firsts: Vec<u32>,
    whole: Option<WholeMesh<'a>>,
    /// Number of triangles per batch of a mesh that is not in memory.
    batch: usize,
}

/// A whole mesh in memory.
struct WholeMesh<'a> {
    places: Cow<'a, [[f64; 3]]>,
    normals: Vec<[f32; 3]>,
    values: Vec<f32>,
    triangles: Vec<[u32; 3]>,
}

/// A batch of triangles, with the positions of all of their vertices.
pub(super) struct TriangleBatch<'a> {
    /// The number of the first triangle.
    pub(super) first: u32,
    /// The corners of each triangle, as numbers of vertices of the mesh.
    pub(super) triangles: &'a [[u32; 3]],
    pub(super) places: &'a [[f64; 3]],
    /// The vertices to which `places` belong; `None` if these are all vertices of the mesh.
    vertex_set: Option<RankedSet>,
}

impl TriangleBatch<'_> {
    /// The index of the position of a vertex; `None` if the batch lacks the vertex.
    #[inline]
    pub(super) fn find(&self, vertex: u32) -> Option<usize> {
        match &self.vertex_set {
            None => Some(vertex as usize),
            Some(vertex_set) => vertex_set.rank(vertex).map(|rank| rank as usize),
        }
    }

    /// The index of the position of a corner.
    #[inline]
    pub(super) fn index(&self, corner: u32) -> usize {
        self.find(corner).expect("a batch has its triangles' corners")
    }
}

impl<'a> Shape<'a> {
    /// Reads the vertices of a mesh, and also its triangles if the whole mesh is held in memory.
    pub(super) fn read(
        mesh: &'a dyn MeshSource,
        kind: &ColourSource<'_>,
        memory: &MeshMemory,
    ) -> Result<Self, PictureError> {
        let outline = mesh.outline();
        let [vertices, triangles] = [outline.vertices, outline.triangles];
        if u32::try_from(vertices.max(triangles)).is_err() {
            let what = format!("a picture can show at most {} vertices and triangles", u32::MAX);
            return Err(io::Error::new(io::ErrorKind::InvalidInput, what).into());
        }
        let keep = matches!(memory, MeshMemory::Whole);
        if keep
            && !outline.normals
            && !kind.has_values()
            && let Some((places, triangles)) = mesh.at_once()?
        {
            let bounds = places.par_chunks(PLACES).filter_map(box_of).reduce_with(joined);
            let places = Cow::Owned(places);
            let whole = WholeMesh { places, normals: Vec::new(), values: Vec::new(), triangles };
            let scope = Scope { bounds, ..Scope::default() };
            return Ok(Self {
                mesh,
                scope,
                firsts: vec![0, vertices as u32],
                whole: Some(whole),
                batch: 0,
            });
        }
        let borrowed = mesh.whole_positions().filter(|_| keep);
        let room = |wanted: bool, count: u64| if keep && wanted { count as usize } else { 0 };
        let mut whole = WholeMesh {
            places: borrowed.map_or_else(
                || Cow::Owned(zeroed_in_huge_pages(room(true, vertices))),
                Cow::Borrowed,
            ),
            normals: zeroed_in_huge_pages(room(outline.normals, vertices)),
            values: zeroed_in_huge_pages(room(kind.has_values(), vertices)),
            triangles: zeroed_in_huge_pages(room(true, triangles)),
        };
        let mut triangles_end = 0;
        let (mut scope, mut statistics, mut firsts) =
            (Scope::default(), ValueStatistics::default(), vec![0]);
        let group = PIECES * rayon::current_num_threads();
        for start in (0..outline.pieces).step_by(group) {
            let pieces: Vec<_> = (start..(start + group).min(outline.pieces))
                .into_par_iter()
                .map(|piece| -> io::Result<_> {
                    let read = mesh.vertices(piece)?;
                    let values = kind.of(&read);
                    let known = (box_of(&read.positions), ValueStatistics::of(&values, kind));
                    let triangles =
                        if keep { triangles_of(mesh, piece, vertices)? } else { Vec::new() };
                    Ok((read, values, known, triangles))
                })
                .collect::<io::Result<_>>()?;
            let first = firsts[firsts.len() - 1] as usize;
            for (read, _, (of_piece, of_values), _) in &pieces {
                scope.bounds = [scope.bounds, *of_piece].into_iter().flatten().reduce(joined);
                statistics.join(of_values);
                firsts.push(firsts[firsts.len() - 1] + read.positions.len() as u32);
            }
            if keep {
                if borrowed.is_none() {
                    copy_pieces(whole.places.to_mut(), first, &pieces, |(read, ..)| {
                        &read.positions
                    });
                }
                if outline.normals {
                    copy_pieces(&mut whole.normals, first, &pieces, |(read, ..)| &read.normals);
                }
                if kind.has_values() {
                    copy_pieces(&mut whole.values, first, &pieces, |(_, values, ..)| values);
                }
                triangles_end =
                    copy_pieces(&mut whole.triangles, triangles_end, &pieces, |(.., triangles)| {
                        triangles
                    });
            }
        }
        (scope.range, scope.beyond) = statistics.range();
        let batch = match *memory {
            MeshMemory::Whole => 0,
            MeshMemory::Batches(bytes) => {
                ((bytes / BATCH_BYTES).max(LEAST_BATCH) - LEAST_BATCH / 2) as usize
            }
        };
        Ok(Self { mesh, scope, firsts, whole: keep.then_some(whole), batch })
    }

    /// Number of vertices.
    pub(super) fn vertices(&self) -> u32 {
        self.firsts[self.firsts.len() - 1]
    }

    /// Maximum number of vertices in a batch; 0 if not known.
    pub(super) fn most_corners(&self) -> usize {
        self.whole.as_ref().map_or(0, |whole| whole.places.len())
    }

    /// The normals of all vertices, if the mesh is in memory; empty if it has no normals.
    pub(super) fn whole_normals(&self) -> Option<&[[f32; 3]]> {
        self.whole.as_ref().map(|whole| &whole.normals[..])
    }

    /// The values of all vertices, if the mesh is in memory; empty if no values are shown.
    pub(super) fn whole_values(&self) -> Option<&[f32]> {
        self.whole.as_ref().map(|whole| &whole.values[..])
    }

    /// The range of vertices of each piece.
    pub(super) fn pieces(&self) -> impl Iterator<Item = Range<u32>> + '_ {
        self.firsts.windows(2).map(|ends| ends[0]..ends[1])
    }

    /// Calls `pass` for each batch of triangles, which includes the positions of their corners.
    pub(super) fn batches(
        &self,
        mut pass: impl FnMut(&TriangleBatch<'_>) -> Result<(), PictureError>,
    ) -> Result<(), PictureError> {
        if let Some(whole) = &self.whole {
            return pass(&TriangleBatch {
                first: 0,
                triangles: &whole.triangles,
                places: &whole.places,
                vertex_set: None,
            });
        }
        self.triangles(|first, triangles| {
            let (vertex_set, places) = self.places_of(triangles)?;
            pass(&TriangleBatch { first, triangles, places: &places, vertex_set: Some(vertex_set) })
        })
    }

    /// Calls `pass` for each batch of triangles, with the number of the batch's first triangle and
    /// the corners of all its triangles.
    pub(super) fn triangles(
        &self,
        mut pass: impl FnMut(u32, &[[u32; 3]]) -> Result<(), PictureError>,
    ) -> Result<(), PictureError> {
        if let Some(whole) = &self.whole {
            return pass(0, &whole.triangles);
        }
        let pieces = self.mesh.pieces();
        let vertices = self.vertices().into();
        let (mut first, mut triangles) = (0, Vec::<[u32; 3]>::new());
        let threads = rayon::current_num_threads();
        for start in (0..pieces).step_by(threads) {
            let read: Vec<_> = (start..(start + threads).min(pieces))
                .into_par_iter()
                .map(|piece| triangles_of(self.mesh, piece, vertices))
                .collect::<io::Result<_>>()?;
            triangles.extend(read.into_iter().flatten());
            if triangles.len() >= self.batch {
                pass(first, &triangles)?;
                first += triangles.len() as u32;
                triangles.clear();
            }
        }
        if triangles.is_empty() { Ok(()) } else { pass(first, &triangles) }
    }

    /// The corners of `triangles` without repetition, and their positions.
    fn places_of(&self, triangles: &[[u32; 3]]) -> io::Result<(RankedSet, Vec<[f64; 3]>)> {
        let range = triangles
            .par_iter()
            .map(|&[a, b, c]| [a.min(b).min(c), a.max(b).max(c)])
            .reduce(|| [u32::MAX, 0], |[a, b], [c, d]| [a.min(c), b.max(d)]);
        let vertex_set = AtomicSet::none_of(range[0]..range[1].saturating_add(1));
        triangles.par_iter().flatten_iter().for_each(|&corner| vertex_set.insert(corner));
        let vertex_set = vertex_set.ranked();
        let pieces: Vec<(usize, Range<u32>)> = self.pieces().enumerate().collect();
        let mut places = Vec::with_capacity(vertex_set.len());
        for pieces in pieces.chunks(rayon::current_num_threads()) {
            let read: Vec<Vec<[f64; 3]>> = pieces
                .par_iter()
                .map(|(piece, range)| {
                    let mut members = vertex_set.within(range.clone()).peekable();
                    if members.peek().is_none() {
                        return Ok(Vec::new());
                    }
                    let read = self.mesh.vertices(*piece)?;
                    Ok(members
                        .map(|member| read.positions[(member - range.start) as usize])
                        .collect())
                })
                .collect::<io::Result<_>>()?;
            places.extend(read.into_iter().flatten());
        }
        Ok((vertex_set, places))
    }
}

/// Copies the data of `pieces` into an array, from index `first` on, with several threads. Returns
/// the end index.
fn copy_pieces<P: Sync, T: Copy + Send + Sync>(
    into: &mut [T],
    first: usize,
    pieces: &[P],
    of: impl Fn(&P) -> &[T],
) -> usize {
    let mut rest = &mut into[first..];
    let mut parts = Vec::with_capacity(pieces.len());
    let mut end = first;
    for from in pieces.iter().map(of) {
        let (own, others) = rest.split_at_mut(from.len());
        parts.push((own, from));
        rest = others;
        end += from.len();
    }
    parts.into_par_iter().for_each(|(own, from)| own.copy_from_slice(from));
    end
}

/// The bounding box of the positions that can be drawn: the magnitudes of their coordinates are at
/// most [`FARTHEST`].
fn box_of(places: &[[f64; 3]]) -> Option<Corners> {
    let none = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    // This loop has no branches. Positions that cannot be drawn are replaced by values that do not
    // change the box.
    let found = places.iter().fold(none, |[lo, hi], place| {
        let sound = place.iter().fold(true, |sound, x| sound & (x.abs() <= FARTHEST));
        let place = |none: f64| place.map(|x| if sound { x } else { none });
        joined([lo, hi], [place(f64::INFINITY), place(f64::NEG_INFINITY)])
    });
    (found[0][0] <= found[1][0]).then_some(found)
}

/// Triangles of a piece; triangles with missing vertices become degenerate.
fn triangles_of(mesh: &dyn MeshSource, piece: usize, vertices: u64) -> io::Result<Vec<[u32; 3]>> {
    let triangles = mesh.triangles(piece)?.into_iter();
    let sound = |corners: [u64; 3]| match corners.iter().all(|&corner| corner < vertices) {
        true => corners.map(|corner| corner as u32),
        false => [0; 3],
    };
    Ok(if vertices == 0 { Vec::new() } else { triangles.map(sound).collect() })
}
