//! What .ply and legacy .vtk files promise, in both directions, and how their writers stay in order.

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::{self, Write};
use std::path::Path;

use meniscus::io::bytes::{Bytes, open_bytes};
use meniscus::io::encode::write_chunks;
use meniscus::io::{CoordinateWidth, ParticleFile, ReadFault, ply, vtk};
use meniscus::mesh::{Mesh, VertexAttribute};
use meniscus::particles::{Particles, velocity_attribute};

/// Refuses, and so ends the tests at, any allocation that only a lying header can ask for.
struct Modest;

#[global_allocator]
static ALLOCATOR: Modest = Modest;

// SAFETY: as `System`, but for null, which says that there is no memory.
unsafe impl GlobalAlloc for Modest {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promise is passed on.
        if layout.size() > 64 << 20 { std::ptr::null_mut() } else { unsafe { System.alloc(layout) } }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(at, layout) }
    }
}

/// A format under test.
#[derive(Clone, Copy)]
struct Format {
    read_particles: fn(Bytes) -> Result<ParticleFile, ReadFault>,
    read_mesh: fn(&[u8]) -> Result<Mesh, ReadFault>,
    has_faces: fn(&[u8]) -> Result<bool, ReadFault>,
    write_mesh: fn(&mut dyn Write, &Mesh, CoordinateWidth) -> io::Result<()>,
}

const PLY: Format = Format {
    read_particles: ply::read_particles,
    read_mesh: ply::read_mesh,
    has_faces: ply::has_faces,
    write_mesh: ply::write_mesh,
};

const VTK: Format = Format {
    read_particles: vtk::read_particles,
    read_mesh: vtk::read_mesh,
    has_faces: vtk::has_faces,
    write_mesh: vtk::write_mesh,
};

impl Format {
    fn particles(self, bytes: &[u8]) -> Result<ParticleFile, ReadFault> {
        (self.read_particles)(Bytes::Owned(bytes.to_vec()))
    }

    fn written(self, mesh: &Mesh, width: CoordinateWidth) -> Vec<u8> {
        let mut bytes = Vec::new();
        (self.write_mesh)(&mut bytes, mesh, width).unwrap();
        bytes
    }
}

