//! Tests of reading and writing .ply and legacy .vtk files, and builders of such files.

mod damage;
mod meshes;
mod pieces;
mod ply_particles;
mod vtk_particles;

use std::io::{self, Write};

use meniscus::internals::io::bytes::{ByteView, Bytes, Unpacking};
use meniscus::internals::io::{CoordinateWidth, ParticleFile, ReadFault, ply, vtk};
use meniscus::internals::particles::Particles;
use meniscus::internals::surface::mesh::source::MeshSource;
use meniscus::internals::surface::mesh::{Mesh, VertexAttribute};

use crate::common::particle_files::{attribute, positions};

/// A format under test.
#[derive(Clone, Copy)]
struct Format {
    read_particles: fn(Bytes) -> Result<ParticleFile, ReadFault>,
    read_mesh: fn(&[u8]) -> Result<Mesh, ReadFault>,
    has_faces: fn(ByteView) -> Result<bool, ReadFault>,
    write_mesh: fn(&mut dyn Write, &dyn MeshSource, CoordinateWidth) -> io::Result<()>,
}

const PLY: Format = Format {
    read_particles: |bytes| ply::read_points(bytes, Unpacking::in_memory()),
    read_mesh: ply::read_mesh,
    has_faces: ply::has_faces,
    write_mesh: ply::write_mesh,
};

const VTK: Format = Format {
    read_particles: |bytes| vtk::read_points(bytes, Unpacking::in_memory()),
    read_mesh: vtk::read_mesh,
    has_faces: vtk::has_faces,
    write_mesh: vtk::write_mesh,
};

impl Format {
    fn particles(self, bytes: &[u8]) -> Result<ParticleFile, ReadFault> {
        (self.read_particles)(bytes.to_vec().into())
    }

    fn written(self, mesh: &Mesh, width: CoordinateWidth) -> Vec<u8> {
        let mut bytes = Vec::new();
        (self.write_mesh)(&mut bytes, mesh, width).expect("a Vec accepts all bytes");
        bytes
    }
}

fn attributes(file: &ParticleFile) -> Vec<(String, usize, Vec<f32>)> {
    let infos = file.particles.attributes().iter().enumerate();
    infos
        .map(|(index, info)| {
            let mut out = vec![0.0; file.particles.len() * info.components];
            file.particles.attribute(index, 0, &mut out);
            (info.name.clone(), info.components, out)
        })
        .collect()
}

/// The little-endian bytes of a number, in the type that the format calls `kind`.
fn stored(kind: &str, value: f64) -> Vec<u8> {
    match kind {
        "char" | "int8" | "signed_char" => (value as i8).to_le_bytes().to_vec(),
        "uchar" | "uint8" | "unsigned_char" => (value as u8).to_le_bytes().to_vec(),
        "short" | "int16" => (value as i16).to_le_bytes().to_vec(),
        "ushort" | "uint16" | "unsigned_short" => (value as u16).to_le_bytes().to_vec(),
        "int" | "int32" | "vtkIdType" => (value as i32).to_le_bytes().to_vec(),
        "uint" | "uint32" | "unsigned_int" => (value as u32).to_le_bytes().to_vec(),
        "long" | "vtktypeint64" => (value as i64).to_le_bytes().to_vec(),
        "unsigned_long" | "vtktypeuint64" => (value as u64).to_le_bytes().to_vec(),
        "float" | "float32" => (value as f32).to_le_bytes().to_vec(),
        "double" | "float64" => value.to_le_bytes().to_vec(),
        _ => panic!("no type {kind}"),
    }
}

fn stored_big(kind: &str, value: f64) -> Vec<u8> {
    let mut bytes = stored(kind, value);
    bytes.reverse();
    bytes
}

const ENCODINGS: [&str; 3] = ["ascii", "binary_little_endian", "binary_big_endian"];

/// Builds a .ply file in one of [`ENCODINGS`]. The caller provides the header without its first two
/// lines.
struct PlyBuilder {
    encoding: &'static str,
    bytes: Vec<u8>,
}

impl PlyBuilder {
    fn new(encoding: &'static str, header: &str) -> Self {
        Self {
            encoding,
            bytes: format!("ply\nformat {encoding} 1.0\n{header}end_header\n").into_bytes(),
        }
    }

    /// Adds a row of numbers, each with its type.
    fn row(mut self, values: &[(&str, f64)]) -> Self {
        for (index, (kind, value)) in values.iter().enumerate() {
            match self.encoding {
                "ascii" => write!(self.bytes, "{}{value}", if index == 0 { "" } else { " " })
                    .expect("a Vec accepts all bytes"),
                "binary_little_endian" => self.bytes.extend(stored(kind, *value)),
                _ => self.bytes.extend(stored_big(kind, *value)),
            }
        }
        if self.encoding == "ascii" {
            self.bytes.push(b'\n');
        }
        self
    }
}

