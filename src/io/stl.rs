//! Reads and writes .stl, which stores independent triangles with the coordinates of their corners.
//! The writer writes binary files. The reader reads binary and text files.
//!
//! The format has no shared vertices, so the reader merges corners with exactly equal coordinates.
//! No other part of the library identifies vertices by position. If a mesh touches itself at a
//! vertex, the reader joins the mesh there. Binary coordinates are f32. The format has no
//! attributes.
//!
//! The writer keeps the positions of all vertices in memory, 24 bytes each, unless the mesh itself
//! already has them in memory.

use std::borrow::Cow;
use std::io::{self, Write};

use glam::DVec3;
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::surface::mesh::Mesh;
use crate::surface::mesh::source::MeshSource;

use super::encode::{in_order, write_triangles};
use super::obj::vector;
use super::scan::Scanner;
use super::up::up_comment;
use super::{CoordinateWidth, ReadFault, malformed};

/// The title of a binary file. It must not start with "solid", which marks a text file.
const TITLE: &[u8; 80] =
    b"binary STL, written by meniscus                                                 ";

/// Size, in bytes, of the title and the triangle count.
const HEADER: usize = TITLE.len() + 4;

/// Size of a triangle in bytes: a normal, three corners, and an unused number.
const RECORD: usize = 50;

/// Writes the triangles in binary, with their normals. Triangles without area have a zero normal.
/// The coordinates are always f32.
///
/// # Errors
/// The errors of `mesh` and `out`, and [`io::ErrorKind::OutOfMemory`] if the positions do not fit
/// in memory. If they do not fit, nothing is written.
///
/// # Panics
/// Like [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    _width: CoordinateWidth,
) -> io::Result<()> {
    let positions = mesh
        .whole_positions()
        .map_or_else(|| all_positions(mesh).map(Cow::Owned), |p| Ok(p.into()))?;
    let mut title = *TITLE;
    if let Some(note) = up_comment(mesh) {
        title[TITLE.len() - note.len()..].copy_from_slice(note.as_bytes());
    }
    out.write_all(&title)?;
    out.write_all(&(mesh.triangle_count() as u32).to_le_bytes())?;
    write_triangles(out, mesh, |triangles, out| {
        for triangle in triangles {
            let corners = triangle.map(|vertex| positions[vertex as usize]);
            let [a, b, c] = corners.map(DVec3::from);
            let normal = (b - a).cross(c - a).normalize_or_zero().to_array();
            for vector in [normal].iter().chain(&corners) {
                out.extend(vector.map(|x| (x as f32).to_le_bytes()).as_flattened());
            }
            out.extend([0; 2]);
        }
    })
}

/// Number of vertices that merge into another vertex because their f32 positions are equal.
/// Programs that merge equal corners join the surface there.
///
/// # Errors
/// The errors of `mesh`, and [`io::ErrorKind::OutOfMemory`] if the positions do not fit in memory.
pub fn merged_vertices(mesh: &dyn MeshSource) -> io::Result<u64> {
    let positions = mesh
        .whole_positions()
        .map_or_else(|| all_positions(mesh).map(Cow::Owned), |p| Ok(p.into()))?;
    // Adding 0 turns negative zero into positive zero.
    let mut places: Vec<[u32; 3]> =
        positions.par_iter().map(|position| position.map(|x| (x as f32 + 0.0).to_bits())).collect();
    drop(positions);
    places.par_sort_unstable();
    Ok(places.windows(2).filter(|pair| pair[0] == pair[1]).count() as u64)
}

/// Collects the positions of all pieces in one vector.
fn all_positions(mesh: &dyn MeshSource) -> io::Result<Vec<[f64; 3]>> {
    let mut positions = Vec::new();
    let count = usize::try_from(mesh.vertex_count()).map_err(|_| io::ErrorKind::OutOfMemory)?;
    positions.try_reserve_exact(count).map_err(|_| io::ErrorKind::OutOfMemory)?;
    let make = |piece, buffer: &mut Vec<_>| {
        buffer.extend_from_slice(&mesh.vertices(piece)?.positions);
        Ok(())
    };
    in_order(mesh.pieces(), make, |piece| {
        positions.extend_from_slice(piece);
        Ok(())
    })?;
    Ok(positions)
}

