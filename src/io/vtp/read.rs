//! Reads .vtp and .vtu files. Points and attributes become columns, and polygons become triangles.

use std::borrow::Cow;
use std::collections::HashSet;
use std::ops::Range;

use memchr::memmem;

use crate::io::bytes::{ByteView, Bytes, Unpacking, unpacked_limit};
use crate::io::cell_types::{CellCounts, VERTEX, is_face};
use crate::io::columns::{Column, Scalar};
use crate::io::ghosts::{VertexCells, VertexPoints, append, is_flag};
use crate::io::vertices::{FileVertices, Triangles};
use crate::io::wanted::GHOSTS;
use crate::io::{ParticleFile, ReadFault, UnreadPart, malformed};
use crate::particles::AttributeInfo;
use crate::surface::mesh::Mesh;

use super::NORMALS;
use super::data::{Decoder, JoinedArray, PieceArray};
use super::layout::{DataSet, HEAD, Section, VtpArray, VtpLayout, VtpPiece};

/// Reads the points of all pieces as particles. Lines are ignored.
///
/// Raw appended arrays of a single piece are read in place. If there are several pieces, or any
/// array is text, base64 or compressed, all arrays are decoded.
///
/// Every numeric array in `PointData` that all pieces have becomes an attribute. Arrays in
/// `CellData` that all pieces have also become attributes if cell i is a vertex at point i, and if
/// there is one cell per point. An array in `FieldData` with one of the names
/// [`TIMES`](crate::io::names::TIMES) gives the time. In a piece that has only vertex cells, a
/// point is left out if `CellData` flags all of its cells as copies or hidden.
///
/// # Errors
/// [`ReadFault::Mesh`] if a cell has an area or a volume, [`ReadFault::Truncated`] and
/// [`ReadFault::Malformed`] for damaged files, [`ReadFault::Compression`] for data that cannot be
/// decompressed or whose compression ratio is too high, [`ReadFault::Unsupported`] for compressors
/// other than zlib, LZ4 and LZMA and for data sets other than PolyData and UnstructuredGrid, and
/// [`ReadFault::Scratch`] if the scratch file cannot be written.
pub fn read_particles(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    points(whole_file_if_encoded(bytes, unpacking)?, unpacking, |layout| {
        match cell_counts(layout)? {
            cells @ CellCounts { faces: 0, .. } => Ok(cells),
            CellCounts { faces, .. } => Err(ReadFault::Mesh { faces }),
        }
    })
}

/// Returns `bytes` unchanged if all arrays of the points are raw. Otherwise, reads the whole file,
/// because some arrays are text, encoded or compressed.
fn whole_file_if_encoded(bytes: Bytes, unpacking: Unpacking) -> Result<Bytes, ReadFault> {
    let view = bytes.view();
    let can_be_read_in_place = !is_text(view)? && Decoder::all_raw(&VtpLayout::parse(view)?);
    Ok(if can_be_read_in_place { bytes } else { Bytes::Kept(bytes.read_whole(unpacking)?) })
}

/// Counts the cells of all pieces.
fn cell_counts(layout: &VtpLayout) -> Result<CellCounts, ReadFault> {
    let mut decoder = Decoder::new(layout, Unpacking::in_memory());
    let announced = layout.pieces.iter().map(|piece| CellCounts {
        faces: piece.faces() as u64,
        lines: piece.lines as u64,
        vertices: piece.vertices as u64,
    });
    let mut cells = announced.fold(CellCounts::default(), CellCounts::plus);
    for types in cell_types(layout) {
        decoder.each_integer(types, |_, kind| cells.add(kind))?;
    }
    Ok(cells)
}

/// The types of the cells of an UnstructuredGrid. Pieces without cells need no such array.
fn cell_types<'a>(layout: &'a VtpLayout<'_>) -> impl Iterator<Item = &'a VtpArray> {
    let pieces = layout.pieces.iter().filter(|piece| piece.cells > 0);
    pieces.filter_map(|piece| piece.array(Section::Cells, "types"))
}