const TRIANGLE: [[f64; 3]; 3] = [[0.0, 0.5, 1.0], [1.0, -2.5, 1e-3], [-3.0, 4.0, 7.0]];

/// Particles, and a face that a reader of particles ignores.
fn ply_with_face(encoding: &'static str) -> Vec<u8> {
    let header = "element vertex 3\nproperty float x\nproperty double y\nproperty float32 z\nproperty uchar c\n\
                  element face 1\nproperty list uchar int vertex_indices\n";
    let mut file = PlyBuilder::new(encoding, header);
    for [x, y, z] in TRIANGLE {
        file = file.row(&[("float", x), ("double", y), ("float", z), ("uchar", 9.0)]);
    }
    file.row(&[("uchar", 3.0), ("int", 0.0), ("int", 1.0), ("int", 2.0)]).bytes
}

/// Sections of a .vtk file, and the offsets at which the file may end.
struct VtkBuilder {
    ascii: bool,
    bytes: Vec<u8>,
    ends: Vec<usize>,
}

impl VtkBuilder {
    fn new(version: &str, ascii: bool, dataset: &str) -> Self {
        let encoding = if ascii { "ASCII" } else { "BINARY" };
        let text = format!(
            "# vtk DataFile Version {version}\ntitle \u{e9}\n{encoding}\nDATASET {dataset}\n"
        );
        Self { ascii, bytes: text.into_bytes(), ends: Vec::new() }
    }

    fn line(mut self, line: &str) -> Self {
        self.bytes.extend(line.as_bytes());
        self.bytes.push(b'\n');
        self
    }

    fn data(mut self, kind: &str, values: &[f64]) -> Self {
        for (index, value) in values.iter().enumerate() {
            match self.ascii {
                true => write!(self.bytes, "{}{value}", if index == 0 { "" } else { " " })
                    .expect("a Vec accepts all bytes"),
                false => self.bytes.extend(stored_big(kind, *value)),
            }
        }
        self.bytes.push(b'\n');
        self
    }

    /// Records that the file may end here. The last line break is optional, unless it ends a
    /// required empty line.
    fn end(mut self) -> Self {
        let length = self.bytes.len();
        self.ends.extend(if self.bytes.ends_with(b"\n\n") {
            length..=length
        } else {
            length - 1..=length
        });
        self
    }
}

const TWO: [f64; 6] = [0.5, 1.0, -2.0, 1e-3, 4.5, 7.0];

const TWO_POSITIONS: [[f64; 3]; 2] = [[0.5, 1.0, -2.0], [1e-3, 4.5, 7.0]];

