//! Encodes the pieces of a mesh on all threads, and writes them in order.
//!
//! The closures that encode a piece are called through pointers. This compiles faster than one copy
//! of the thread pool's code for each closure, and costs little because pieces are large.

use std::io::{self, Write};
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::surface::attribute::are_wide;
use crate::surface::mesh::source::{MeshSource, Vertices};

use super::CoordinateWidth;

/// Calls `encode` for pieces 0 to `pieces - 1`, and writes the results in order.
///
/// While this thread writes one batch of pieces, the thread pool encodes the next batch. A batch
/// has at most two pieces per thread. The written bytes do not depend on the number of threads.
///
/// # Errors
/// The first error of `encode` or `out`, in piece order. Nothing is written after the error.
pub fn write_pieces(
    out: &mut dyn Write,
    pieces: usize,
    encode: impl Fn(usize, &mut Vec<u8>) -> io::Result<()> + Sync,
) -> io::Result<()> {
    in_order(pieces, encode, |bytes| out.write_all(bytes))
}

/// Appends the values of a piece to a buffer.
type Make<'a, T> = dyn Fn(usize, &mut Vec<T>) -> io::Result<()> + Sync + 'a;
/// Appends the bytes of a piece's triangles to a buffer.
type EncodeTriangles<'a> = dyn Fn(&[[u64; 3]], &mut Vec<u8>) + Sync + 'a;
/// Consumes the values of pieces, in order.
type Take<'a, T> = dyn FnMut(&[T]) -> io::Result<()> + 'a;

/// Number of pieces in a batch, enough to keep all threads busy.
fn pieces_at_once() -> usize {
    2 * rayon::current_num_threads()
}

/// Like [`write_pieces`], for values of any type. `make` appends the values of a piece to a buffer,
/// and `take` consumes the buffers in order.
pub(super) fn in_order<T: Send>(
    pieces: usize,
    make: impl Fn(usize, &mut Vec<T>) -> io::Result<()> + Sync,
    mut take: impl FnMut(&[T]) -> io::Result<()>,
) -> io::Result<()> {
    in_batches(pieces, pieces_at_once(), &make, &mut take)
}

fn in_batches<T: Send>(
    pieces: usize,
    batch: usize,
    make: &Make<'_, T>,
    take: &mut Take<'_, T>,
) -> io::Result<()> {
    let batch = batch.min(pieces);
    let buffers = || -> Vec<_> { (0..batch).map(|_| (Vec::new(), Ok(()))).collect() };
    let (mut ready, mut next) = (buffers(), buffers());
    let mut made = 0;
    for first in (0..pieces).step_by(batch.max(1)) {
        made = make_while(&mut next, first..pieces, make, || take_all(&mut ready[..made], take))?;
        std::mem::swap(&mut ready, &mut next);
    }
    take_all(&mut ready[..made], take)
}

/// The values that `make` appended for a piece, and the result of this call of `make`.
type Made<T> = (Vec<T>, io::Result<()>);

/// Calls `make` on the thread pool for the first pieces of `pieces`, at most one for each buffer,
/// while `meanwhile` runs on this thread. Returns the number of pieces for which `make` was called.
fn make_while<T: Send>(
    buffers: &mut [Made<T>],
    pieces: Range<usize>,
    make: &Make<'_, T>,
    meanwhile: impl FnOnce() -> io::Result<()>,
) -> io::Result<usize> {
    let made = pieces.len().min(buffers.len());
    rayon::in_place_scope(|scope| {
        for (piece, (buffer, result)) in pieces.zip(buffers) {
            scope.spawn(move |_| {
                buffer.clear();
                *result = make(piece, buffer);
            });
        }
        meanwhile()
    })?;
    Ok(made)
}

fn take_all<T>(made: &mut [Made<T>], take: &mut Take<'_, T>) -> io::Result<()> {
    made.iter_mut().try_for_each(|(buffer, result)| {
        std::mem::replace(result, Ok(()))?;
        take(buffer)
    })
}

/// Calls `encode` for the vertices of each piece, and writes the results in order.
///
/// # Panics
/// If a piece's arrays differ in length, or the pieces do not contain all vertices.
pub(super) fn write_vertices(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    encode: impl Fn(&Vertices, &mut Vec<u8>) + Sync,
) -> io::Result<()> {
    write_each_piece(out, mesh, &encode)
}