/// Whether the file must be read as a whole, because arrays are text, encoded or compressed.
///
/// # Errors
/// [`ReadFault::Changed`] and [`ReadFault::Io`] if the file cannot be read.
pub fn is_text(bytes: ByteView) -> Result<bool, ReadFault> {
    let head = head(bytes)?;
    Ok(!is_raw(&head) || memmem::find(&head, b"compressor=").is_some())
}

/// The start of a file, which contains all XML before raw data.
fn head(bytes: ByteView<'_>) -> Result<Cow<'_, [u8]>, ReadFault> {
    bytes.read(0..bytes.len().min(HEAD))
}

/// Whether a file that starts with `head` has data that is neither text nor base64.
fn is_raw(head: &[u8]) -> bool {
    memmem::find(head, b"encoding=\"raw\"").is_some()
}

/// Returns `bytes` unchanged if each array can be decoded on its own, even if it is compressed.
/// Otherwise, reads the whole file, because its arrays are text or base64.
pub(in crate::io) fn whole_file_if_inline(bytes: Bytes) -> Result<Bytes, ReadFault> {
    if is_raw(&head(bytes.view())?) {
        Ok(bytes)
    } else {
        bytes.read_whole(Unpacking::for_inspection()).map(Bytes::Kept)
    }
}

/// Reads the points if `check`, which counts the cells, returns no error.
fn points(
    bytes: Bytes,
    unpacking: Unpacking,
    check: impl Fn(&VtpLayout) -> Result<CellCounts, ReadFault>,
) -> Result<ParticleFile, ReadFault> {
    let layout = VtpLayout::parse(bytes.view())?;
    let only_lines = check(&layout)?.are_lines();
    let format = match layout.data_set {
        DataSet::PolyData => "VTK XML .vtp",
        DataSet::UnstructuredGrid => "VTK XML .vtu",
    };
    let mut decoder = Decoder::new(&layout, unpacking);
    let time = layout.time.as_ref().map(|array| decoder.single(array)).transpose()?.flatten();
    let time = time.filter(|time| time.is_finite());
    let non_ghosts = non_ghost_points(&layout, &mut decoder)?;
    let mut cell_data = layout.pieces.iter().flat_map(|piece| &piece.arrays).filter(is_cell_data);
    let cells_are_points = cell_data.next().is_some() && cells_are_points(&layout, &mut decoder)?;
    let names = attributes(&layout.pieces, cells_are_points);
    let texts = layout.pieces.first().map_or_else(Vec::new, |piece| piece.texts.clone());
    let vertices = vertices(&layout, decoder, &names.shared)?;
    let file = vertices.into_particles(bytes, format);
    let file = ParticleFile { time, left_out: names.left_out, texts, only_lines, ..file };
    Ok(file.with_points(non_ghosts))
}

/// Whether the file is a mesh. It is a mesh if a cell has an area or a volume, or if it contains an
/// empty mesh.
///
/// # Errors
/// The errors of [`read_particles`], except [`ReadFault::Mesh`].
pub fn has_faces(bytes: ByteView) -> Result<bool, ReadFault> {
    Ok(contents(bytes)? != PieceContents::Particles)
}

/// The contents of a file, as far as they distinguish a mesh from particles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PieceContents {
    /// A cell with an area or a volume.
    Faces,
    /// No points, and arrays for polygons but not for vertex cells. meniscus writes an empty mesh
    /// like this.
    EmptyMesh,
    /// Everything else. VTK declares the arrays of all kinds of cells, even for particles.
    Particles,
}

/// Reads the cell types up to the first cell with an area or a volume.
pub(super) fn contents(bytes: ByteView) -> Result<PieceContents, ReadFault> {
    let layout = VtpLayout::parse(bytes)?;
    if layout.faces() > 0 {
        return Ok(PieceContents::Faces);
    }
    let mut decoder = Decoder::new(&layout, Unpacking::in_memory());
    for types in cell_types(&layout) {
        if decoder.any_integer(types, is_face)? {
            return Ok(PieceContents::Faces);
        }
    }
    let declares = |section| {
        let mut arrays = layout.pieces.iter().flat_map(|piece| &piece.arrays);
        arrays.any(|array| array.section == section)
    };
    let is_empty_mesh =
        layout.points() == 0 && declares(Section::Polys) && !declares(Section::Verts);
    Ok(if is_empty_mesh { PieceContents::EmptyMesh } else { PieceContents::Particles })
}

