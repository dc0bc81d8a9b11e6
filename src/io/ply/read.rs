//! Reads .ply files. Rows of `vertex` are read in place, and lists of `face` become triangles.

use std::ops::{ControlFlow, Range};

use crate::io::bytes::{ByteView, Bytes, PrivateBytes, Slice, UnpackBuffer, Unpacking};
use crate::io::cell_types::CellCounts;
use crate::io::columns::{Column, Endian, Scalar};
use crate::io::error::ADD_Z;
use crate::io::scan::{Lines, Scanner};
use crate::io::text::decode_pieces;
use crate::io::vertices::{FileVertices, Triangles, columns, integer};
use crate::io::{ParticleFile, ReadFault, malformed};
use crate::particles::{AttributeInfo, AttributeKind};
use crate::surface::mesh::Mesh;

use super::header::{Element, Encoding, PlyHeader, PlyProperty};
use super::{GROUPS, NORMAL};
use crate::io::names::{COLOUR, COLOURS};

/// Minimum number of bytes that are collected before they are appended to the decoded rows.
const PIECE: usize = 1 << 16;

/// Number of bytes of the faces that are searched for a face with an area before the whole file is
/// read. In a mesh, the first face usually has an area.
const HEAD: usize = 1 << 16;

/// Reads a file of particles with [`read_points`]. Faces with one or two corners are vertices and
/// lines, which some programs write for particles.
///
/// # Errors
/// [`ReadFault::Mesh`] if a face has an area, and the errors of [`read_points`].
pub fn read_particles(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let header = PlyHeader::parse(bytes.view())?;
    let is_face_element =
        |element: &&Element| ["face", "tristrips"].contains(&element.name.as_str());
    let counts = header.elements.iter().filter(is_face_element).map(|element| element.count as u64);
    let announced = counts.fold(0, u64::saturating_add);
    if announced == 0 {
        return points(bytes, &header, unpacking);
    }
    let mesh = ReadFault::Mesh { faces: announced };
    // Without a list of corners, it is unknown whether a face has an area. The file then counts as
    // a mesh.
    let Ok(Some(corners)) = faces(&header) else { return Err(mesh) };
    if begins_with_area(bytes.view(), &header, corners)? {
        return Err(mesh);
    }
    let whole = bytes.read_whole(unpacking)?;
    let at = start(whole.view(), &header, corners.0)?;
    let cells = cells(&whole, header.encoding, corners, at)?;
    let file = points(Bytes::Kept(whole), &header, unpacking)?;
    Ok(ParticleFile { only_lines: cells.are_lines(), ..file })
}

/// Reads the rows of `vertex` as particles, whether or not there are faces. Binary rows are read in
/// place. Text is decoded to columns of f64.
///
/// The properties x, y and z may be anywhere, in any order. vx, vy and vz (or `velocity_x`,
/// `vel_x`, ...) form the attribute `velocity`. nx, ny and nz form `normal`. red, green, blue and
/// optionally alpha form `color`. Consecutive properties `a_0`, `a_1`, ... form one attribute `a`.
/// Every other property becomes an attribute with its own name. [`ColumnStore::new`] adds the
/// velocity if its components have other names, such as `velx`. Lists are skipped, and elements
/// after `vertex` are not read.
///
/// [`ColumnStore::new`]: crate::io::columns::ColumnStore::new
///
/// # Errors
/// [`ReadFault::Line`] for an invalid header or row of text, [`ReadFault::Truncated`] for fewer
/// rows than the header announces, [`ReadFault::Malformed`] for vertices without x, y and z, and
/// [`ReadFault::Scratch`] if decoded rows do not fit in memory and the scratch file cannot be
/// written.
pub fn read_points(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let header = PlyHeader::parse(bytes.view())?;
    points(bytes, &header, unpacking)
}