fn positions(file: &ParticleFile) -> Vec<[f64; 3]> {
    let mut out = vec![[0.0; 3]; file.particles.len()];
    file.particles.positions(0, &mut out);
    out
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

fn attribute(file: &ParticleFile, name: &str) -> Vec<f32> {
    attributes(file).into_iter().find(|(found, ..)| found == name).expect(name).2
}

/// A number as a format's type of that name stores it, little-endian.
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

/// Data of a .ply file in one of [`ENCODINGS`], behind a header given without its first two lines.
struct PlyBuilder {
    encoding: &'static str,
    bytes: Vec<u8>,
}

impl PlyBuilder {
    fn new(encoding: &'static str, header: &str) -> Self {
        Self { encoding, bytes: format!("ply\nformat {encoding} 1.0\n{header}end_header\n").into_bytes() }
    }

    /// A row of numbers, each with its type.
    fn row(mut self, values: &[(&str, f64)]) -> Self {
        for (index, (kind, value)) in values.iter().enumerate() {
            match self.encoding {
                "ascii" => write!(self.bytes, "{}{value}", if index == 0 { "" } else { " " }).unwrap(),
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

/// Particles, and a face that is none of a particle file's business.
fn ply_with_face(encoding: &'static str) -> Vec<u8> {
    let header = "element vertex 3\nproperty float x\nproperty double y\nproperty float32 z\nproperty uchar c\n\
                  element face 1\nproperty list uchar int vertex_indices\n";
    let mut file = PlyBuilder::new(encoding, header);
    for [x, y, z] in TRIANGLE {
        file = file.row(&[("float", x), ("double", y), ("float", z), ("uchar", 9.0)]);
    }
    file.row(&[("uchar", 3.0), ("int", 0.0), ("int", 1.0), ("int", 2.0)]).bytes
}

#[test]
fn ply_scalars_of_every_type_and_encoding_are_read_to_the_bit() {
    let properties = [
        ("uint8", "a", 200.0),
        ("float", "z", f64::from(0.1f32)),
        ("int8", "b", -100.0),
        ("char", "c", -1.0),
        ("uchar", "d", 255.0),
        ("short", "e", -32_000.0),
        ("double", "x", 0.1),
        ("ushort", "f", 65_000.0),
        ("int16", "g", -2.0),
        ("uint16", "h", 3.0),
        ("int", "i", -2e9),
        ("uint", "j", 4e9),
        ("int32", "k", 5.0),
        ("uint32", "l", 6.0),
        ("float64", "m", -1e30),
        ("float32", "y", f64::from(-1e-30f32)),
    ];
    let lines: String =
        properties.iter().map(|(kind, name, _)| format!("property {kind} {name}\n")).collect();
    for encoding in ENCODINGS {
        let rows = [1.0, 0.5].map(|scale| {
            properties
                .map(|(kind, _, value)| (kind, if kind.contains("loat") { value * scale } else { value }))
        });
        let header = format!("element vertex 2\n{lines}");
        let file = PlyBuilder::new(encoding, &header).row(&rows[0]).row(&rows[1]).bytes;
        let file = PLY.particles(&file).unwrap();
        let at = |row: usize, name| rows[row][properties.iter().position(|p| p.1 == name).unwrap()].1;
        let wanted = [0, 1].map(|row| ["x", "y", "z"].map(|axis| at(row, axis)));
        assert_eq!(positions(&file), wanted, "{encoding}");
        for name in "a b c d e f g h i j k l m".split(' ') {
            let wanted = [0, 1].map(|row| at(row, name) as f32);
            assert_eq!(attribute(&file, name), wanted, "{encoding}: {name}");
        }
    }
}

#[test]
fn ply_properties_of_a_vector_are_one_attribute() {
    let spelled =
        [["vx", "vy", "vz"], ["velocity_x", "velocity_y", "velocity_z"], ["vel_x", "vel_y", "vel_z"]];
    for [a, b, c] in spelled {
        let names = ["x", "y", "z", c, "id", a, "nx", "ny", "b_0", "b_1", b, "nz", "c_0", "d_1"];
        let lines: String = names.iter().map(|name| format!("property float {name}\n")).collect();
        let row: Vec<_> = (0..names.len()).map(|i| ("float", i as f64)).collect();
        let file =
            PlyBuilder::new("binary_big_endian", &format!("element vertex 1\n{lines}")).row(&row).bytes;
        let wanted = [
            ("velocity", vec![5.0, 10.0, 3.0]),
            ("id", vec![4.0]),
            ("normal", vec![6.0, 7.0, 11.0]),
            ("b", vec![8.0, 9.0]),
            ("c_0", vec![12.0]),
            ("d_1", vec![13.0]),
        ];
        let file = PLY.particles(&file).unwrap();
        let wanted = wanted.map(|(name, values)| (name.to_owned(), values.len(), values));
        assert_eq!(attributes(&file), wanted, "{a}");
        assert_eq!(velocity_attribute(file.particles.attributes()), Some(0));
    }
    let lines = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty float vx\n";
    let file = PlyBuilder::new("ascii", lines).row(&[("float", 1.0); 4]).bytes;
    assert_eq!(attribute(&PLY.particles(&file).unwrap(), "vx"), [1.0]);
}

#[test]
fn ply_elements_around_the_vertices_are_passed() {
    let header = "comment a comment \u{e9}\nelement camera 2\nproperty float fov\nproperty uchar flag\n\
                  element nothing 5\n\
                  element strand 2\nproperty short s\nproperty list uchar float weights\nobj_info anything\n\
                  element vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
                  element edge 1\nproperty int a\nelement face 2\n\
                  property uchar flags\nproperty list uint8 uint32 vertex_index\nproperty list uchar float uv\n";
    for encoding in ENCODINGS {
        let file = PlyBuilder::new(encoding, header)
            .row(&[("float", 1.5), ("uchar", 1.0)])
            .row(&[("float", 2.5), ("uchar", 2.0)])
            .row(&[("short", 7.0), ("uchar", 2.0), ("float", 0.25), ("float", 0.75)])
            .row(&[("short", 8.0), ("uchar", 0.0)])
            .row(&[("float", 10.0), ("float", 20.0), ("float", 30.0)])
            .row(&[("int", 5.0)])
            .row(&[
                ("uchar", 1.0),
                ("uchar", 3.0),
                ("uint", 0.0),
                ("uint", 0.0),
                ("uint", 0.0),
                ("uchar", 0.0),
            ])
            .row(&[
                ("uchar", 1.0),
                ("uchar", 2.0),
                ("uint", 0.0),
                ("uint", 0.0),
                ("uchar", 1.0),
                ("float", 0.5),
            ])
            .bytes;
        assert_eq!(positions(&PLY.particles(&file).unwrap()), [[10.0, 20.0, 30.0]], "{encoding}");
        assert_eq!(ply::read_mesh(&file).unwrap().triangles, [[0, 0, 0]], "{encoding}: a line has no area");
    }
}

#[test]
fn ply_headers_may_have_line_ends_of_either_kind() {
    for encoding in ENCODINGS {
        let file = ply_with_face(encoding);
        let end = file.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let body = if encoding == "ascii" {
            String::from_utf8(file[end..].to_vec()).unwrap().replace('\n', "\r\n").into_bytes()
        } else {
            file[end..].to_vec()
        };
        let header = String::from_utf8(file[..end].to_vec()).unwrap().replace('\n', "\r\n");
        let file = [header.as_bytes(), &body].concat();
        assert_eq!(positions(&PLY.particles(&file).unwrap())[2], TRIANGLE[2], "{encoding}");
        assert_eq!(ply::read_mesh(&file).unwrap().triangles, [[0, 1, 2]], "{encoding}");
    }
}

#[test]
fn ply_files_that_we_do_not_read_are_refused_with_the_reason() {
    let xyz = "property float x\nproperty float y\nproperty float z\n";
    let header = |lines: &str| format!("ply\nformat ascii 1.0\n{lines}end_header\n");
    let refused = [
        (header(&format!("element vertex 0\n{xyz}property list uchar int n\n")), "a list (n)"),
        (header("element vertex 0\nproperty float x\nproperty float y\n"), "no property `z`"),
        (header("element point 0\n"), "no element `vertex`"),
        (header(&format!("element vertex 1\n{xyz}")) + "1.25 2\n", "line 8: the line ends where a number"),
        (header(&format!("element vertex 1\n{xyz}")) + "1 2 3 4\n", "line 8: there are more values"),
        (header(&format!("element vertex 1\n{xyz}")) + "\n1 two 3\n", "line 9: \"two\" stands where"),
        (header("element vertex -1\n"), "line 3: \"-1\" is no count"),
        (header("property float x\n"), "line 3: a property of no element"),
        (header("element vertex 1\nproperty quad x\n"), "line 4: \"property quad x\" is no property"),
        ("ply\nformat ascii 2.0\n".into(), "line 2"),
        ("ply\nformat text 1.0\n".into(), "line 2: format \"text\""),
        ("ply\nend_header\n".into(), "line 2: the header names no format"),
        ("plyer\n".into(), "line 1"),
    ];
    for (text, reason) in refused {
        let fault = PLY.particles(text.as_bytes()).expect_err(&text).to_string();
        assert!(fault.contains(reason), "{text}: {fault}");
    }
    let strips = header(&format!(
        "element vertex 0\n{xyz}element tristrips 1\nproperty list int int vertex_indices\n"
    ));
    assert!(matches!(ply::has_faces(strips.as_bytes()), Err(ReadFault::Unsupported(_))));
    let plain = header(&format!("element vertex 0\n{xyz}element face 1\nproperty int a\n"));
    assert!(matches!(ply::has_faces(plain.as_bytes()), Err(ReadFault::Malformed { .. })));
}

/// Sections of a .vtk file, and where each ends, so that the file might end there.
struct VtkBuilder {
    ascii: bool,
    bytes: Vec<u8>,
    ends: Vec<usize>,
}

impl VtkBuilder {
    fn new(version: &str, ascii: bool, dataset: &str) -> Self {
        let encoding = if ascii { "ASCII" } else { "BINARY" };
        let text = format!("# vtk DataFile Version {version}\ntitle \u{e9}\n{encoding}\nDATASET {dataset}\n");
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
                true => write!(self.bytes, "{}{value}", if index == 0 { "" } else { " " }).unwrap(),
                false => self.bytes.extend(stored_big(kind, *value)),
            }
        }
        self.bytes.push(b'\n');
        self
    }

    /// Says that what stands so far is a whole file, with or without the last line's end, unless that is
    /// the empty line that something needs.
    fn end(mut self) -> Self {
        let length = self.bytes.len();
        self.ends.extend(if self.bytes.ends_with(b"\n\n") { length..=length } else { length - 1..=length });
        self
    }
}

const TWO: [f64; 6] = [0.5, 1.0, -2.0, 1e-3, 4.5, 7.0];
const TWO_POSITIONS: [[f64; 3]; 2] = [[0.5, 1.0, -2.0], [1e-3, 4.5, 7.0]];

/// As the SPH library that writes `id`, `velocity` and `density`.
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

/// As the GPU SPH program whose SCALARS lack their number of components.
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

/// As the toolkit itself writes version 5.1, with everything that can stand around the attributes.
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
    let file = if ascii { file.data("float", &[0.0, 0.5, 1.0, 1.0]) } else { file.data("uchar", &[1.0; 4]) };
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

#[test]
fn vtk_layouts_of_every_program_are_read_to_the_bit() {
    let v = vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    for ascii in [true, false] {
        type Wanted = Vec<(&'static str, Vec<f32>)>;
        let cases: [(VtkBuilder, Wanted); 3] = [
            (
                splish(ascii),
                vec![("id", vec![7., 8.]), ("velocity", v.clone()), ("mass density", vec![1000., 9.])],
            ),
            (dual(ascii), vec![("Idp", vec![7., 8.]), ("Vel", v.clone()), ("Type", vec![3., 3.])]),
            (
                toolkit(ascii),
                vec![("velocity", v.clone()), ("gid", vec![1., 2.]), ("density", vec![1000., 9.])],
            ),
        ];
        for (number, (file, wanted)) in cases.into_iter().enumerate() {
            let read = VTK.particles(&file.bytes).unwrap();
            let wanted: Vec<_> = wanted
                .into_iter()
                .map(|(name, values)| (name.to_owned(), values.len() / 2, values))
                .collect();
            let single = number == 2 && !ascii;
            let exact = TWO_POSITIONS.map(|p| p.map(|c| if single { f64::from(c as f32) } else { c }));
            assert_eq!(positions(&read), exact, "layout {number}, ascii {ascii}");
            assert_eq!(attributes(&read), wanted, "layout {number}, ascii {ascii}");
            assert!(!vtk::has_faces(&file.bytes).unwrap());
            assert!(vtk::read_mesh(&file.bytes).unwrap().triangles.is_empty());
        }
    }
}

#[test]
fn vtk_arrays_of_every_type_are_read_to_the_bit() {
    let kinds = [
        ("char", -100.0),
        ("signed_char", -3.0),
        ("unsigned_char", 200.0),
        ("short", -30_000.0),
        ("unsigned_short", 60_000.0),
        ("int", -2e9),
        ("unsigned_int", 4e9),
        ("long", -1e15),
        ("unsigned_long", 1e15),
        ("vtktypeint64", -5.0),
        ("vtktypeuint64", 5.0),
        ("vtkIdType", 77.0),
        ("float", 0.5),
        ("double", -1e30),
    ];
    for ascii in [true, false] {
        let mut file =
            VtkBuilder::new("4.2", ascii, "POLYDATA").line("POINTS 1 float").data("float", &[1.0; 3]);
        file = file.line("POINT_DATA 1").line(&format!("FIELD FieldData {}", kinds.len()));
        for (kind, value) in kinds {
            file = file.line(&format!("a_{kind} 1 1 {kind}")).data(kind, &[value]);
        }
        let file = VTK.particles(&file.bytes).unwrap();
        for (kind, value) in kinds {
            assert_eq!(attribute(&file, &format!("a_{kind}")), [value as f32], "{kind}, ascii {ascii}");
        }
    }
}

#[test]
fn vtk_files_that_disagree_with_themselves_are_refused_with_the_reason() {
    let head = "# vtk DataFile Version 3.0\nt\nASCII\n";
    let points = format!("{head}DATASET POLYDATA\nPOINTS 1 float\n1 2 3\n");
    let refused = [
        (format!("{head}DATASET STRUCTURED_POINTS\n"), "DATASET STRUCTURED_POINTS"),
        (format!("{head}DATASET POLYDATA\n"), "without POINTS"),
        (format!("{points}POINT_DATA 2\n"), "line 7: POINT_DATA of 2, but POINTS of 1"),
        (format!("{points}POINTS 1 float\n1 2 3\n"), "POINTS already"),
        (format!("{points}VECTORS v float\n1 2 3\n"), "line 7: an attribute before POINT_DATA"),
        (format!("{points}POINT_DATA 1\nSCALARS a float\n1\n"), "need a LOOKUP_TABLE"),
        (format!("{points}POINT_DATA 1\nFIELD f 1\na 1 2 float\n1 2\n"), "a has 2 tuples for 1 points"),
        (format!("{points}POINT_DATA 1\nFIELD f 1\na 99999 1 float\n1\n"), "99999 components"),
        (format!("{points}POINT_DATA 1\nFIELD f 1\na 1 1 variant\n1\n"), "\"variant\""),
        (format!("{points}CELLS 1 2\n1 0\n"), "1 CELLS, but 0 CELL_TYPES"),
        (format!("{points}NONSENSE\n"), "line 7: \"NONSENSE\" is no section"),
        (format!("{points}METADATA\nINFORMATION 0\n"), "do not end with an empty line"),
        ("# vtk DataFile Version x\n".into(), "line 1"),
        ("# vtk DataFile Version 3.0\nt\nTEXT\n".into(), "line 3: expected ASCII or BINARY"),
    ];
    for (text, reason) in refused {
        let fault = VTK.particles(text.as_bytes()).expect_err(&text).to_string();
        assert!(fault.contains(reason), "{text}: {fault}");
    }
    let bad = points.replace("1 2 3", "1 2x 3");
    assert!(VTK.particles(bad.as_bytes()).unwrap_err().to_string().contains("line 6: \"2x\" stands"));
}

#[test]
fn the_simulators_own_frame_reads_as_its_record_says() {
    let path = Path::new("tests/data/dambreak_small/ParticleData_Fluid_10.vtk");
    let file = vtk::read_particles(open_bytes(path).unwrap()).unwrap();
    let positions = positions(&file);
    assert_eq!(positions.len(), 8664);
    let fold = |pick: fn(f64, f64) -> f64| {
        positions.iter().copied().reduce(|a, b| [0, 1, 2].map(|axis| pick(a[axis], b[axis]))).unwrap()
    };
    assert_eq!(fold(f64::min), [-1.9498687982559204, 0.0397249311208725, -0.7047143578529358]);
    assert_eq!(fold(f64::max), [-0.18260399997234344, 1.037776231765747, 0.704704761505127]);
    let speed = |v: &[f32]| v.iter().map(|&c| f64::from(c) * f64::from(c)).sum::<f64>().sqrt();
    let fastest = attribute(&file, "velocity").chunks(3).map(speed).fold(0.0, f64::max);
    assert!((fastest - 7.032591819763184).abs() < 1e-6, "{fastest}");
    let mut ids = attribute(&file, "id");
    ids.sort_by(f32::total_cmp);
    assert!(ids.windows(2).all(|pair| pair[0] < pair[1]), "every id is there once");
    // The exporter writes its first field under a name that it does not know.
    assert_eq!(attribute(&file, "pressure"), attribute(&file, "density"));
    assert_eq!(file.particles.attributes().len(), 4);
}

#[test]
fn a_real_mesh_reads_closed() {
    let bytes = std::fs::read("tests/data/spot.ply").unwrap();
    assert!(ply::has_faces(&bytes).unwrap());
    let mesh = ply::read_mesh(&bytes).unwrap();
    assert_eq!((mesh.positions.len(), mesh.triangles.len()), (2930, 5856));
    let mut edges: Vec<_> = mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
    edges.sort_unstable();
    assert!(edges.windows(2).all(|pair| pair[0] != pair[1]));
    assert!(edges.iter().all(|&[a, b]| edges.binary_search(&[b, a]).is_ok()));
}

#[test]
fn polygons_are_fanned_and_cells_without_area_ignored() {
    for encoding in ENCODINGS {
        let header = "element face 3\nproperty list uchar int vertex_indices\n\
                      element vertex 5\nproperty float x\nproperty float y\nproperty float z\n";
        let corners = |list: &[f64]| {
            let rest = list.iter().map(|&corner| ("int", corner));
            std::iter::once(("uchar", list.len() as f64)).chain(rest).collect::<Vec<_>>()
        };
        let mut file = PlyBuilder::new(encoding, header)
            .row(&corners(&[4.0, 3.0, 2.0, 1.0, 0.0]))
            .row(&corners(&[]))
            .row(&corners(&[0.0, 1.0, 2.0]));
        for _ in 0..5 {
            file = file.row(&[("float", 1.0); 3]);
        }
        let mesh = ply::read_mesh(&file.bytes).unwrap();
        assert_eq!(mesh.triangles, [[4, 3, 2], [4, 2, 1], [4, 1, 0], [0, 1, 2]], "{encoding}");
    }
    for ascii in [true, false] {
        let points = |version, dataset| {
            VtkBuilder::new(version, ascii, dataset).line("POINTS 4 float").data("float", &[1.0; 12])
        };
        let cells = [
            points("3.0", "POLYDATA")
                .line("LINES 1 3")
                .data("int", &[2.0, 0.0, 1.0])
                .line("POLYGONS 2 9")
                .data("int", &[4.0, 0.0, 1.0, 2.0, 3.0, 3.0, 3.0, 2.0, 1.0])
                .line("TRIANGLE_STRIPS 1 5")
                .data("int", &[4.0, 0.0, 1.0, 2.0, 3.0]),
            points("5.1", "POLYDATA")
                .line("POLYGONS 3 7")
                .line("OFFSETS vtktypeint64")
                .data("vtktypeint64", &[0.0, 4.0, 7.0])
                .line("CONNECTIVITY int")
                .data("int", &[0.0, 1.0, 2.0, 3.0, 3.0, 2.0, 1.0])
                .line("TRIANGLE_STRIPS 2 4")
                .line("OFFSETS int")
                .data("int", &[0.0, 4.0])
                .line("CONNECTIVITY vtktypeint64")
                .data("vtktypeint64", &[0.0, 1.0, 2.0, 3.0]),
        ];
        for (number, file) in cells.into_iter().enumerate() {
            let mesh = vtk::read_mesh(&file.bytes).unwrap();
            let wanted = [[0, 1, 2], [0, 2, 3], [3, 2, 1], [0, 1, 2], [2, 1, 3]];
            assert_eq!(mesh.triangles, wanted, "{number}, ascii {ascii}");
            assert!(vtk::has_faces(&file.bytes).unwrap());
        }
        let typed = |types: [f64; 5]| {
            let cells = [1., 3., 2., 0., 1., 4., 0., 1., 2., 3., 3., 3., 2., 1., 4., 0., 1., 2., 3.];
            let file = points("4.2", "UNSTRUCTURED_GRID").line("CELLS 5 19").data("int", &cells);
            file.line("CELL_TYPES 5").data("int", &types).bytes
        };
        let mesh = vtk::read_mesh(&typed([1.0, 3.0, 9.0, 5.0, 6.0])).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [3, 2, 1], [0, 1, 2], [2, 1, 3]], "ascii {ascii}");
        let mesh = vtk::read_mesh(&typed([1.0, 3.0, 8.0, 7.0, 4.0])).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 3], [0, 3, 2], [3, 2, 1]], "ascii {ascii}");
        assert!(!vtk::has_faces(&typed([1.0, 3.0, 4.0, 2.0, 0.0])).unwrap());
        let solid = typed([1.0, 3.0, 10.0, 5.0, 6.0]);
        assert!(vtk::has_faces(&solid).unwrap());
        assert!(matches!(vtk::read_mesh(&solid), Err(ReadFault::Unsupported(_))));
    }
}