/// Reads points, their attributes, and polygons. Each polygon becomes a fan of triangles around its
/// first corner.
///
/// Vertex cells, lines and cell data are ignored.
///
/// # Errors
/// The errors of [`read_particles`], and [`ReadFault::Unsupported`] for triangle strips and for an
/// UnstructuredGrid.
pub fn read_mesh(bytes: &[u8]) -> Result<Mesh, ReadFault> {
    Ok(read_numbered(bytes)?.mesh)
}

/// A mesh, and the global identifiers of its vertices.
pub(super) struct NumberedMesh {
    pub mesh: Mesh,
    pub numbers: Option<Vec<i64>>,
}

/// Reads a mesh that may be a piece of a larger mesh.
pub(super) fn read_numbered(bytes: &[u8]) -> Result<NumberedMesh, ReadFault> {
    let layout = VtpLayout::parse(bytes.into())?;
    if layout.data_set != DataSet::PolyData {
        return Err(ReadFault::Unsupported(
            "the file contains an UnstructuredGrid, but meshes must be PolyData".to_owned(),
        ));
    }
    let [piece] = &*layout.pieces else {
        let what = format!("the mesh has {} pieces; save it as one", layout.pieces.len());
        return Err(ReadFault::Unsupported(what));
    };
    if piece.strips > 0 {
        return Err(ReadFault::Unsupported(
            "triangle strips are not supported; save them as triangles".to_owned(),
        ));
    }
    let mut decoder = Decoder::new(&layout, Unpacking::in_memory());
    let mut integers = |name: &str| {
        piece.array(Section::Polys, name).map_or(Ok(Vec::new()), |array| decoder.integers(array))
    };
    let corners = integers("connectivity")?;
    let ends = integers("offsets")?;
    if ends.len() != piece.polygons {
        let what =
            format!("{} polygons are announced, but {} have offsets", piece.polygons, ends.len());
        return Err(malformed(0, what));
    }
    let ids = piece.global_ids.as_ref().and_then(|ids| piece.array(Section::PointData, ids));
    let numbers = ids.map(|ids| decoder.integers(ids)).transpose()?;
    if numbers.as_ref().is_some_and(|numbers| numbers.len() != piece.points) {
        return Err(malformed(
            0,
            format!("each of the {} points must have one global identifier", piece.points),
        ));
    }
    let mut triangles = Triangles::new(piece.points)?;
    let mut start = 0;
    for (face, &end) in ends.iter().enumerate() {
        let polygon = usize::try_from(end).ok().and_then(|end| corners.get(start..end));
        let polygon = polygon.ok_or_else(|| {
            malformed(
                0,
                format!("the range of corners {start} to {end} of polygon {face} is invalid"),
            )
        })?;
        triangles.polygon(face, 0, polygon)?;
        start += polygon.len();
    }
    let is_id = |array: &VtpArray| ids.is_some_and(|ids| std::ptr::eq(ids, array));
    let own: Vec<&VtpArray> = piece
        .arrays
        .iter()
        .filter(|array| array.section == Section::PointData && !is_id(array))
        .collect();
    let vertices = vertices(&layout, decoder, &own)?;
    Ok(NumberedMesh { mesh: vertices.into_mesh(bytes, triangles.triangles), numbers })
}

/// The attributes of the points of all pieces.
struct Attributes<'a> {
    /// Arrays that all pieces have. Each is represented by the array of one piece.
    shared: Vec<&'a VtpArray>,
    left_out: Vec<UnreadPart>,
}

/// Whether an array has values for cells, and does not flag them as ghosts.
fn is_cell_data(array: &&VtpArray) -> bool {
    let flags = is_flag(&array.name, array.components, array.scalar);
    array.section == Section::CellData && array.components > 0 && !flags
}

