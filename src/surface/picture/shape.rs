//! A mesh as drawing wants it: in memory as a whole, or in batches of triangles that are read again for each pass.

use std::borrow::Cow;
use std::io;
use std::ops::Range;

use rayon::prelude::*;

use crate::surface::mesh::bounds::{Bounds, joined};
use crate::surface::mesh::source::MeshSource;
use crate::system::memory::empty_in_huge_pages;

use super::camera::FARTHEST;
use super::colour::Values;
use super::error::PictureError;
use super::memory::Memory;
use super::ranked::{Entered, Ranked};
use super::request::Scope;

/// Bytes of a vertex that is kept: its place, and its corner while it is drawn.
pub(super) const VERTEX_BYTES: u64 = (size_of::<[f64; 3]>() + size_of::<super::raster::Corner>()) as u64;
pub(super) const TRIANGLE_BYTES: u64 = size_of::<[u32; 3]>() as u64;
/// Bytes of a triangle of a batch whose corners are no other's.
const BATCH_BYTES: u64 = TRIANGLE_BYTES + 3 * VERTEX_BYTES;
/// Triangles of the smallest batch: of a piece, and what is read beside it.
pub(super) const LEAST_BATCH: u64 = 1 << 17;
pub(super) const LEAST_BATCH_BYTES: u64 = LEAST_BATCH * BATCH_BYTES;
/// Pieces that each thread reads before they are put together.
const PIECES: usize = 16;

/// A mesh, its box and the range of its values.
pub(super) struct Shape<'a> {
    pub(super) mesh: &'a dyn MeshSource,
    pub(super) scope: Scope,
    /// The number of the first vertex of each piece, and of all vertices.
    firsts: Vec<u32>,
    kept: Option<Kept<'a>>,
    /// Triangles of a batch, of a mesh that is not kept.
    batch: usize,
}

/// All of a mesh.
struct Kept<'a> {
    places: Cow<'a, [[f64; 3]]>,
    normals: Vec<[f32; 3]>,
    values: Vec<f32>,
    triangles: Vec<[u32; 3]>,
}

/// Triangles of a mesh, and all of their corners.
pub(super) struct Batch<'a> {
    /// The number of the first triangle.
    pub(super) first: u32,
    /// Corners by their numbers in the mesh.
    pub(super) triangles: &'a [[u32; 3]],
    pub(super) places: &'a [[f64; 3]],
    /// The vertices whose places these are; `None` for all of the mesh.
    held: Option<Ranked>,
}

impl Batch<'_> {
    /// Where the place of a vertex is, if it is here.
    #[inline]
    pub(super) fn find(&self, vertex: u32) -> Option<usize> {
        match &self.held {
            None => Some(vertex as usize),
            Some(held) => held.rank(vertex).map(|rank| rank as usize),
        }
    }

    /// The place of a corner.
    #[inline]
    pub(super) fn index(&self, corner: u32) -> usize {
        self.find(corner).expect("a batch has its triangles' corners")
    }
}

