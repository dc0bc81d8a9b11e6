//! Writes `.bgeo.sc`: triangles as one run of polygons, compressed in chunks by Blosc.
//!
//! In Houdini, polygons are clockwise as seen from outside, so corners are written in reverse
//! order.

use std::collections::HashSet;
use std::io::{self, Write};

use crate::io::CoordinateWidth;
use crate::io::encode::{put_position, write_floats, write_triangles, write_vertices};
use crate::io::up::up_comment;
use crate::particles::{AttributeInfo, AttributeKind, colour_attribute};
use crate::surface::mesh::source::MeshSource;

use super::container::ContainerWriter;

/// Number of points per page, as in Houdini's files.
const PAGE: u64 = 1024;

/// An array with the positions, the normals or an attribute of the points.
struct PointArray {
    name: String,
    components: usize,
    storage: Type,
    /// Houdini's name for the kind of values, such as `vector` or `color`. Empty for plain numbers.
    meaning: &'static str,
    numbers: ValueSource,
}

/// The source of an array's values.
#[derive(Clone, Copy)]
enum ValueSource {
    Positions(CoordinateWidth),
    Normals,
    Attribute(usize),
    /// A range of components of the colour attribute with this index. The values are converted to
    /// numbers from 0 to 1.
    ColourFractions(usize, [usize; 2]),
}

/// A number type.
#[derive(Clone, Copy)]
enum Type {
    F32,
    F64,
    I32,
    I64,
}

impl Type {
    /// The name of the type, and the byte that stands for it in binary JSON.
    fn name_and_code(self) -> (&'static str, u8) {
        match self {
            Self::F32 => ("fpreal32", 0x19),
            Self::F64 => ("fpreal64", 0x1a),
            Self::I32 => ("int32", 0x13),
            Self::I64 => ("int64", 0x14),
        }
    }
}

/// Writes `mesh` with all of its attributes. The velocity is named `v`, the normals `N`, and the
/// first colour `Cd`, with its alpha in `Alpha`. All colours range from 0 to 1.
///
/// # Panics
/// Like [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
) -> io::Result<()> {
    let mut packing = ContainerWriter::new(out)?;
    write_document(&mut packing, mesh, width)?;
    packing.finish()
}

fn write_document(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
) -> io::Result<()> {
    let (points, triangles) = (mesh.vertex_count(), mesh.triangle_count());
    let mut head = Tokens(b"\x7fNSJb[".to_vec());
    head.text("fileversion").text("18.5.408").text("hasindex").truth(false);
    head.text("pointcount").whole(points);
    head.text("vertexcount").whole(3 * triangles);
    head.text("primitivecount").whole(triangles);
    head.text("info").byte(b'{').text("software");
    head.text(concat!("meniscus ", env!("CARGO_PKG_VERSION")));
    if let Some(note) = up_comment(mesh) {
        head.text("comment").text(note);
    }
    head.byte(b'}');
    let corner = if i32::try_from(points).is_ok() { Type::I32 } else { Type::I64 };
    head.text("topology").byte(b'[').text("pointref").byte(b'[').text("indices");
    head.array(corner, 3 * triangles);
    out.write_all(&head.0)?;
    write_triangles(out, mesh, |triangles, out| {
        for &[a, b, c] in triangles {
            for index in [a, c, b] {
                match corner {
                    Type::I32 => out.extend((index as u32).to_le_bytes()),
                    _ => out.extend(index.to_le_bytes()),
                }
            }
        }
    })?;
    let mut between = Tokens(b"]]".to_vec());
    between.text("attributes").byte(b'[').text("pointattributes").byte(b'[');
    out.write_all(&between.0)?;
    for array in arrays(mesh, width) {
        array.write(out, mesh)?;
    }
    let mut tail = Tokens(b"]]".to_vec());
    tail.text("primitives").byte(b'[');
    if triangles > 0 {
        tail.byte(b'[').byte(b'[').text("type").text("p_r").byte(b']');
        tail.byte(b'[').text("s_v").whole(0).text("n_p").whole(triangles);
        tail.text("r_v").byte(b'[').whole(3).whole(triangles).byte(b']').byte(b']').byte(b']');
    }
    tail.byte(b']').byte(b']');
    out.write_all(&tail.0)
}