/// Reads a binary or text file, and merges corners with equal coordinates. Normals are ignored.
///
/// # Errors
/// [`ReadFault::Truncated`] or [`ReadFault::Malformed`] for a binary file whose length does not fit
/// its number of triangles, and [`ReadFault::Line`] for invalid text.
pub fn read_mesh(bytes: &[u8]) -> Result<Mesh, ReadFault> {
    // Try binary first, because some binary files also start with "solid". A text file is not
    // mistaken for a binary file, because its bytes 80 to 83 are not a number of triangles that
    // fits its length.
    match records(bytes) {
        Ok(records) => merge_corners(records.flat_map(corners)),
        Err(_) if bytes.starts_with(b"solid") => merge_corners(text(bytes)?.into_iter()),
        Err(fault) => Err(fault),
    }
}

/// The records of the triangles in a binary file.
fn records(bytes: &[u8]) -> Result<impl Iterator<Item = &[u8; RECORD]>, ReadFault> {
    let have = bytes.len() as u64;
    let truncated =
        |what: &str, needed: u64| ReadFault::Truncated { what: what.to_owned(), needed, have };
    let (header, body) = bytes
        .split_first_chunk::<HEADER>()
        .ok_or_else(|| truncated("the header", HEADER as u64))?;
    let [.., a, b, c, d] = *header;
    let count = u32::from_le_bytes([a, b, c, d]);
    let needed = HEADER as u64 + u64::from(count) * RECORD as u64;
    match needed.cmp(&have) {
        std::cmp::Ordering::Greater => {
            Err(truncated(&format!("a list of {count} triangles"), needed))
        }
        std::cmp::Ordering::Less => Err(malformed(
            needed as usize,
            format!("extra bytes follow the last of {count} triangles"),
        )),
        std::cmp::Ordering::Equal => Ok(body.as_chunks().0.iter()),
    }
}

fn corners(record: &[u8; RECORD]) -> [[f64; 3]; 3] {
    let number = |index: usize| {
        let bytes: [u8; 4] = std::array::from_fn(|i| record[4 * index + i]);
        f64::from(f32::from_le_bytes(bytes))
    };
    [3, 6, 9].map(|first| [0, 1, 2].map(|axis| number(first + axis)))
}

/// The corners of the triangles in a text file, which has one statement per line.
fn text(bytes: &[u8]) -> Result<Vec<[f64; 3]>, ReadFault> {
    let mut scan = Scanner::new(bytes, 0);
    let mut corners = Vec::new();
    let mut context = TextContext::Outside;
    loop {
        scan.skip_whitespace();
        let at = scan.at();
        let word = scan.word();
        context = match (context, &word.to_ascii_lowercase()[..]) {
            (TextContext::Outside, b"") => return Ok(corners),
            (TextContext::Outside, b"solid") => TextContext::Solid,
            (TextContext::Solid, b"endsolid") => TextContext::Outside,
            (TextContext::Solid, b"facet" | b"endfacet") => TextContext::Solid,
            (TextContext::Solid, b"outer") => TextContext::Loop { first: corners.len() },
            (TextContext::Loop { first }, b"endloop") if corners.len() == first + 3 => {
                TextContext::Solid
            }
            (TextContext::Loop { first }, b"vertex") if corners.len() < first + 3 => {
                corners.push(vector(&mut scan)?);
                context
            }
            _ => {
                let shown = String::from_utf8_lossy(&word[..word.len().min(40)]);
                let expected = context.expected();
                return Err(scan.fault(at, format!("expected {expected}, found {shown:?}")));
            }
        };
        scan.skip_line();
    }
}

/// The statement that contains the current line of a text file. `Outside` means none.
#[derive(Clone, Copy)]
enum TextContext {
    Outside,
    Solid,
    /// In a triangle. `first` is the number of its first corner.
    Loop {
        first: usize,
    },
}

impl TextContext {
    fn expected(self) -> &'static str {
        match self {
            Self::Outside => "the start of a solid",
            Self::Solid => "a facet or the end of the solid",
            Self::Loop { .. } => "three vertices and the end of the loop",
        }
    }
}

/// Merges corners with equal coordinates into vertices. Vertices are in the order of their first
/// corners.
fn merge_corners(corners: impl Iterator<Item = [f64; 3]>) -> Result<Mesh, ReadFault> {
    let mut mesh = Mesh::default();
    let mut known = HashMap::new();
    let mut triangle = Vec::with_capacity(3);
    for position in corners {
        let next = u32::try_from(mesh.positions.len()).map_err(|_| {
            ReadFault::Unsupported(
                "the file has too many corners: a mesh must have fewer than 2^32 vertices"
                    .to_owned(),
            )
        })?;
        let vertex = *known.entry(position.map(f64::to_bits)).or_insert(next);
        if vertex == next {
            mesh.positions.push(position);
        }
        triangle.push(vertex);
        if let [a, b, c] = triangle[..] {
            mesh.triangles.push([a, b, c]);
            triangle.clear();
        }
    }
    Ok(mesh)
}