impl<'a> Shape<'a> {
    /// Reads the vertices of a mesh, and its triangles if all are kept.
    pub(super) fn read(
        mesh: &'a dyn MeshSource,
        values: &Values<'_>,
        memory: &Memory,
    ) -> Result<Self, PictureError> {
        let outline = mesh.outline();
        let [vertices, triangles] = [outline.vertices, outline.triangles];
        if u32::try_from(vertices.max(triangles)).is_err() {
            let what = format!("a picture is drawn of no more than {} vertices and triangles", u32::MAX);
            return Err(io::Error::new(io::ErrorKind::InvalidInput, what).into());
        }
        let keep = matches!(memory, Memory::Whole);
        let borrowed = mesh.whole_positions().filter(|_| keep);
        let mut kept = Kept {
            places: borrowed.map_or_else(
                || Cow::Owned(empty_in_huge_pages(if keep { vertices as usize } else { 0 })),
                Cow::Borrowed,
            ),
            normals: Vec::new(),
            values: Vec::new(),
            triangles: empty_in_huge_pages(if keep { triangles as usize } else { 0 }),
        };
        let (mut scope, mut firsts) = (Scope::default(), vec![0]);
        let group = PIECES * rayon::current_num_threads();
        for start in (0..outline.pieces).step_by(group) {
            let pieces: Vec<_> = (start..(start + group).min(outline.pieces))
                .into_par_iter()
                .map(|piece| -> io::Result<_> {
                    let read = mesh.vertices(piece)?;
                    let values = values.of(&read);
                    let finite = values.iter().copied().filter(|value| value.is_finite());
                    let range = finite.map(|value| [value; 2]).reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]);
                    let scope = Scope { bounds: box_of(&read.positions), range };
                    let triangles = if keep { triangles_of(mesh, piece, vertices)? } else { Vec::new() };
                    Ok((read, values, scope, triangles))
                })
                .collect::<io::Result<_>>()?;
            for (read, values, of_piece, triangles) in pieces {
                scope = scope.joined(of_piece);
                firsts.push(firsts[firsts.len() - 1] + read.positions.len() as u32);
                if keep {
                    if borrowed.is_none() {
                        kept.places.to_mut().extend_from_slice(&read.positions);
                    }
                    kept.normals.extend_from_slice(&read.normals);
                    kept.values.extend(values);
                    kept.triangles.extend(triangles);
                }
            }
        }
        scope.range = scope.range.map(|range| values.range(range));
        let batch = match *memory {
            Memory::Whole => 0,
            Memory::Batches(bytes) => ((bytes / BATCH_BYTES).max(LEAST_BATCH) - LEAST_BATCH / 2) as usize,
        };
        Ok(Self { mesh, scope, firsts, kept: keep.then_some(kept), batch })
    }

    /// How many vertices there are.
    pub(super) fn vertices(&self) -> u32 {
        self.firsts[self.firsts.len() - 1]
    }

    /// How many vertices a batch has, where that is known.
    pub(super) fn most_corners(&self) -> usize {
        self.kept.as_ref().map_or(0, |kept| kept.places.len())
    }

    /// The normals of all vertices, where they have any and are in memory.
    pub(super) fn kept_normals(&self) -> Option<&[[f32; 3]]> {
        self.kept.as_ref().map(|kept| &kept.normals[..])
    }

    /// The values of all vertices, where they are in memory.
    pub(super) fn kept_values(&self) -> Option<&[f32]> {
        self.kept.as_ref().map(|kept| &kept.values[..])
    }

    /// The vertices of each piece.
    pub(super) fn pieces(&self) -> impl Iterator<Item = Range<u32>> + '_ {
        self.firsts.windows(2).map(|ends| ends[0]..ends[1])
    }

    /// Passes all triangles on, with the places of their corners.
    pub(super) fn batches(
        &self,
        mut pass: impl FnMut(&Batch<'_>) -> Result<(), PictureError>,
    ) -> Result<(), PictureError> {
        if let Some(kept) = &self.kept {
            return pass(&Batch { first: 0, triangles: &kept.triangles, places: &kept.places, held: None });
        }
        self.triangles(|first, triangles| {
            let (held, places) = self.places_of(triangles)?;
            pass(&Batch { first, triangles, places: &places, held: Some(held) })
        })
    }

    /// Passes all triangles on: the number of the first, and their corners.
    pub(super) fn triangles(
        &self,
        mut pass: impl FnMut(u32, &[[u32; 3]]) -> Result<(), PictureError>,
    ) -> Result<(), PictureError> {
        if let Some(kept) = &self.kept {
            return pass(0, &kept.triangles);
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

    /// The places of the corners of triangles.
    fn places_of(&self, triangles: &[[u32; 3]]) -> io::Result<(Ranked, Vec<[f64; 3]>)> {
        let range = triangles
            .par_iter()
            .map(|&[a, b, c]| [a.min(b).min(c), a.max(b).max(c)])
            .reduce(|| [u32::MAX, 0], |[a, b], [c, d]| [a.min(c), b.max(d)]);
        let held = Entered::none_of(range[0]..range[1].saturating_add(1));
        triangles.par_iter().flatten_iter().for_each(|&corner| held.insert(corner));
        let held = held.ranked();
        let pieces: Vec<(usize, Range<u32>)> = self.pieces().enumerate().collect();
        let mut places = Vec::with_capacity(held.len());
        for pieces in pieces.chunks(rayon::current_num_threads()) {
            let read: Vec<Vec<[f64; 3]>> = pieces
                .par_iter()
                .map(|(piece, range)| {
                    let mut members = held.within(range.clone()).peekable();
                    if members.peek().is_none() {
                        return Ok(Vec::new());
                    }
                    let read = self.mesh.vertices(*piece)?;
                    Ok(members.map(|member| read.positions[(member - range.start) as usize]).collect())
                })
                .collect::<io::Result<_>>()?;
            places.extend(read.into_iter().flatten());
        }
        Ok((held, places))
    }
}

/// The box around what can be seen.
fn box_of(places: &[[f64; 3]]) -> Option<Bounds> {
    let sound = places.iter().filter(|place| place.iter().all(|x| x.abs() <= FARTHEST));
    sound.map(|&place| [place; 2]).reduce(joined)
}

/// Triangles of a piece; those that name vertices which there are not have no area.
fn triangles_of(mesh: &dyn MeshSource, piece: usize, vertices: u64) -> io::Result<Vec<[u32; 3]>> {
    let triangles = mesh.triangles(piece)?.into_iter();
    let sound = |corners: [u64; 3]| match corners.iter().all(|&corner| corner < vertices) {
        true => corners.map(|corner| corner as u32),
        false => [0; 3],
    };
    Ok(if vertices == 0 { Vec::new() } else { triangles.map(sound).collect() })
}
