//! Reads legacy .vtk files. The points and attributes of a binary file are read in place. Cells
//! become triangles.

use std::ops::Range;

use crate::io::bytes::{ByteView, Bytes, UnpackBuffer, Unpacking};
use crate::io::cell_types::{
    CellCounts, PIXEL, POLYGON, QUAD, TRIANGLE, TRIANGLE_STRIP, VERTEX, is_face,
};
use crate::io::columns::{Column, Endian, Scalar};
use crate::io::ghosts::{VertexCells, VertexPoints};
use crate::io::number::{ParseNumber, is_length};
use crate::io::text::decode_numbers;
use crate::io::vertices::{FileVertices, Triangles, columns, integer};
use crate::io::{ParticleFile, ReadFault, UnreadPart, malformed};
use crate::particles::AttributeInfo;
use crate::surface::mesh::Mesh;

use super::layout::{AT_ONCE, each_integer, integers, stored};
use super::layout::{CellCorners, CellKind, VtkArray, VtkCells, VtkLayout, is_text};

/// Reads a file of particles with [`read_points`].
///
/// # Errors
/// [`ReadFault::Mesh`] if a cell has an area or a volume, and the errors of [`read_points`].
pub fn read_particles(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let bytes = whole_file_if_text(bytes, unpacking)?;
    let layout = VtkLayout::parse(bytes.view())?;
    let mut cells = CellCounts::default();
    for more in cell_counts(bytes.view(), &layout) {
        cells = cells.plus(more?);
    }
    if cells.faces > 0 {
        return Err(ReadFault::Mesh { faces: cells.faces });
    }
    let file = points(bytes, &layout, unpacking)?;
    Ok(ParticleFile { only_lines: cells.are_lines(), ..file })
}

/// Reads the points as particles, even if the file is a mesh. Binary arrays are read in place. Text
/// is decoded into columns of f64.
///
/// Every numeric array in `POINT_DATA` becomes an attribute. Percent codes in its name are decoded.
/// Arrays in `CELL_DATA` become attributes if cell i is a vertex at point i, and if there is one
/// cell per point. Strings, bits and colours are skipped. If all cells are vertices, a point is
/// left out if cell data flags all of its cells as copies or hidden. A field of the file with one
/// of the names [`TIMES`](crate::io::names::TIMES) gives the time.
///
/// # Errors
/// [`ReadFault::Truncated`] for an array that exceeds the file, [`ReadFault::Malformed`] (or
/// [`ReadFault::Line`] in a text file) for invalid or contradictory sections,
/// [`ReadFault::Unsupported`] for data sets other than `UNSTRUCTURED_GRID` and `POLYDATA`, and
/// [`ReadFault::Scratch`] if text is decoded and the scratch file cannot be written.
pub fn read_points(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let bytes = whole_file_if_text(bytes, unpacking)?;
    let layout = VtkLayout::parse(bytes.view())?;
    points(bytes, &layout, unpacking)
}

/// Returns `bytes` unchanged if the file is binary. Otherwise, reads the whole file.
pub(in crate::io) fn whole_file_if_text(
    bytes: Bytes,
    unpacking: Unpacking,
) -> Result<Bytes, ReadFault> {
    if is_text(bytes.view()) { bytes.read_whole(unpacking).map(Bytes::Kept) } else { Ok(bytes) }
}