#[test]
fn a_face_beyond_the_vertices_is_named() {
    for encoding in ENCODINGS {
        let good = ply_with_face(encoding);
        let bad = match encoding {
            "ascii" => String::from_utf8(good).unwrap().replace("3 0 1 2", "3 0 1 3").into_bytes(),
            "binary_little_endian" => [&good[..good.len() - 4], &3i32.to_le_bytes()].concat(),
            _ => [&good[..good.len() - 4], &(-1i32).to_be_bytes()].concat(),
        };
        let fault = ply::read_mesh(&bad).unwrap_err();
        assert!(matches!(fault, ReadFault::Malformed { .. }), "{encoding}: {fault}");
        assert!(fault.to_string().contains("face 0 names vertex"), "{encoding}: {fault}");
    }
    for ascii in [true, false] {
        let file = |cells: [f64; 8]| {
            let file =
                VtkBuilder::new("3.0", ascii, "POLYDATA").line("POINTS 3 float").data("float", &[1.0; 9]);
            vtk::read_mesh(&file.line("POLYGONS 2 8").data("int", &cells).bytes)
        };
        file([3., 0., 1., 2., 3., 0., 1., 2.]).unwrap();
        let fault = file([3., 0., 1., 2., 3., 0., 1., 3.]).unwrap_err();
        assert!(fault.to_string().contains("face 1 names vertex 3, the file has 3"), "{fault}");
        let fault = file([3., 0., 1., 2., -3., 0., 1., 2.]).unwrap_err();
        assert!(fault.to_string().contains("cell 1"), "{fault}");
        let fault = file([3., 0., 1., 2., 4., 0., 1., 2.]).unwrap_err();
        assert!(fault.to_string().contains("cell 1 of 2 ends beyond"), "{fault}");
    }
}