/// A file as SPlisHSPlasH writes it, with `id`, `velocity` and `density`.
fn splish(ascii: bool) -> VtkBuilder {
    VtkBuilder::new("4.1", ascii, "UNSTRUCTURED_GRID")
        .line("POINTS 2 double")
        .data("double", &TWO)
        .end()
        .line("CELLS 2 4")
        .data("int", &[1.0, 0.0, 1.0, 1.0])
        .line("CELL_TYPES 2")
        .data("int", &[1.0, 1.0])
        .end()
        .line("POINT_DATA 2")
        .end()
        .line("SCALARS id unsigned_int 1")
        .line("LOOKUP_TABLE id_table")
        .data("unsigned_int", &[7.0, 8.0])
        .end()
        .line("FIELD FieldData 2")
        .line("velocity 3 2 float")
        .data("float", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
        .line("mass%20density 1 2 float")
        .data("float", &[1000.0, 9.0])
        .end()
}

/// A file as DualSPHysics writes it. Its SCALARS line lacks the number of components.
fn dual(ascii: bool) -> VtkBuilder {
    VtkBuilder::new("3.0", ascii, "POLYDATA")
        .line("POINTS 2 double")
        .data("double", &TWO)
        .end()
        .line("VERTICES 2 4")
        .data("int", &[1.0, 0.0, 1.0, 1.0])
        .end()
        .line("POINT_DATA 2")
        .end()
        .line("SCALARS Idp unsigned_int")
        .line("LOOKUP_TABLE default")
        .data("unsigned_int", &[7.0, 8.0])
        .end()
        .line("FIELD FieldData 2")
        .line("Vel 3 2 float")
        .data("float", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
        .line("Type 1 2 unsigned_char")
        .data("unsigned_char", &[3.0, 3.0])
        .end()
}

/// A file of version 5.1, with all sections that may occur before and after the attributes.
fn toolkit(ascii: bool) -> VtkBuilder {
    let file = VtkBuilder::new("5.1", ascii, "UNSTRUCTURED_GRID")
        .line("FIELD FieldData 3")
        .line("TimeValue 1 1 double")
        .data("double", &[0.5])
        .line("names 1 2 string");
    let file = match ascii {
        true => file.line("hello%20world").line(""),
        false => {
            let long = [&[0x80, 70][..], &[b'x'; 70]].concat();
            let mut file = file;
            file.bytes.extend([&[0xc0 | 5][..], b"hello", &long].concat());
            file.line("")
        }
    };
    let file = file
        .line("empty 1 0 float")
        .line("")
        .line("POINTS 2 float")
        .data("float", &TWO)
        .end()
        .line("METADATA")
        .line("INFORMATION 1")
        .line("NAME L2_NORM_RANGE LOCATION vtkDataArray")
        .line("DATA 2 0 1")
        .line("")
        .end()
        .line("CELLS 3 2")
        .line("OFFSETS vtktypeint64")
        .data("vtktypeint64", &[0.0, 1.0, 2.0])
        .line("CONNECTIVITY vtktypeint64")
        .data("vtktypeint64", &[0.0, 1.0])
        .line("CELL_TYPES 2")
        .data("int", &[1.0, 1.0])
        .end()
        .line("CELL_DATA 2")
        .end()
        .line("SCALARS ofCells double")
        .line("LOOKUP_TABLE default")
        .data("double", &[5.0, 5.0])
        .end()
        .line("POINT_DATA 2")
        .end()
        .line("COLOR_SCALARS rgb 2");
    let file = if ascii {
        file.data("float", &[0.0, 0.5, 1.0, 1.0])
    } else {
        file.data("uchar", &[1.0; 4])
    };
    let file = file
        .end()
        .line("LOOKUP_TABLE table 1")
        .data("uchar", &[1.0; 4])
        .end()
        .line("VECTORS velocity double")
        .data("double", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
        .end()
        .line("METADATA")
        .line("COMPONENT_NAMES")
        .line("X")
        .line("")
        .line("Z")
        .line("")
        .end()
        .line("GLOBAL_IDS gid vtkIdType")
        .data("vtkIdType", &[1.0, 2.0])
        .end()
        .line("FIELD FieldData 3")
        .line("NULL_ARRAY")
        .line("bits 1 2 bit");
    let file = match ascii {
        true => file.line("1 0"),
        false => {
            let mut file = file;
            file.bytes.push(0x80);
            file.line("")
        }
    };
    file.line("density 1 2 double").data("double", &[1000.0, 9.0]).end()
}

fn some_mesh() -> Mesh {
    let awkward = [0.1, -0.0, 1e-30, -7.25, 1e9 + 0.125, f64::from(f32::MIN_POSITIVE)];
    let positions: Vec<[f64; 3]> =
        (0..6).map(|i| [0, 1, 2].map(|axis| awkward[(i + axis) % 6])).collect();
    let values =
        |components: usize| (0..6 * components).map(|i| i as f32 * 0.1 - 1.0).collect::<Vec<_>>();
    Mesh {
        positions,
        triangles: vec![[0, 1, 2], [5, 4, 3], [2, 1, 5], [0, 5, 0]],
        normals: Some((0..6).map(|i| [0.6, -0.8, i as f32]).collect()),
        attributes: [("velocity", 3), ("density", 1), ("stress", 6), ("uv", 2)]
            .map(|(name, components)| VertexAttribute::new(name, components, values(components)))
            .to_vec(),
    }
}

#[test]
fn a_byte_order_mark_before_ply_and_vtk_files_is_skipped() {
    for ascii in [true, false] {
        let encoding = if ascii { "ascii" } else { "binary_little_endian" };
        let header = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
        let ply = PlyBuilder::new(encoding, header);
        let ply = ply.row(&[("float", 0.5), ("float", 1.0), ("float", -2.0)]);
        for (format, bytes) in [(PLY, ply.bytes), (VTK, splish(ascii).bytes)] {
            let marked = [b"\xef\xbb\xbf", &bytes[..]].concat();
            let (file, marked) =
                (format.particles(&bytes).unwrap(), format.particles(&marked).unwrap());
            assert_eq!(positions(&marked), positions(&file));
            assert_eq!(attributes(&marked), attributes(&file));
        }
    }
}