fn points(
    bytes: Bytes,
    layout: &VtkLayout,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadFault> {
    let format = if layout.ascii { "legacy VTK, ASCII" } else { "legacy VTK, binary" };
    let time =
        layout.time.as_ref().map(|array| number(bytes.view(), layout.ascii, array)).transpose()?;
    let non_ghosts = non_ghost_points(bytes.view(), layout)?;
    let (mut cell_data, mut left_out): (&[_], _) = (&layout.cell_data, Vec::new());
    if !cell_data.is_empty() && !cells_are_points(bytes.view(), layout)? {
        left_out = cell_data.iter().map(|a| UnreadPart::CellData(a.name.clone())).collect();
        cell_data = &[];
    }
    let vertices = vertices(bytes.view(), layout, cell_data, unpacking)?;
    let time = time.flatten().filter(|time| time.is_finite());
    let texts = layout.texts.clone();
    Ok(ParticleFile { time, texts, left_out, ..vertices.into_particles(bytes, format) }
        .with_points(non_ghosts))
}

/// Whether the file is a mesh, which means that a cell has an area or a volume.
pub fn has_faces(bytes: ByteView) -> Result<bool, ReadFault> {
    for cells in cell_counts(bytes, &VtkLayout::parse(bytes)?) {
        if cells?.faces > 0 {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Counts the cells. The first item counts the cells without a type. Each further item counts the
/// cells in a part of the array of types. The caller adds up the items.
fn cell_counts<'a>(
    bytes: ByteView<'a>,
    layout: &'a VtkLayout,
) -> impl Iterator<Item = Result<CellCounts, ReadFault>> + 'a {
    let faces = layout.cells.iter().filter(|cells| cells.kind != CellKind::Typed);
    let untyped = CellCounts {
        faces: faces.map(|cells| cells.corners.cells() as u64).fold(0, u64::saturating_add),
        lines: layout.line_cells as u64,
        vertices: layout.vertices.as_ref().map_or(0, CellCorners::cells) as u64,
    };
    let typed = layout.cell_types.iter().flat_map(move |types| {
        let rows = if layout.ascii { types.tuples.max(1) } else { AT_ONCE };
        (0..types.tuples).step_by(rows).map(move |first| {
            let mut counts = CellCounts::default();
            if layout.ascii {
                for kind in integers(bytes.kept()?.bytes(), true, types) {
                    counts.add(kind?);
                }
                return Ok(counts);
            }
            let size = types.scalar.size();
            let end = types.tuples.min(first + rows);
            let piece = bytes.read(types.at + first * size..types.at + end * size)?;
            for kind in stored(&piece, types) {
                counts.add(kind?);
            }
            Ok(counts)
        })
    });
    std::iter::once(Ok(untyped)).chain(typed)
}

/// Reads points, and converts polygons, triangle strips and typed cells with an area to triangles.
///
/// Each polygon becomes a fan of triangles around its first corner. Vertex cells and lines are
/// ignored.
///
/// # Errors
/// The errors of [`read_points`], [`ReadFault::Malformed`] for a cell that refers to a missing
/// point, and [`ReadFault::Unsupported`] for cells with a volume.
pub fn read_mesh(bytes: &[u8]) -> Result<Mesh, ReadFault> {
    let view = ByteView::from(bytes);
    let layout = VtkLayout::parse(view)?;
    let mut triangles = Triangles::new(layout.points.tuples)?;
    let mut types = layout.cell_types.iter().flat_map(|types| integers(bytes, layout.ascii, types));
    for cells in &layout.cells {
        visit(bytes, layout.ascii, cells, |cell, at, corners| {
            let kind = match cells.kind {
                CellKind::Polygons => POLYGON,
                CellKind::Strips => TRIANGLE_STRIP,
                CellKind::Typed => types.next().unwrap_or(Ok(0))?,
            };
            match (kind, corners) {
                (kind, _) if !is_face(kind) => Ok(()),
                (TRIANGLE_STRIP, _) => triangles.strip(cell, at, corners),
                (PIXEL, &[a, b, c, d]) => triangles.polygon(cell, at, &[a, b, d, c]),
                (TRIANGLE | POLYGON | QUAD, _) => triangles.polygon(cell, at, corners),
                _ => Err(ReadFault::Unsupported(format!(
                    "cell {cell} has type {kind}; a mesh must have cells of types {TRIANGLE} to \
                     {QUAD}"
                ))),
            }
        })?;
    }
    Ok(vertices(view, &layout, &[], Unpacking::in_memory())?.into_mesh(bytes, triangles.triangles))
}

/// The points with their attributes, and with the values of `cell_data`, which has one tuple per
/// point.
fn vertices(
    bytes: ByteView,
    layout: &VtkLayout,
    cell_data: &[VtkArray],
    unpacking: Unpacking,
) -> Result<FileVertices, ReadFault> {
    let mut decoded = UnpackBuffer::new(unpacking);
    let mut place = |array: &VtkArray| -> Result<Vec<Column>, ReadFault> {
        let VtkArray { at, components, scalar, .. } = *array;
        if !layout.ascii {
            return Ok(columns(at, components * scalar.size(), components, scalar, Endian::Big));
        }
        let offset = decoded.len() as usize;
        decode_numbers(bytes.kept()?, array.at..array.end, &mut decoded)?;
        Ok(columns(
            offset,
            components * Scalar::F64.size(),
            components,
            Scalar::F64,
            Endian::Little,
        ))
    };
    if !layout.ascii {
        refuse_little_endian(bytes, &layout.points)?;
    }
    let position = place(&layout.points)?;
    let attribute = |array: &VtkArray| {
        let info = AttributeInfo::new(&array.name, array.components);
        Ok((info, place(array)?))
    };
    let attributes = layout.attributes.iter().chain(cell_data).map(attribute);
    let attributes = attributes.collect::<Result<Vec<_>, ReadFault>>()?;
    Ok(FileVertices {
        decoded: layout.ascii.then(|| decoded.finish()).transpose()?,
        count: layout.points.tuples,
        position: [position[0], position[1], position[2]],
        attributes,
        normals: layout.normals,
    })
}

/// Returns an error if the first positions are plausible in little-endian order only.
fn refuse_little_endian(bytes: ByteView, points: &VtkArray) -> Result<(), ReadFault> {
    /// Maximum number of bytes that are sampled.
    const SAMPLED: usize = 1 << 16;
    /// Minimum number of coordinates from which the order is certain.
    const FEWEST: usize = 9;
    let sample = bytes.read(points.at..points.end.min(points.at + SAMPLED))?;
    let (big, little): (Vec<f64>, Vec<f64>) = match points.scalar {
        Scalar::F32 => {
            let numbers = sample.as_chunks().0.iter().filter(|bytes| **bytes != [0; 4]);
            let both = |&b: &[u8; 4]| [f32::from_be_bytes(b), f32::from_le_bytes(b)].map(f64::from);
            numbers.map(both).map(<(f64, f64)>::from).unzip()
        }
        Scalar::F64 => {
            let numbers = sample.as_chunks().0.iter().filter(|bytes| **bytes != [0; 8]);
            numbers.map(|&b| (f64::from_be_bytes(b), f64::from_le_bytes(b))).unzip()
        }
        _ => return Ok(()),
    };
    // Some positions of a valid file are implausible: a few particles may have flown far away, or a
    // coordinate may differ from 0 only by a rounding error.
    let far = |numbers: &[f64]| numbers.iter().filter(|number| !is_length(**number)).count();
    if big.len() >= FEWEST && far(&big) > big.len() / 4 && far(&little) < big.len() / 8 {
        let what = "the positions look little-endian, but a binary legacy .vtk must be big-endian; \
                    reverse the bytes of each number when you write the file";
        return Err(ReadFault::Unsupported(what.to_owned()));
    }
    Ok(())
}

/// The number in an array of one number.
fn number(bytes: ByteView, ascii: bool, array: &VtkArray) -> Result<Option<f64>, ReadFault> {
    let stored = bytes.read(array.at..array.end)?;
    if ascii {
        return Ok(f64::of(stored.trim_ascii()));
    }
    Ok(match array.scalar {
        Scalar::F64 => stored.first_chunk().map(|&bytes| f64::from_be_bytes(bytes)),
        Scalar::F32 => stored.first_chunk().map(|&bytes| f32::from_be_bytes(bytes).into()),
        scalar => integer(scalar, Endian::Big, &stored).map(|integer| integer as f64),
    })
}

/// Calls `each` for each of `cells`, with its number, the position of its array, and its corners.
fn visit(
    bytes: &[u8],
    ascii: bool,
    cells: &VtkCells,
    mut each: impl FnMut(usize, usize, &[i64]) -> Result<(), ReadFault>,
) -> Result<(), ReadFault> {
    let (stream, mut ends, count) = match &cells.corners {
        CellCorners::Counted { cells, stream } => (stream, None, *cells),
        CellCorners::Offsets { offsets, connectivity } => {
            let mut ends = integers(bytes, ascii, offsets);
            if ends.next().transpose()?.is_some_and(|first| first != 0) {
                return Err(malformed(offsets.at, "the first offset in OFFSETS is not 0"));
            }
            (connectivity, Some(ends), cells.corners.cells())
        }
    };
    let mut values = integers(bytes, ascii, stream);
    let mut next = |cell| {
        let short = || {
            Err(malformed(
                stream.at,
                format!("cell {cell} of {count} ends beyond the end of {}", stream.name),
            ))
        };
        values.next().unwrap_or_else(short)
    };
    let mut corners = Vec::new();
    let mut start = 0;
    for cell in 0..count {
        let length = match &mut ends {
            None => Some(next(cell)?),
            Some(ends) => {
                let end = ends.next().unwrap_or(Ok(start))?;
                end.checked_sub(std::mem::replace(&mut start, end))
            }
        };
        let length = length.filter(|length| *length >= 0);
        let length = length.ok_or_else(|| {
            malformed(stream.at, format!("cell {cell} has a negative number of corners"))
        })?;
        corners.clear();
        for _ in 0..length {
            corners.push(next(cell)?);
        }
        each(cell, stream.at, &corners)?;
    }
    Ok(())
}

/// The only section of cells, if its cells may be vertices.
fn vertex_section(layout: &VtkLayout) -> Option<&CellCorners> {
    match (&layout.vertices, &*layout.cells, layout.has_others) {
        (Some(vertices), [], false) => Some(vertices),
        (None, [VtkCells { kind: CellKind::Typed, corners }], false) => Some(corners),
        _ => None,
    }
}

/// Whether cell i is a vertex at point i, there is one cell per point, and all cell data has one
/// tuple per cell.
fn cells_are_points(bytes: ByteView, layout: &VtkLayout) -> Result<bool, ReadFault> {
    let points = layout.points.tuples;
    let is_of_points = |array: &VtkArray| array.tuples == points && array.components > 0;
    let corners = vertex_section(layout).filter(|corners| corners.cells() == points);
    let Some(corners) = corners.filter(|_| points > 0 && layout.cell_data.iter().all(is_of_points))
    else {
        return Ok(false);
    };
    let mut in_order = true;
    let mut expect = |array: &VtkArray, number: &dyn Fn(usize) -> usize| {
        let take = |index, found| in_order &= found == number(index) as i64;
        each_integer(bytes, layout.ascii, array, take)
    };
    let count = match corners {
        CellCorners::Counted { stream, .. } => {
            expect(stream, &|index| if index % 2 == 0 { 1 } else { index / 2 })?;
            stream.tuples / 2
        }
        CellCorners::Offsets { offsets, connectivity } => {
            expect(offsets, &|index| index)?;
            expect(connectivity, &|index| index)?;
            connectivity.tuples
        }
    };
    if let Some(types) = &layout.cell_types {
        expect(types, &|_| VERTEX as usize)?;
    }
    Ok(in_order && count == points)
}

/// Ranges of the points that are not ghosts. `None` if all points are kept.
pub(super) fn non_ghost_points(
    bytes: ByteView,
    layout: &VtkLayout,
) -> Result<Option<Vec<Range<usize>>>, ReadFault> {
    let corners = vertex_section(layout).filter(|_| !layout.flags.is_empty());
    let Some(corners) = corners else { return Ok(None) };
    let each = |array: &VtkArray, take: &mut dyn FnMut(usize, i64)| {
        each_integer(bytes, layout.ascii, array, take)
    };
    let (cells, mut all_vertices) = (corners.cells(), true);
    let points = match corners {
        // Each cell has two numbers: its number of points, which must be 1, and the index of its
        // point. Therefore, the numbers at even indices are numbers of points.
        CellCorners::Counted { stream, .. } => {
            each(stream, &mut |index, number| all_vertices &= index % 2 == 1 || number == 1)?;
            if all_vertices && Some(stream.tuples) != cells.checked_mul(2) {
                let what = format!(
                    "{cells} vertex cells need two numbers each, but the file has {}",
                    stream.tuples
                );
                return Err(malformed(stream.at, what));
            }
            stream
        }
        CellCorners::Offsets { offsets, connectivity } => {
            each(offsets, &mut |index, end| all_vertices &= end == index as i64)?;
            connectivity
        }
    };
    if let Some(types) = &layout.cell_types {
        each(types, &mut |_, kind| all_vertices &= kind == VERTEX)?;
    }
    if !all_vertices {
        return Ok(None);
    }
    let mut vertices = VertexCells::new(cells);
    for array in &layout.flags {
        let mut flags = vertices.flags(&array.name);
        each(array, &mut |cell, flag| flags.take(cell, flag))?;
        flags.end().map_err(|what| malformed(array.at, what))?;
    }
    let mut vertex_points = VertexPoints::new(&vertices, layout.points.tuples);
    each(points, &mut |index, point| match corners {
        CellCorners::Counted { .. } if index % 2 == 0 => {}
        CellCorners::Counted { .. } => vertex_points.take(index / 2, point),
        CellCorners::Offsets { .. } => vertex_points.take(index, point),
    })?;
    vertex_points.kept_ranges().map(Some).map_err(|what| malformed(points.at, what))
}
