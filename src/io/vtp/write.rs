//! Writing .vtp files.

use std::io::{self, Write};

use crate::io::CoordinateWidth;
use crate::io::encode::write_chunks;
use crate::io::vertices::assert_complete;
use crate::mesh::Mesh;

use super::NORMALS;

/// Writes `mesh` with all of its attributes, little-endian: points as Float32 or Float64 by `width`, indices
/// as Int32 as long as they fit.
///
/// A control character in a name, for which XML has no room, is written as U+FFFD.
///
/// # Errors
/// Those of `out`.
///
/// # Panics
/// If normals or an attribute are not of the vertices' number.
pub fn write_mesh(out: &mut dyn Write, mesh: &Mesh, width: CoordinateWidth) -> io::Result<()> {
    assert_complete(mesh);
    let mut offset = 0;
    let mut element = |array: &Array| {
        let xml = array.element(offset);
        offset += size_of::<u64>() as u64 + array.bytes();
        xml
    };
    let (point_data, points, polygons) = (point_data(mesh), points(mesh, width), polygons(mesh));
    let is_velocity = |array: &&Array| array.name == "velocity" && array.components == 3;
    let vectors = point_data.iter().find(is_velocity).map_or("", |_| " Vectors=\"velocity\"");
    let normals = mesh.normals.as_ref().map_or(String::new(), |_| format!(" Normals=\"{NORMALS}\""));
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
        mesh.positions.len(),
        mesh.triangles.len(),
        point_data.iter().map(&mut element).collect::<String>(),
        element(&points),
        polygons.iter().map(&mut element).collect::<String>(),
    )?;
    for array in point_data.iter().chain([&points]).chain(&polygons) {
        out.write_all(&array.bytes().to_le_bytes())?;
        array.write(out)?;
    }
    out.write_all(b"\n</AppendedData>\n</VTKFile>\n")
}

/// An array of the file.
struct Array<'a> {
    name: &'a str,
    components: usize,
    /// Of all components together.
    length: usize,
    numbers: Numbers<'a>,
}

enum Numbers<'a> {
    Floats(&'a [f32]),
    Positions(&'a [[f64; 3]], CoordinateWidth),
    Corners(&'a [[u32; 3]], IndexWidth),
    /// Where each triangle's corners end: 3, 6, 9, ...
    Ends(IndexWidth),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum IndexWidth {
    I32,
    I64,
}

fn point_data(mesh: &Mesh) -> Vec<Array<'_>> {
    let normals = mesh.normals.iter().map(|normals| (NORMALS, 3, normals.as_flattened()));
    let attributes = mesh.attributes.iter().map(|a| (&*a.name, a.components, &a.values[..]));
    let arrays = normals.chain(attributes);
    arrays
        .map(|(name, components, values)| {
            let numbers = Numbers::Floats(values);
            Array { name, components, length: values.len(), numbers }
        })
        .collect()
}

fn points(mesh: &Mesh, width: CoordinateWidth) -> Array<'_> {
    let numbers = Numbers::Positions(&mesh.positions, width);
    Array { name: "Points", components: 3, length: 3 * mesh.positions.len(), numbers }
}

fn polygons(mesh: &Mesh) -> [Array<'_>; 2] {
    let width = IndexWidth::that_holds(mesh.positions.len().max(3 * mesh.triangles.len()));
    let triangles = &mesh.triangles[..];
    [
        Array {
            name: "connectivity",
            components: 1,
            length: 3 * triangles.len(),
            numbers: Numbers::Corners(triangles, width),
        },
        Array { name: "offsets", components: 1, length: triangles.len(), numbers: Numbers::Ends(width) },
    ]
}

impl Array<'_> {
    /// The type, and its width in bytes.
    fn scalar(&self) -> (&'static str, u64) {
        match self.numbers {
            Numbers::Floats(_) | Numbers::Positions(_, CoordinateWidth::F32) => ("Float32", 4),
            Numbers::Positions(_, CoordinateWidth::F64) => ("Float64", 8),
            Numbers::Corners(_, IndexWidth::I32) | Numbers::Ends(IndexWidth::I32) => ("Int32", 4),
            Numbers::Corners(_, IndexWidth::I64) | Numbers::Ends(IndexWidth::I64) => ("Int64", 8),
        }
    }

    fn bytes(&self) -> u64 {
        self.length as u64 * self.scalar().1
    }

    fn element(&self, offset: u64) -> String {
        format!(
            "<DataArray type=\"{}\" Name=\"{}\" NumberOfComponents=\"{}\" format=\"appended\" offset=\"{offset}\"/>\n",
            self.scalar().0,
            escaped(self.name),
            self.components,
        )
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        match self.numbers {
            Numbers::Floats(values) => write_chunks(out, values.len(), |range, out| {
                values[range].iter().for_each(|value| out.extend(value.to_le_bytes()));
            }),
            Numbers::Positions(positions, width) => write_chunks(out, positions.len(), |range, out| {
                for position in positions[range].iter() {
                    match width {
                        CoordinateWidth::F32 => {
                            out.extend(position.map(|x| (x as f32).to_le_bytes()).as_flattened());
                        }
                        CoordinateWidth::F64 => out.extend(position.map(f64::to_le_bytes).as_flattened()),
                    }
                }
            }),
            Numbers::Corners(triangles, width) => write_chunks(out, triangles.len(), |range, out| {
                triangles[range].as_flattened().iter().for_each(|&corner| width.put(out, corner.into()));
            }),
            Numbers::Ends(width) => write_chunks(out, self.length, |range, out| {
                range.for_each(|triangle| width.put(out, 3 * (triangle as u64 + 1)));
            }),
        }
    }
}

impl IndexWidth {
    fn that_holds(greatest: usize) -> Self {
        if i32::try_from(greatest).is_ok() { Self::I32 } else { Self::I64 }
    }

    fn put(self, out: &mut Vec<u8>, index: u64) {
        match self {
            Self::I32 => out.extend((index as u32).to_le_bytes()),
            Self::I64 => out.extend(index.to_le_bytes()),
        }
    }
}

/// As it stands between quotes in XML.
fn escaped(name: &str) -> String {
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
            width.put(&mut out, greatest as u64);
            assert_eq!(out, (greatest as u64).to_le_bytes()[..bytes]);
        }
    }
}