fn write_each_piece(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    encode: &(dyn Fn(&Vertices, &mut Vec<u8>) + Sync),
) -> io::Result<()> {
    let attributes = mesh.attributes();
    // If the attributes together have many components, each piece is large, so a batch contains
    // only one piece.
    let wide = are_wide(attributes.iter().map(|info| info.components));
    let batch = if wide { 1 } else { pieces_at_once() };
    let count = AtomicU64::new(0);
    let encode = |piece: usize, out: &mut Vec<u8>| {
        let vertices = mesh.vertices(piece)?;
        let len = vertices.positions.len();
        let normals = if mesh.has_normals() { len } else { 0 };
        assert_eq!(vertices.normals.len(), normals, "one normal per vertex, or no normals");
        assert_eq!(vertices.attributes.len(), attributes.len(), "all attributes in every piece");
        for (info, values) in attributes.iter().zip(&vertices.attributes) {
            assert_eq!(
                Some(values.len()),
                len.checked_mul(info.components),
                "{info:?} on {len} vertices"
            );
        }
        count.fetch_add(len as u64, Ordering::Relaxed);
        encode(&vertices, out);
        Ok(())
    };
    in_batches(mesh.pieces(), batch, &encode, &mut |bytes| out.write_all(bytes))?;
    assert_eq!(count.into_inner(), mesh.vertex_count(), "all vertices are in the pieces");
    Ok(())
}

/// Writes attribute number `index` of the vertices, little-endian, piece by piece. Colours are
/// written as bytes. Other values are written as the 32 bits that the mesh stores.
pub(super) fn write_attribute(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    index: usize,
) -> io::Result<()> {
    let kind = mesh.attributes()[index].kind;
    if !kind.is_colour() {
        return write_floats(out, mesh, |vertices| &vertices.attributes[index]);
    }
    write_vertices(out, mesh, |vertices, out| {
        out.extend(vertices.attributes[index].iter().map(|&value| kind.byte(value)));
    })
}

/// Writes the numbers that `values` returns for the vertices, little-endian, piece by piece.
pub(super) fn write_floats(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    values: impl for<'a> Fn(&'a Vertices) -> &'a [f32] + Sync,
) -> io::Result<()> {
    write_vertices(out, mesh, |vertices, out| {
        let values = values(vertices);
        out.reserve_exact(size_of_val(values));
        values.iter().for_each(|value| out.extend(value.to_le_bytes()));
    })
}

/// Appends a position to `out`, little-endian.
pub(super) fn put_position(out: &mut Vec<u8>, position: [f64; 3], width: CoordinateWidth) {
    match width {
        CoordinateWidth::F32 => {
            out.extend(position.map(|x| (x as f32).to_le_bytes()).as_flattened())
        }
        CoordinateWidth::F64 => out.extend(position.map(f64::to_le_bytes).as_flattened()),
    }
}

/// Calls `encode` for the triangles of each piece, and writes the results in order.
///
/// # Panics
/// If a triangle refers to a missing vertex, or the pieces do not contain all triangles.
pub(super) fn write_triangles(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    encode: impl Fn(&[[u64; 3]], &mut Vec<u8>) + Sync,
) -> io::Result<()> {
    write_triangles_of_each_piece(out, mesh, &encode)
}

fn write_triangles_of_each_piece(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    encode: &EncodeTriangles<'_>,
) -> io::Result<()> {
    let vertices = mesh.vertex_count();
    let count = AtomicU64::new(0);
    write_pieces(out, mesh.pieces(), |piece, out| {
        let triangles = mesh.triangles(piece)?;
        let missing = triangles.as_flattened().iter().find(|&&vertex| vertex >= vertices);
        assert!(missing.is_none(), "a triangle refers to vertex {missing:?} of {vertices}");
        count.fetch_add(triangles.len() as u64, Ordering::Relaxed);
        encode(&triangles, out);
        Ok(())
    })?;
    assert_eq!(count.into_inner(), mesh.triangle_count(), "all triangles are in the pieces");
    Ok(())
}
