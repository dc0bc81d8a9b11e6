//! Writing .vtp files.

use std::io::{self, Write};

use crate::io::CoordinateWidth;
use crate::io::encode::{put_position, write_floats, write_pieces, write_triangles, write_vertices};
use crate::particles::AttributeInfo;
use crate::surface::mesh::source::MeshSource;

use super::NORMALS;

/// Triangles whose ends are written at once.
const ENDS: u64 = 1 << 14;

/// Writes `mesh` with all of its attributes, little-endian: points as Float32 or Float64 by `width`, indices
/// as Int32 as long as they fit.
///
/// A control character in a name, for which XML has no room, is written as U+FFFD.
///
/// # Errors
/// Those of `mesh` and `out`.
///
/// # Panics
/// As [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(out: &mut dyn Write, mesh: &dyn MeshSource, width: CoordinateWidth) -> io::Result<()> {
    let mut offset = 0;
    let mut element = |array: &Array| {
        let xml = array.element(offset);
        offset += size_of::<u64>() as u64 + array.bytes();
        xml
    };
    let (point_data, points, polygons) = (point_data(mesh), points(mesh, width), polygons(mesh));
    let has_velocity = mesh.attributes().iter().any(AttributeInfo::is_velocity);
    let vectors = if has_velocity { " Vectors=\"velocity\"" } else { "" };
    let normals = if mesh.has_normals() { format!(" Normals=\"{NORMALS}\"") } else { String::new() };
    write!(
        out,
        "<?xml version=\"1.0\"?>\n\
         <VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
         <PolyData>\n\
         <Piece NumberOfPoints=\"{}\" NumberOfVerts=\"0\" NumberOfLines=\"0\" NumberOfStrips=\"0\" \
         NumberOfPolys=\"{}\">\n\
         <PointData{normals}{vectors}>\n{}</PointData>\n\
         <Points>\n{}</Points>\n\
         <Polys>\n{}</Polys>\n\
         </Piece>\n\
         </PolyData>\n\
         <AppendedData encoding=\"raw\">\n_",
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

/// An array of the file.
struct Array {
    name: String,
    components: usize,
    /// Number of values, of all components together.
    length: u64,
    numbers: Numbers,
}

enum Numbers {
    Normals,
    /// By its number.
    Attribute(usize),
    Positions(CoordinateWidth),
    Corners(IndexWidth),
    /// Where each triangle's corners end: 3, 6, 9, ...
    Ends(IndexWidth),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum IndexWidth {
    I32,
    I64,
}

fn point_data(mesh: &dyn MeshSource) -> Vec<Array> {
    let array = |name: String, components: usize, numbers: Numbers| {
        let length = mesh.vertex_count() * components as u64;
        Array { name, components, length, numbers }
    };
    let normals = mesh.has_normals().then(|| array(NORMALS.to_owned(), 3, Numbers::Normals));
    let attributes = mesh.attributes().into_iter().enumerate();
    let attributes = attributes.map(|(index, a)| array(a.name, a.components, Numbers::Attribute(index)));
    normals.into_iter().chain(attributes).collect()
}

fn points(mesh: &dyn MeshSource, width: CoordinateWidth) -> Array {
    let numbers = Numbers::Positions(width);
    Array { name: "Points".to_owned(), components: 3, length: 3 * mesh.vertex_count(), numbers }
}

fn polygons(mesh: &dyn MeshSource) -> [Array; 2] {
    let triangles = mesh.triangle_count();
    let width = IndexWidth::that_holds(mesh.vertex_count().max(3 * triangles));
    let array = |name: &str, length, numbers| Array { name: name.to_owned(), components: 1, length, numbers };
    [
        array("connectivity", 3 * triangles, Numbers::Corners(width)),
        array("offsets", triangles, Numbers::Ends(width)),
    ]
}

impl Array {
    /// The type, and its width in bytes.
    fn scalar(&self) -> (&'static str, u64) {
        match self.numbers {
            Numbers::Normals | Numbers::Attribute(_) | Numbers::Positions(CoordinateWidth::F32) => {
                ("Float32", 4)
            }
            Numbers::Positions(CoordinateWidth::F64) => ("Float64", 8),
            Numbers::Corners(IndexWidth::I32) | Numbers::Ends(IndexWidth::I32) => ("Int32", 4),
            Numbers::Corners(IndexWidth::I64) | Numbers::Ends(IndexWidth::I64) => ("Int64", 8),
        }
    }

    fn bytes(&self) -> u64 {
        self.length * self.scalar().1
    }

    fn element(&self, offset: u64) -> String {
        format!(
            "<DataArray type=\"{}\" Name=\"{}\" NumberOfComponents=\"{}\" format=\"appended\" offset=\"{offset}\"/>\n",
            self.scalar().0,
            escaped(&self.name),
            self.components,
        )
    }

    fn write(&self, out: &mut dyn Write, mesh: &dyn MeshSource) -> io::Result<()> {
        match self.numbers {
            Numbers::Normals => write_floats(out, mesh, |vertices| vertices.normals.as_flattened()),
            Numbers::Attribute(index) => write_floats(out, mesh, |vertices| &vertices.attributes[index]),
            Numbers::Positions(width) => write_vertices(out, mesh, |vertices, out| {
                vertices.positions.iter().for_each(|&position| put_position(out, position, width));
            }),
            Numbers::Corners(width) => write_triangles(out, mesh, |triangles, out| {
                triangles.as_flattened().iter().for_each(|&corner| width.put(out, corner));
            }),
            Numbers::Ends(width) => write_pieces(out, self.length.div_ceil(ENDS) as usize, |piece, out| {
                let first = piece as u64 * ENDS;
                let ends = first + 1..=(first + ENDS).min(self.length);
                ends.for_each(|triangles| width.put(out, 3 * triangles));
                Ok(())
            }),
        }
    }
}

impl IndexWidth {
    fn that_holds(greatest: u64) -> Self {
        if i32::try_from(greatest).is_ok() { Self::I32 } else { Self::I64 }
    }

    fn put(self, out: &mut Vec<u8>, index: u64) {
        match self {
            Self::I32 => out.extend((index as u32).to_le_bytes()),
            Self::I64 => out.extend(index.to_le_bytes()),
        }
    }
}

/// Escapes a name so that it can stand between quotes in XML.
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

#[cfg(test)]
mod tests {
    use super::IndexWidth;

    #[test]
    fn indices_are_as_wide_as_the_greatest_one_needs() {
        for (greatest, width, bytes) in [(0x7fff_ffff, IndexWidth::I32, 4), (0x8000_0000, IndexWidth::I64, 8)]
        {
            assert_eq!(IndexWidth::that_holds(greatest), width);
            let mut out = Vec::new();
            width.put(&mut out, greatest);
            assert_eq!(out, u64::to_le_bytes(greatest)[..bytes]);
        }
    }
}