/// The name of each attribute in the file, except that a velocity and the first colour keep their
/// original names here. The file stores them as `v` and `Cd`.
pub fn attribute_names(attributes: &[AttributeInfo], has_normals: bool) -> Vec<String> {
    let mut taken: HashSet<String> = HashSet::from(["P".to_owned()]);
    taken.extend(has_normals.then(|| "N".to_owned()));
    let colour = colour_attribute(attributes);
    for (index, info) in attributes.iter().enumerate() {
        if info.is_velocity() {
            taken.insert("v".to_owned());
        }
        if colour == Some(index) {
            taken.extend(["Cd", "Alpha"].map(str::to_owned));
        }
    }
    let names = attributes.iter().enumerate().map(|(index, info)| {
        if info.is_velocity() || colour == Some(index) {
            return info.name.clone();
        }
        let mut name = identifier(&info.name);
        while !taken.insert(name.clone()) {
            name.push('_');
        }
        name
    });
    names.collect()
}

/// Converts a name to a valid Houdini name: letters, digits and underscores, and no digit at the
/// start.
fn identifier(name: &str) -> String {
    let plain = name.replace(|c: char| !c.is_ascii_alphanumeric() && c != '_', "_");
    let is_valid_start = plain.starts_with(|c: char| !c.is_ascii_digit());
    if is_valid_start { plain } else { format!("_{plain}") }
}

fn arrays(mesh: &dyn MeshSource, width: CoordinateWidth) -> Vec<PointArray> {
    let attributes = mesh.attributes();
    let storage = match width {
        CoordinateWidth::F32 => Type::F32,
        CoordinateWidth::F64 => Type::F64,
    };
    let array = |name: &str, components, meaning, numbers| PointArray {
        name: name.to_owned(),
        components,
        storage: Type::F32,
        meaning,
        numbers,
    };
    let mut all =
        vec![PointArray { storage, ..array("P", 3, "point", ValueSource::Positions(width)) }];
    all.extend(mesh.has_normals().then(|| array("N", 3, "normal", ValueSource::Normals)));
    let names = attribute_names(&attributes, mesh.has_normals());
    let colour = colour_attribute(&attributes);
    for (index, (info, name)) in attributes.iter().zip(&names).enumerate() {
        if colour == Some(index) {
            all.push(array("Cd", 3, "color", ValueSource::ColourFractions(index, [0, 3])));
            if info.components == 4 {
                all.push(array("Alpha", 1, "", ValueSource::ColourFractions(index, [3, 4])));
            }
            continue;
        }
        let name = if info.is_velocity() { "v" } else { &**name };
        // Houdini rotates vectors together with the geometry.
        let meaning = if info.is_direction() { "vector" } else { "" };
        let storage = match info.kind {
            AttributeKind::Signed | AttributeKind::Wide => Type::I32,
            // Houdini has no unsigned 32-bit type, so the next wider type is used.
            AttributeKind::Unsigned => Type::I64,
            _ => Type::F32,
        };
        let numbers = match info.kind.is_colour() {
            true => ValueSource::ColourFractions(index, [0, info.components]),
            false => ValueSource::Attribute(index),
        };
        all.push(PointArray { storage, ..array(name, info.components, meaning, numbers) });
    }
    all
}

