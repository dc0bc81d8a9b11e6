//! Writes .vtp files.

use std::io::{self, Write};

use crate::io::CoordinateWidth;
use crate::io::columns::Scalar;
use crate::io::up::delimited_up_comment;
use crate::surface::mesh::source::MeshSource;

use super::arrays::{Array, identifiers, point_data, points, polygons};

/// Name of the array with the indices that a piece's vertices have in the whole mesh.
pub(super) const GLOBAL_IDS: &str = "GlobalPointIds";

/// The start and the end of a comment.
pub(super) const COMMENT: [&str; 2] = ["<!-- ", " -->\n"];

/// Writes `mesh` with all of its attributes, little-endian. Points are Float32 or Float64 according
/// to `width`. Indices are Int32 if they fit, and otherwise Int64.
///
/// Control characters in a name become U+FFFD, because XML cannot represent them.
///
/// # Panics
/// Like [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
) -> io::Result<()> {
    write_piece(out, mesh, width, None)
}

/// Writes a mesh or a piece of a mesh. For a piece, `numbers` contains the indices that its
/// vertices have in the whole mesh.
pub(super) fn write_piece(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
    numbers: Option<&[u64]>,
) -> io::Result<()> {
    let mut offset = 0;
    let mut element = |array: &Array| {
        let xml =
            declared("DataArray", array, &format!(" format=\"appended\" offset=\"{offset}\""));
        offset += size_of::<u64>() as u64 + array.bytes();
        xml
    };
    let (mut point_data, points, polygons) =
        (point_data(mesh, str::to_owned), points(mesh, width), polygons(mesh));
    point_data.extend(numbers.map(|numbers| identifiers(GLOBAL_IDS, numbers)));
    let roles = roles(&point_data);
    write!(
        out,
        "<?xml version=\"1.0\"?>\n{}\
         <VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
         <PolyData>\n\
         <Piece NumberOfPoints=\"{}\" NumberOfVerts=\"0\" NumberOfLines=\"0\" NumberOfStrips=\"0\" \
         NumberOfPolys=\"{}\">\n\
         <PointData{roles}>\n{}</PointData>\n\
         <Points>\n{}</Points>\n\
         <Polys>\n{}</Polys>\n\
         </Piece>\n\
         </PolyData>\n\
         <AppendedData encoding=\"raw\">\n_",
        delimited_up_comment(mesh, COMMENT),
        mesh.vertex_count(),
        mesh.triangle_count(),
        point_data.iter().map(&mut element).collect::<String>(),
        element(&points),
        polygons.iter().map(&mut element).collect::<String>(),
    )?;
    for array in point_data.iter().chain([&points]).chain(&polygons) {
        out.write_all(&array.bytes().to_le_bytes())?;
        array.write(out, mesh)?;
    }
    out.write_all(b"\n</AppendedData>\n</VTKFile>\n")
}

/// The XML attributes that say which arrays are normals, vectors and global identifiers.
pub(super) fn roles(arrays: &[Array]) -> String {
    let role = |array: &Array| Some(format!(" {}=\"{}\"", array.role?, array.name));
    arrays.iter().filter_map(role).collect()
}

/// The XML element that declares an array. `more` contains additional XML attributes.
pub(super) fn declared(element: &str, array: &Array, more: &str) -> String {
    let kind = match array.scalar() {
        Scalar::F64 => "Float64",
        Scalar::I32 => "Int32",
        Scalar::I64 => "Int64",
        Scalar::U8 => "UInt8",
        Scalar::U32 => "UInt32",
        _ => "Float32",
    };
    let (name, components) = (escaped(&array.name), array.components);
    format!(
        "<{element} type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\"{more}/>\n"
    )
}

/// Escapes a name for use in a quoted XML attribute.
pub(in crate::io) fn escaped(name: &str) -> String {
    let mut escaped = String::new();
    for character in name.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\t' | '\n' | '\r' => escaped.push_str(&format!("&#{};", u32::from(character))),
            _ if character.is_control() || matches!(character, '\u{fffe}' | '\u{ffff}') => {
                escaped.push('\u{fffd}')
            }
            _ => escaped.push(character),
        }
    }
    escaped
}