/// All three readers, and every number of what they accept.
fn read_all(format: Format, bytes: &[u8]) -> [Result<(), ReadFault>; 3] {
    let particles = format.particles(bytes).map(|file| {
        positions(&file);
        attributes(&file);
    });
    [particles, (format.read_mesh)(bytes).map(|_| ()), (format.has_faces)(bytes).map(|_| ())]
}

#[test]
fn a_truncated_ply_is_refused_at_every_prefix() {
    for encoding in ENCODINGS {
        let file = ply_with_face(encoding);
        let rows_end = match encoding {
            "ascii" => file.len() - "\n3 0 1 2\n".len(),
            _ => file.len() - 13,
        };
        let faces_end = file.len() - usize::from(encoding == "ascii");
        for cut in 0..file.len() {
            let [particles, mesh, _] = read_all(PLY, &file[..cut]);
            assert_eq!(particles.is_ok(), cut >= rows_end, "{encoding}: particles of {cut} bytes");
            assert_eq!(mesh.is_ok(), cut >= faces_end, "{encoding}: mesh of {cut} bytes");
        }
    }
}

#[test]
fn a_truncated_vtk_is_refused_at_every_prefix_that_is_no_shorter_file() {
    for ascii in [true, false] {
        for file in [splish(ascii), dual(ascii), toolkit(ascii)] {
            for cut in 0..file.bytes.len() {
                let may_end = file.ends.contains(&cut);
                let [particles, mesh, _] = read_all(VTK, &file.bytes[..cut]);
                let end = String::from_utf8_lossy(&file.bytes[cut.saturating_sub(40)..cut]).into_owned();
                assert_eq!(particles.is_ok(), may_end, "ascii {ascii}, {cut} bytes, ending in {end:?}");
                assert_eq!(mesh.is_ok(), may_end, "ascii {ascii}, {cut} bytes, ending in {end:?}");
            }
        }
    }
}