/// Finds the attributes that all pieces with points have, in the order of the first piece. Pieces
/// may lack an array that flags ghosts. If `cells_are_points`, arrays of cell data are also
/// attributes.
fn attributes(pieces: &[VtpPiece], cells_are_points: bool) -> Attributes<'_> {
    let filled: Vec<&VtpPiece> = pieces.iter().filter(|piece| piece.points > 0).collect();
    let mut all = Attributes { shared: Vec::new(), left_out: Vec::new() };
    let mut seen = HashSet::new();
    for (number, piece) in filled.iter().enumerate() {
        let of_points = piece.arrays.iter().filter(|array| array.section == Section::PointData);
        let mut of_cells: Vec<&VtpArray> = piece.arrays.iter().filter(is_cell_data).collect();
        if !cells_are_points {
            let parts = of_cells.drain(..).map(|array| UnreadPart::CellData(array.name.clone()));
            for part in parts {
                if !all.left_out.contains(&part) {
                    all.left_out.push(part);
                }
            }
        }
        for array in of_points.chain(of_cells) {
            let info = AttributeInfo::new(&array.name, array.components);
            if number == 0 && filled.len() == 1 {
                all.shared.push(array);
            } else if seen.insert(info.clone()) {
                let is_shared = GHOSTS.contains(&&*array.name)
                    || filled.iter().all(|piece| matching_array(piece, array).is_some());
                if is_shared {
                    all.shared.push(array);
                } else {
                    all.left_out.push(UnreadPart::Attribute(info));
                }
            }
        }
    }
    all
}

/// The array of `piece` with the same section, name and number of components as `array`.
fn matching_array<'a>(piece: &'a VtpPiece, array: &VtpArray) -> Option<&'a VtpArray> {
    piece.arrays.iter().find(|own| {
        (own.section, &own.name, own.components) == (array.section, &array.name, array.components)
    })
}

/// The points of all pieces, with the values of `attributes`.
fn vertices(
    layout: &VtpLayout,
    mut decoder: Decoder,
    attributes: &[&VtpArray],
) -> Result<FileVertices, ReadFault> {
    let filled: Vec<&VtpPiece> = layout.pieces.iter().filter(|piece| piece.points > 0).collect();
    let [first, ..] = &*filled else {
        let nowhere = Column { offset: 0, stride: 0, scalar: Scalar::F32, endian: layout.endian };
        return Ok(FileVertices {
            decoded: None,
            count: 0,
            position: [nowhere; 3],
            attributes: Vec::new(),
            normals: None,
        });
    };
    let is_points = |array: &&VtpArray| array.section == Section::Points && array.components == 3;
    let mut parts = Vec::new();
    for piece in &filled {
        let array = piece.arrays.iter().find(is_points);
        let array = array.ok_or_else(|| malformed(0, "no array of points has three components"))?;
        parts.push(PieceArray { points: piece.points, array: Some(array) });
    }
    // Positions are decoded first, because their size confirms the number of points.
    let mut arrays = vec![JoinedArray { components: 3, parts }];
    arrays.extend(attributes.iter().map(|&array| {
        let mut parts = Vec::new();
        for piece in &filled {
            // A single piece may have several arrays with the same name, so its arrays are not
            // searched by name.
            let own = if filled.len() == 1 { Some(array) } else { matching_array(piece, array) };
            parts.push(PieceArray { points: piece.points, array: own });
        }
        JoinedArray { components: array.components, parts }
    }));
    let mut columns = decoder.columns(&arrays)?.into_iter();
    let position = columns.next().and_then(|columns| <[Column; 3]>::try_from(columns).ok());
    let position = position.expect("three components");
    let info = |array: &&VtpArray| AttributeInfo::new(&array.name, array.components);
    let normals = first.normals.as_deref().unwrap_or(NORMALS);
    Ok(FileVertices {
        decoded: decoder.finish()?,
        count: layout.points(),
        position,
        attributes: attributes.iter().map(info).zip(columns).collect(),
        normals: attributes.iter().position(|a| a.components == 3 && a.name == normals),
    })
}

/// Section and number of the cells that may be vertices. In PolyData, vertices are the first cells,
/// so their data comes first.
fn vertex_cells(data_set: DataSet, piece: &VtpPiece) -> (Section, usize) {
    match data_set {
        DataSet::PolyData => (Section::Verts, piece.vertices),
        DataSet::UnstructuredGrid => (Section::Cells, piece.cells),
    }
}