fn points(
    bytes: Bytes,
    header: &PlyHeader,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadFault> {
    let format = match header.encoding {
        Encoding::Ascii => "PLY, ASCII",
        Encoding::Binary(Endian::Little) => "PLY, binary little-endian",
        Encoding::Binary(Endian::Big) => "PLY, binary big-endian",
    };
    let is_text = header.encoding == Encoding::Ascii;
    // If rows have lists, the end of the rows is unknown until the lists are read.
    let vertex = header.elements.iter().position(|element| element.name == "vertex");
    let mut upto = header.elements.iter().take(vertex.map_or(0, |vertex| vertex + 1));
    let whole = is_text || upto.any(|element| element.row().is_none());
    let bytes = if whole { Bytes::Kept(bytes.read_whole(unpacking)?) } else { bytes };
    Ok(vertices(bytes.view(), header, unpacking)?.into_particles(bytes, format))
}

/// Whether the file is a mesh: a face has an area. Reads the whole file only if its first faces are
/// vertices or lines, or if it is text. A file whose faces cannot be read, for example because
/// another program is still writing them, counts as a mesh.
///
/// # Errors
/// The errors of [`read_mesh`] about the header.
pub fn has_faces(bytes: ByteView) -> Result<bool, ReadFault> {
    let header = PlyHeader::parse(bytes)?;
    let Some(corners) = faces(&header)? else { return Ok(false) };
    if begins_with_area(bytes, &header, corners)? {
        return Ok(true);
    }
    let whole = bytes.read(0..bytes.len())?;
    let Ok(at) = start(ByteView::from(&*whole), &header, corners.0) else { return Ok(true) };
    Ok(cells(&whole, header.encoding, corners, at).is_err())
}

/// Whether a face with an area is found without reading the whole file. This is possible if all
/// rows before the faces have a fixed size.
fn begins_with_area(
    bytes: ByteView,
    header: &PlyHeader,
    corners: (&Element, usize),
) -> Result<bool, ReadFault> {
    let mut before = header.elements.iter().take_while(|other| !std::ptr::eq(*other, corners.0));
    if header.encoding == Encoding::Ascii || before.any(|element| element.row().is_none()) {
        return Ok(false);
    }
    let at = start(bytes, header, corners.0)?;
    let head = bytes.read(at..bytes.len().min(at.saturating_add(HEAD)))?;
    // The last row of the head may be incomplete, so other errors are ignored.
    Ok(matches!(cells(&head, header.encoding, corners, 0), Err(ReadFault::Mesh { .. })))
}

/// Counts the vertices and lines among the faces, whose rows start at byte `at`. `corners` is the
/// result of [`faces`].
///
/// # Errors
/// [`ReadFault::Mesh`] at the first face with an area, and errors for invalid rows before it.
fn cells(
    bytes: &[u8],
    encoding: Encoding,
    (element, list): (&Element, usize),
    at: usize,
) -> Result<CellCounts, ReadFault> {
    let mut cells = CellCounts::default();
    for_each_row(bytes, encoding, element, at, Some(list), |_, _, corners| {
        match corners.len() {
            0 => {}
            1 => cells.vertices += 1,
            2 => cells.lines += 1,
            _ => return Err(ReadFault::Mesh { faces: element.count as u64 }),
        }
        Ok(())
    })?;
    Ok(cells)
}

/// Reads vertices and faces. Each polygon becomes a fan of triangles around its first corner.
///
/// # Errors
/// The errors of [`read_points`], [`ReadFault::Malformed`] for a face that refers to a missing
/// vertex, and [`ReadFault::Unsupported`] for triangle strips.
pub fn read_mesh(bytes: &[u8]) -> Result<Mesh, ReadFault> {
    let view = ByteView::from(bytes);
    let header = PlyHeader::parse(view)?;
    let vertices = vertices(view, &header, Unpacking::in_memory())?;
    let mut triangles = Triangles::new(vertices.count)?;
    if let Some((element, list)) = faces(&header)? {
        let at = start(view, &header, element)?;
        for_each_row(bytes, header.encoding, element, at, Some(list), |face, at, corners| {
            triangles.polygon(face, at, corners)
        })?;
    }
    Ok(vertices.into_mesh(bytes, triangles.triangles))
}

pub(super) fn vertices(
    bytes: ByteView,
    header: &PlyHeader,
    unpacking: Unpacking,
) -> Result<FileVertices, ReadFault> {
    let element = header.elements.iter().find(|element| element.name == "vertex");
    let element =
        element.ok_or_else(|| malformed(header.body, "the header has no element `vertex`"))?;
    let plain = element.without_lists();
    let axis = |name| {
        let index = plain.property(name);
        let advice = if name == "z" { format!("; {ADD_Z}") } else { String::new() };
        let what = || format!("vertices have no property `{name}`{advice}");
        index.ok_or_else(|| malformed(header.body, what()))
    };
    let position = [axis("x")?, axis("y")?, axis("z")?];
    let at = start(bytes, header, element)?;
    let (decoded, columns) = match header.encoding {
        Encoding::Ascii => {
            (Some(decode(bytes.kept()?, at, element, unpacking)?), text_columns(&plain))
        }
        Encoding::Binary(endian) if element.row().is_none() => {
            let rows = plain_rows(bytes.kept()?.bytes(), header.encoding, element, at, unpacking)?;
            (Some(rows), binary_columns(&plain, 0, endian))
        }
        Encoding::Binary(endian) => {
            skip(bytes, header.encoding, element, at)?;
            (None, binary_columns(&plain, at, endian))
        }
    };
    let attributes: Vec<_> = group(&plain.properties, position)
        .into_iter()
        .map(|(name, members)| {
            let info = AttributeInfo::new(name, members.len());
            let alike = |&index: &usize| plain.properties[index].scalar.kind_of(&info);
            let kinds = members.iter().map(alike);
            let kind = kinds.reduce(AttributeKind::together).unwrap_or_default();
            let members: Vec<_> = members.into_iter().map(|index| columns[index]).collect();
            (AttributeInfo { kind, ..info }, members)
        })
        .collect();
    let normals =
        attributes.iter().position(|(info, _)| info.name == NORMAL && info.components == 3);
    let position = position.map(|index| columns[index]);
    Ok(FileVertices { decoded, count: element.count, position, attributes, normals })
}

/// Groups the properties except `position` into attributes. Returns the name of each attribute with
/// the indices of its properties.
fn group(properties: &[PlyProperty], position: [usize; 3]) -> Vec<(String, Vec<usize>)> {
    let named = |name: &str| properties.iter().position(|p| p.name.eq_ignore_ascii_case(name));
    let whole = |members: [&str; 3]| members.into_iter().map(named).collect::<Option<Vec<_>>>();
    let groups = GROUPS.iter().filter_map(|(name, members)| Some((*name, whole(*members)?)));
    let colours = COLOURS.iter().filter_map(|members| {
        let [channels @ .., alpha] = members;
        let mut found = whole(*channels)?;
        let scalar = properties[found[0]].scalar;
        let alike = |&index: &usize| properties[index].scalar == scalar;
        let fits = (scalar.is_float() || scalar == Scalar::U8) && found.iter().all(alike);
        found.extend(named(alpha).filter(alike));
        fits.then_some((COLOUR, found))
    });
    let groups: Vec<(&str, Vec<usize>)> = groups.chain(colours).collect();
    let mut taken = vec![false; properties.len()];
    position.iter().for_each(|&index| taken[index] = true);
    let mut attributes = Vec::new();
    for index in 0..properties.len() {
        if taken[index] {
            continue;
        }
        let free = |members: &[usize]| members.iter().all(|&member| !taken[member]);
        let group = groups.iter().find(|(_, members)| members.contains(&index) && free(members));
        let (name, members) = match group {
            Some((name, members)) => ((*name).to_owned(), members.clone()),
            None => numbered_run(properties, &taken, index),
        };
        members.iter().for_each(|&member| taken[member] = true);
        attributes.push((name, members));
    }
    attributes
}

/// The attribute that starts with property `first`: `a` with the properties `a_0`, `a_1`, ..., or a
/// single property with its own name.
fn numbered_run(properties: &[PlyProperty], taken: &[bool], first: usize) -> (String, Vec<usize>) {
    let name = &properties[first].name;
    let Some(base) = name.strip_suffix("_0") else {
        return (name.clone(), vec![first]);
    };
    let follows = |&index: &usize| {
        let number =
            properties[index].name.strip_prefix(base).and_then(|rest| rest.strip_prefix('_'));
        !taken[index] && number.and_then(|number| number.parse().ok()) == Some(index - first)
    };
    match (first + 1..properties.len()).take_while(follows).count() {
        0 => (name.clone(), vec![first]),
        more => (base.to_owned(), (first..=first + more).collect()),
    }
}

fn binary_columns(element: &Element, at: usize, endian: Endian) -> Vec<Column> {
    let stride = element.row().unwrap_or(0);
    let sizes = element.properties.iter().map(|p| p.scalar);
    let offsets = sizes.scan(at, |offset, scalar| {
        *offset += scalar.size();
        Some((*offset - scalar.size(), scalar))
    });
    offsets.map(|(offset, scalar)| Column { offset, stride, scalar, endian }).collect()
}

fn text_columns(element: &Element) -> Vec<Column> {
    let components = element.properties.len();
    columns(0, 8 * components, components, Scalar::F64, Endian::Little)
}

/// Copies binary rows without their lists, so that all rows have the same size.
fn plain_rows(
    bytes: &[u8],
    encoding: Encoding,
    element: &Element,
    at: usize,
    unpacking: Unpacking,
) -> Result<PrivateBytes, ReadFault> {
    let mut scan = Scanner::new(bytes, at);
    let mut rows = UnpackBuffer::new(unpacking);
    let mut piece = Vec::with_capacity(2 * PIECE);
    for _ in 0..element.count {
        for property in &element.properties {
            let start = scan.at();
            let length = list_length(&mut scan, encoding, element, property)?;
            skip_values(&mut scan, encoding, property.scalar, length)?;
            if property.list.is_none() {
                piece.extend_from_slice(&bytes[start..scan.at()]);
            }
        }
        if piece.len() >= PIECE {
            rows.push(&piece)?;
            piece.clear();
        }
    }
    rows.push(&piece)?;
    rows.finish()
}

/// Decodes rows of text to little-endian f64, without their lists.
fn decode(
    source: Slice,
    at: usize,
    element: &Element,
    unpacking: Unpacking,
) -> Result<PrivateBytes, ReadFault> {
    let scan = Scanner::new(source.bytes(), at);
    let words = element.count.saturating_mul(element.properties.len());
    scan.expect_numbers(words, "the text of `vertex`")?;
    let width = element.properties.iter().filter(|property| property.list.is_none()).count();
    let all = Scalar::F64.size() * width * element.count;
    let mut decoded = UnpackBuffer::new(unpacking);
    let decode = |piece| decode_rows(source, piece, element);
    decode_pieces(
        source,
        at..source.len(),
        |byte| matches!(byte, b'\n' | b'\r'),
        decode,
        |(rows, outcome)| {
            let missing = all - decoded.len() as usize;
            decoded.push(&rows[..rows.len().min(missing)])?;
            // Lines after the last row are ignored, even if they are invalid.
            if rows.len() >= missing {
                Ok(ControlFlow::Break(()))
            } else {
                outcome.map(ControlFlow::Continue)
            }
        },
    )?;
    if (decoded.len() as usize) < all {
        return Err(scan.fault(source.len(), "expected a number, found the end of the file".into()));
    }
    decoded.finish()
}

/// Decodes the rows of complete lines. Returns the rows above the first invalid row, and the error
/// of the invalid row.
fn decode_rows(
    source: Slice,
    lines: Range<usize>,
    element: &Element,
) -> (Vec<u8>, Result<(), ReadFault>) {
    let mut scan = Scanner::new(source.bytes(), lines.start);
    let mut rows = Vec::new();
    loop {
        scan.skip_whitespace();
        if scan.at() >= lines.end {
            return (rows, Ok(()));
        }
        let whole = rows.len();
        if let Err(fault) = decode_row(&mut scan, element, &mut rows) {
            rows.truncate(whole);
            return (rows, Err(fault));
        }
    }
}

fn decode_row(scan: &mut Scanner, element: &Element, rows: &mut Vec<u8>) -> Result<(), ReadFault> {
    for property in &element.properties {
        if property.list.is_some() {
            let length = list_length(scan, Encoding::Ascii, element, property)?;
            skip_values(scan, Encoding::Ascii, property.scalar, length)?;
        } else {
            scan.skip_blanks();
            rows.extend_from_slice(&scan.number::<f64>()?.to_le_bytes());
        }
    }
    end_row(scan)
}

fn end_row(scan: &mut Scanner) -> Result<(), ReadFault> {
    scan.skip_blanks();
    match scan.rest() {
        [] | [b'\n', ..] | [b'\r', ..] => Ok(()),
        _ => Err(scan.fault(scan.at(), "the row has more values than properties".into())),
    }
}

/// The element with the faces, and the index of the property that lists their corners. `None` if
/// there are no faces.
pub(super) fn faces(header: &PlyHeader) -> Result<Option<(&Element, usize)>, ReadFault> {
    let filled =
        |name| header.elements.iter().find(|element| element.name == name && element.count > 0);
    if filled("tristrips").is_some() {
        return Err(ReadFault::Unsupported(
            "triangle strips are not supported; save the mesh with faces".into(),
        ));
    }
    let Some(element) = filled("face") else {
        return Ok(None);
    };
    let is_corners = |p: &PlyProperty| {
        ["vertex_indices", "vertex_index"].contains(&p.name.as_str())
            && p.list.is_some()
            && !matches!(p.scalar, Scalar::F32 | Scalar::F64)
    };
    let list = element.properties.iter().position(is_corners);
    let list = list.ok_or_else(|| {
        malformed(
            header.body,
            "the faces have no list of integers named `vertex_indices` or `vertex_index`",
        )
    })?;
    Ok(Some((element, list)))
}

/// The start of the rows of `element`, which follow the rows of all elements before it.
pub(super) fn start(
    bytes: ByteView,
    header: &PlyHeader,
    element: &Element,
) -> Result<usize, ReadFault> {
    let mut before = header.elements.iter().take_while(|other| !std::ptr::eq(*other, element));
    before.try_fold(header.body, |at, other| skip(bytes, header.encoding, other, at))
}

/// Byte offset of the end of the rows of `element`, which start at byte `at`.
fn skip(
    bytes: ByteView,
    encoding: Encoding,
    element: &Element,
    at: usize,
) -> Result<usize, ReadFault> {
    let what = || format!("{} rows of `{}`", element.count, element.name);
    match (encoding, element.row()) {
        _ if element.properties.is_empty() => Ok(at),
        (Encoding::Ascii, _) => {
            let mut scan = Scanner::releasing(bytes.kept()?, at);
            scan.expect_numbers(element.count, &what())?;
            for row in 0..element.count {
                scan.skip_whitespace();
                if !scan.skip_line() {
                    let what = format!(
                        "the file ends where row {row} of `{}` should follow",
                        element.name
                    );
                    return Err(scan.fault(scan.at(), what));
                }
            }
            Ok(scan.at())
        }
        (Encoding::Binary(_), Some(row)) => {
            let mut rows = Lines::new(bytes, at);
            rows.skip(element.count.saturating_mul(row), &what())?;
            Ok(rows.at())
        }
        (Encoding::Binary(_), None) => {
            for_each_row(bytes.kept()?.bytes(), encoding, element, at, None, |_, _, _| Ok(()))
        }
    }
}

/// Calls `visit` for each row of `element`, whose first row starts at byte `at`. Passes the row's
/// number, its byte offset, and the list in property number `list`. Returns the byte offset of the
/// end of the rows.
fn for_each_row(
    bytes: &[u8],
    encoding: Encoding,
    element: &Element,
    at: usize,
    list: Option<usize>,
    mut visit: impl FnMut(usize, usize, &[i64]) -> Result<(), ReadFault>,
) -> Result<usize, ReadFault> {
    let mut scan = Scanner::new(bytes, at);
    let mut values = Vec::new();
    for row in 0..element.count {
        if encoding == Encoding::Ascii {
            scan.skip_whitespace();
        }
        let start = scan.at();
        for (index, property) in element.properties.iter().enumerate() {
            let length = list_length(&mut scan, encoding, element, property)?;
            if list == Some(index) {
                values.clear();
                for _ in 0..length {
                    values.push(next_integer(&mut scan, encoding, property.scalar)?);
                }
            } else {
                skip_values(&mut scan, encoding, property.scalar, length)?;
            }
        }
        if encoding == Encoding::Ascii {
            end_row(&mut scan)?;
        }
        visit(row, start, &values)?;
    }
    Ok(scan.at())
}

/// The number of values of `property` in a row: the length of its list, or one.
fn list_length(
    scan: &mut Scanner,
    encoding: Encoding,
    element: &Element,
    property: &PlyProperty,
) -> Result<usize, ReadFault> {
    let Some(scalar) = property.list else { return Ok(1) };
    let at = scan.at();
    let length = next_integer(scan, encoding, scalar)?;
    usize::try_from(length).map_err(|_| {
        let (name, list) = (&element.name, &property.name);
        malformed(at, format!("a list `{list}` of element `{name}` has the length {length}"))
    })
}

fn next_integer(scan: &mut Scanner, encoding: Encoding, scalar: Scalar) -> Result<i64, ReadFault> {
    match encoding {
        Encoding::Ascii => {
            scan.skip_blanks();
            scan.number()
        }
        Encoding::Binary(endian) => {
            let (at, bytes) = (scan.at(), scan.rest());
            scan.skip(scalar.size(), "a list")?;
            integer(scalar, endian, bytes).ok_or_else(|| malformed(at, "expected an integer"))
        }
    }
}

fn skip_values(
    scan: &mut Scanner,
    encoding: Encoding,
    scalar: Scalar,
    count: usize,
) -> Result<(), ReadFault> {
    match encoding {
        Encoding::Ascii => (0..count).try_for_each(|_| {
            scan.skip_blanks();
            scan.number::<f64>().map(|_| ())
        }),
        Encoding::Binary(_) => scan.skip(count.saturating_mul(scalar.size()), "a row"),
    }
}