#[test]
fn no_flipped_byte_makes_a_reader_panic() {
    let mesh = some_mesh();
    let mut files: Vec<(Format, Vec<u8>)> = ENCODINGS.map(|encoding| (PLY, ply_with_face(encoding))).to_vec();
    for ascii in [true, false] {
        files.extend([splish(ascii), dual(ascii), toolkit(ascii)].map(|file| (VTK, file.bytes)));
    }
    files.extend([PLY, VTK].map(|format| (format, format.written(&mesh, CoordinateWidth::F32))));
    for (format, mut bytes) in files {
        for at in 0..bytes.len() {
            let original = bytes[at];
            for flip in [1, 2, 4, 8, 16, 32, 64, 128, 255, original ^ b'\n', original ^ b' ', original ^ b'9']
            {
                bytes[at] = original ^ flip;
                let _ = read_all(format, &bytes);
            }
            bytes[at] = original;
        }
    }
}

#[test]
fn counts_that_the_file_cannot_hold_are_refused_before_any_memory_is_taken() {
    let huge =
        ["2147483647", "4294967295", "9223372036854775808", "18446744073709551615", "99999999999999999999"];
    let mut refused = 0;
    let mut refuse = |format: Format, file: &[u8], from: &str, to: &str| {
        let at = file.windows(from.len()).position(|w| w == from.as_bytes()).expect(from);
        let file = [&file[..at], to.as_bytes(), &file[at + from.len()..]].concat();
        let [particles, mesh, _] = read_all(format, &file);
        assert!(particles.is_err() || mesh.is_err(), "{from:?} as {to:?}");
        refused += 1;
    };
    for count in huge {
        for encoding in ENCODINGS {
            let file = ply_with_face(encoding);
            refuse(PLY, &file, "vertex 3", &format!("vertex {count}"));
            refuse(PLY, &file, "face 1", &format!("face {count}"));
            let fixed = format!("element a {count}\nproperty int b\nelement vertex");
            refuse(PLY, &file, "element vertex", &fixed);
            let lists = format!("element a {count}\nproperty list char int b\nelement vertex");
            refuse(PLY, &file, "element vertex", &lists);
        }
        for ascii in [true, false] {
            let file = splish(ascii).bytes;
            for line in ["POINTS 2 ", "CELLS 2 ", "CELLS 2 4", "CELL_TYPES 2", "POINT_DATA 2", "FieldData 2"]
            {
                let (head, _) = line.trim_end().rsplit_once(' ').unwrap();
                let end = if line.ends_with(' ') { " " } else { "" };
                refuse(VTK, &file, line, &format!("{head} {count}{end}"));
            }
            refuse(VTK, &file, "velocity 3 2", &format!("velocity {count} 2"));
            refuse(VTK, &file, "velocity 3 2", &format!("velocity 3 {count}"));
            refuse(VTK, &file, "id unsigned_int 1", &format!("id unsigned_int {count}"));
            let file = toolkit(ascii).bytes;
            refuse(VTK, &file, "CELLS 3 2", &format!("CELLS {count} 2"));
            refuse(VTK, &file, "CELLS 3 2", &format!("CELLS 3 {count}"));
            refuse(VTK, &file, "names 1 2", &format!("names 1 {count}"));
            refuse(VTK, &file, "bits 1 2", &format!("bits 1 {count}"));
            refuse(VTK, &file, "table 1", &format!("table {count}"));
        }
    }
    assert_eq!(refused, huge.len() * (3 * 4 + 2 * 14));
}