impl PointArray {
    fn write(&self, out: &mut dyn Write, mesh: &dyn MeshSource) -> io::Result<()> {
        let (storage, _) = self.storage.name_and_code();
        let size = self.components as u64;
        let mut head = Tokens(b"[[".to_vec());
        head.text("scope").text("public").text("type").text("numeric");
        head.text("name").text(&self.name).text("options").byte(b'{');
        if !self.meaning.is_empty() {
            head.text("type").byte(b'{').text("type").text("string");
            head.text("value").text(self.meaning).byte(b'}');
        }
        head.byte(b'}').byte(b']').byte(b'[');
        head.text("size").whole(size).text("storage").text(storage);
        head.text("defaults").byte(b'[').text("size").whole(1);
        head.text("storage").text("fpreal64").text("values");
        head.array(Type::F64, 1).0.extend(0.0_f64.to_le_bytes());
        head.byte(b']').text("values").byte(b'[');
        head.text("size").whole(size).text("storage").text(storage);
        head.text("pagesize").whole(PAGE).text("rawpagedata");
        head.array(self.storage, size * mesh.vertex_count());
        out.write_all(&head.0)?;
        match self.numbers {
            ValueSource::Positions(width) => write_vertices(out, mesh, |vertices, out| {
                vertices.positions.iter().for_each(|&position| put_position(out, position, width));
            })?,
            ValueSource::Normals => {
                write_floats(out, mesh, |vertices| vertices.normals.as_flattened())?;
            }
            ValueSource::Attribute(index) => {
                let kind = mesh.attributes()[index].kind;
                match self.storage {
                    Type::I64 => write_vertices(out, mesh, |vertices, out| {
                        let words = vertices.attributes[index].iter();
                        words.for_each(|&word| out.extend(kind.whole(word).to_le_bytes()));
                    })?,
                    // The mesh stores an integer as an f32 with the same 32 bits, so `write_floats`
                    // writes 32-bit integers unchanged.
                    _ => write_floats(out, mesh, |vertices| &vertices.attributes[index])?,
                }
            }
            ValueSource::ColourFractions(index, [first, end]) => {
                let info = &mesh.attributes()[index];
                write_vertices(out, mesh, |vertices, out| {
                    for colour in vertices.attributes[index].chunks(info.components) {
                        let shares = colour[first..end].iter().map(|&value| info.kind.share(value));
                        shares.for_each(|share| out.extend(share.to_le_bytes()));
                    }
                })?;
            }
        }
        out.write_all(b"]]]")
    }
}

/// A writer of binary JSON.
struct Tokens(Vec<u8>);

impl Tokens {
    fn byte(&mut self, byte: u8) -> &mut Self {
        self.0.push(byte);
        self
    }

    fn truth(&mut self, truth: bool) -> &mut Self {
        self.byte(if truth { 0x31 } else { 0x30 })
    }

    fn length(&mut self, length: u64) -> &mut Self {
        match length {
            ..=0xf0 => self.0.push(length as u8),
            0xf1..=0xffff => {
                self.0.push(0xf2);
                self.0.extend((length as u16).to_le_bytes());
            }
            0x1_0000..=0xffff_ffff => {
                self.0.push(0xf4);
                self.0.extend((length as u32).to_le_bytes());
            }
            _ => {
                self.0.push(0xf8);
                self.0.extend(length.to_le_bytes());
            }
        }
        self
    }

    fn text(&mut self, text: &str) -> &mut Self {
        self.byte(0x27).length(text.len() as u64);
        self.0.extend(text.as_bytes());
        self
    }

    fn whole(&mut self, whole: u64) -> &mut Self {
        self.byte(0x14);
        self.0.extend(whole.to_le_bytes());
        self
    }

    /// Starts an array of `count` numbers. The caller must write the numbers next.
    fn array(&mut self, storage: Type, count: u64) -> &mut Self {
        self.byte(0x40).byte(storage.name_and_code().1).length(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::{Mesh, VertexAttribute};

    #[test]
    fn written_triangles_are_clockwise_seen_from_outside() {
        let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2]], ..Mesh::default() };
        let mut bytes = Vec::new();
        write_document(&mut bytes, &mesh, CoordinateWidth::F32)
            .expect("writing to a `Vec` does not fail");
        let corners: Vec<u8> = [0_u32, 2, 1].iter().flat_map(|i| i.to_le_bytes()).collect();
        assert!(bytes.windows(corners.len()).any(|window| window == corners));
    }

    #[test]
    fn houdini_rotates_velocities_and_forces_but_not_colours() {
        let positions = vec![[0.0; 3]];
        let names = [("velocity", 3), ("force", 3), ("Cd", 3), ("uv", 3), ("pressure", 1)];
        let attributes =
            names.map(|(name, width)| VertexAttribute::new(name, width, vec![0.5; width]));
        let mesh = Mesh { positions, attributes: attributes.into(), ..Mesh::default() };
        let meanings: Vec<(String, &str)> = arrays(&mesh, CoordinateWidth::F32)
            .into_iter()
            .map(|array| (array.name, array.meaning))
            .collect();
        let expected = [
            ("P", "point"),
            ("v", "vector"),
            ("force", "vector"),
            ("Cd", "color"),
            ("uv", ""),
            ("pressure", ""),
        ];
        assert_eq!(meanings, expected.map(|(name, meaning)| (name.to_owned(), meaning)));
    }
}