/// Whether, in each piece with points, cell i is a vertex at point i, and there is one cell per
/// point.
fn cells_are_points(layout: &VtpLayout, decoder: &mut Decoder) -> Result<bool, ReadFault> {
    for piece in layout.pieces.iter().filter(|piece| piece.points > 0) {
        let (section, cells) = vertex_cells(layout.data_set, piece);
        let arrays = ["connectivity", "offsets"].map(|name| piece.array(section, name));
        let ([Some(corners), Some(ends)], 0) = (arrays, piece.lines) else { return Ok(false) };
        if cells != piece.points {
            return Ok(false);
        }
        let (mut in_order, mut numbers) = (true, 0);
        for (array, first) in [(corners, 0), (ends, 1)] {
            decoder.each_integer(array, |index, number| {
                in_order &= number == (index + first) as i64;
                numbers += 1;
            })?;
        }
        if let Some(types) = piece.array(section, "types") {
            decoder.each_integer(types, |_, kind| in_order &= kind == VERTEX)?;
        }
        if !in_order || numbers != 2 * cells {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Ranges of the points that are not ghosts. `None` if all points are kept.
fn non_ghost_points(
    layout: &VtpLayout,
    decoder: &mut Decoder,
) -> Result<Option<Vec<Range<usize>>>, ReadFault> {
    // A number of points that is too large for a file of this size is rejected later, when the
    // points are read.
    if layout.points() as u64 > unpacked_limit(layout.bytes.len() as u64) {
        return Ok(None);
    }
    let (mut ranges, mut keeps_all, mut first) = (Vec::new(), true, 0);
    for piece in &layout.pieces {
        let points = first..first + piece.points;
        match piece_non_ghost_points(layout.data_set, piece, decoder)? {
            Some(own) => {
                keeps_all = false;
                own.into_iter().for_each(|own| {
                    append(&mut ranges, first + own.start..first + own.end);
                });
            }
            None => append(&mut ranges, points.clone()),
        }
        first = points.end;
    }
    Ok((!keeps_all).then_some(ranges))
}

/// Ranges of the points of one piece that are not ghosts. `None` if all points are kept.
fn piece_non_ghost_points(
    data_set: DataSet,
    piece: &VtpPiece,
    decoder: &mut Decoder,
) -> Result<Option<Vec<Range<usize>>>, ReadFault> {
    let (section, cells) = vertex_cells(data_set, piece);
    let flags = GHOSTS.iter().filter_map(|name| piece.array(Section::CellData, name));
    let flags: Vec<&VtpArray> =
        flags.filter(|array| is_flag(&array.name, array.components, array.scalar)).collect();
    let corners = ["connectivity", "offsets"].map(|name| piece.array(section, name));
    let ([Some(corners), Some(ends)], false) = (corners, flags.is_empty() || piece.lines > 0)
    else {
        return Ok(None);
    };
    let (mut all_vertices, mut count) = (true, 0);
    decoder.each_integer(ends, |cell, end| {
        all_vertices &= end == cell as i64 + 1;
        count = cell + 1;
    })?;
    if count != cells {
        return Err(malformed(
            ends.place(),
            format!("{cells} cells are announced, but {count} have offsets"),
        ));
    }
    if let (DataSet::UnstructuredGrid, Some(types)) = (data_set, piece.array(section, "types")) {
        decoder.each_integer(types, |_, kind| all_vertices &= kind == VERTEX)?;
    }
    if !all_vertices {
        return Ok(None);
    }
    let mut vertices = VertexCells::new(cells);
    for array in flags {
        let mut flags = vertices.flags(&array.name);
        decoder.each_integer(array, |cell, flag| flags.take(cell, flag))?;
        flags.end().map_err(|what| malformed(array.place(), what))?;
    }
    let mut points = VertexPoints::new(&vertices, piece.points);
    decoder.each_integer(corners, |cell, point| points.take(cell, point))?;
    points.kept_ranges().map(Some).map_err(|what| malformed(corners.place(), what))
}