fn some_mesh() -> Mesh {
    let awkward = [0.1, -0.0, 1e-30, -7.25, 1e9 + 0.125, f64::from(f32::MIN_POSITIVE)];
    let positions: Vec<[f64; 3]> = (0..6).map(|i| [0, 1, 2].map(|axis| awkward[(i + axis) % 6])).collect();
    let values = |components: usize| (0..6 * components).map(|i| i as f32 * 0.1 - 1.0).collect::<Vec<_>>();
    Mesh {
        positions,
        triangles: vec![[0, 1, 2], [5, 4, 3], [2, 1, 5], [0, 5, 0]],
        normals: Some((0..6).map(|i| [0.6, -0.8, i as f32]).collect()),
        attributes: [("velocity", 3), ("density", 1), ("stress", 6), ("uv", 2)]
            .map(|(name, components)| VertexAttribute {
                name: name.into(),
                components,
                values: values(components),
            })
            .to_vec(),
    }
}

fn rounded(mut mesh: Mesh) -> Mesh {
    mesh.positions.iter_mut().for_each(|p| *p = p.map(|c| f64::from(c as f32)));
    mesh
}

#[test]
fn a_written_mesh_reads_back_the_same() {
    let whole = some_mesh();
    let bare = Mesh { normals: None, attributes: Vec::new(), ..whole.clone() };
    let scalar = Mesh { attributes: vec![whole.attributes[1].clone()], ..bare.clone() };
    let empty = Mesh::default();
    let loose = Mesh { triangles: Vec::new(), ..whole.clone() };
    for mesh in [whole, bare, scalar, empty, loose] {
        for format in [PLY, VTK] {
            let double = format.written(&mesh, CoordinateWidth::F64);
            assert_eq!((format.read_mesh)(&double).unwrap(), mesh);
            let single = format.written(&mesh, CoordinateWidth::F32);
            assert_eq!((format.read_mesh)(&single).unwrap(), rounded(mesh.clone()));
            assert_eq!((format.has_faces)(&single).unwrap(), !mesh.triangles.is_empty());
            assert_eq!(format.particles(&double).unwrap().particles.len(), mesh.positions.len());
        }
    }
}

#[test]
fn names_of_attributes_cannot_break_a_header() {
    let names = ["a b", "x", "x", "nx", "end_header\n", "", "%20", "\u{e9}t\u{e9}", "METADATA", "NULL_ARRAY"];
    let attributes = names.map(|name| VertexAttribute {
        name: name.into(),
        components: 1,
        values: (0..6).map(|i| i as f32).collect(),
    });
    let mesh = Mesh { attributes: attributes.to_vec(), ..some_mesh() };
    let read = ply::read_mesh(&PLY.written(&mesh, CoordinateWidth::F64)).unwrap();
    let found: Vec<_> = read.attributes.iter().map(|a| a.name.as_str()).collect();
    let altered =
        ["a_b", "x_", "x__", "nx_", "end_header_", "_", "%20", "\u{e9}t\u{e9}", "METADATA", "NULL_ARRAY"];
    assert_eq!(found, altered);
    let read = vtk::read_mesh(&VTK.written(&mesh, CoordinateWidth::F64)).unwrap();
    let found: Vec<_> = read.attributes.iter().map(|a| a.name.as_str()).collect();
    assert_eq!(found, names.map(|name| if name.is_empty() { "_" } else { name }));
    assert_eq!((read.positions, read.normals), (mesh.positions, mesh.normals));
}

#[test]
fn the_bytes_of_a_mesh_do_not_depend_on_the_threads() {
    let count = 50_000;
    let mesh = Mesh {
        positions: (0..count).map(|i| [f64::from(i), f64::from(i).sin(), 0.5]).collect(),
        triangles: (0..count - 2).map(|i| [i, i + 1, i + 2]).collect(),
        normals: None,
        attributes: Vec::new(),
    };
    for format in [PLY, VTK] {
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| format.written(&mesh, CoordinateWidth::F32))
        };
        let alone = on(1);
        assert!(alone == on(3));
        assert!((format.read_mesh)(&alone).unwrap() == rounded(mesh.clone()));
    }
}

fn put_number(range: std::ops::Range<usize>, out: &mut Vec<u8>) {
    range.for_each(|i| out.extend_from_slice(&(i as u32).to_le_bytes()));
}

#[test]
fn chunks_are_written_in_order_on_any_number_of_threads() {
    for count in [0, 1, 16 << 10, (16 << 10) + 1, 300_000] {
        let wanted: Vec<u8> = (0..count as u32).flat_map(u32::to_le_bytes).collect();
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let got = pool.install(|| {
                let mut out = Vec::new();
                write_chunks(&mut out, count, put_number).unwrap();
                out
            });
            assert!(got == wanted, "{count} records on {threads} threads");
        }
    }
}

#[test]
fn a_writer_that_fails_ends_the_writing_with_its_error() {
    struct Full(usize);
    impl Write for Full {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.0 == 0 {
                return Err(io::ErrorKind::StorageFull.into());
            }
            let taken = bytes.len().min(self.0);
            self.0 -= taken;
            Ok(taken)
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    for room in [0, 1, 65_536, 1_000_000, 1_199_999] {
        let fault = write_chunks(&mut Full(room), 300_000, put_number).unwrap_err();
        assert_eq!(fault.kind(), io::ErrorKind::StorageFull, "room for {room} bytes");
    }
    write_chunks(&mut Full(1_200_000), 300_000, put_number).unwrap();
}
