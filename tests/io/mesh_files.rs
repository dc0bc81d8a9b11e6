//! Tests of mesh files: reading returns the written mesh, damaged files give an error, and a failed
//! write leaves no file.

use std::fs;
use std::io::{self, Read};
use std::path::Path;
use std::process::Command;

use meniscus::internals::io::glb::GlbLayout;
use meniscus::internals::io::output::{MeshFormat, MeshOutput, read_mesh};
use meniscus::internals::io::whole::Replace;
use meniscus::internals::io::{CoordinateWidth, ReadFault, UpAxis, WriteFault};
use meniscus::internals::particles::{AttributeInfo, AttributeKind};
use meniscus::internals::surface::mesh::{Mesh, VertexAttribute};

use crate::build::gzip;
#[cfg(unix)]
use crate::common::alone::alone_after;
use crate::common::files::names;
use crate::common::shapes::{cuboid, moved, sphere, torus, with_attributes};

#[cfg(not(feature = "hdf5"))]
const FORMATS: [MeshFormat; 5] =
    [MeshFormat::Ply, MeshFormat::Obj, MeshFormat::Vtk, MeshFormat::Vtp, MeshFormat::Stl];
#[cfg(feature = "hdf5")]
const FORMATS: [MeshFormat; 6] = [
    MeshFormat::Ply,
    MeshFormat::Obj,
    MeshFormat::Vtk,
    MeshFormat::Vtp,
    MeshFormat::Stl,
    MeshFormat::VtkHdf,
];

fn written(format: MeshFormat, mesh: &Mesh, width: CoordinateWidth) -> Vec<u8> {
    let mut bytes = Vec::new();
    format.write(&mut bytes, mesh, width).unwrap();
    bytes
}

/// The mesh with every coordinate rounded to f32.
fn narrowed(mesh: &Mesh) -> Mesh {
    let mut mesh = mesh.clone();
    mesh.positions.iter_mut().flatten().for_each(|x| *x = f64::from(*x as f32));
    mesh
}

fn soup(mesh: &Mesh) -> Vec<[[f64; 3]; 3]> {
    mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize])).collect()
}

#[test]
fn every_format_preserves_everything_that_it_supports_exactly() {
    let mesh = with_attributes(moved(&sphere(0.7, 3), [1e-3, -300., 1.0 / 3.0]));
    for format in FORMATS {
        for width in [CoordinateWidth::F32, CoordinateWidth::F64] {
            let read = format.read(&written(format, &mesh, width)).unwrap();
            let wide = width == CoordinateWidth::F64 && format.holds_f64();
            // If the text of an f32 is read as an f64, the bits differ. Therefore, compare meshes
            // rounded to f32.
            let (read, expected) =
                if wide { (read, mesh.clone()) } else { (narrowed(&read), narrowed(&mesh)) };
            assert_eq!(soup(&read), soup(&expected), "{format:?} {width:?}");
            assert_eq!(
                read.normals,
                mesh.normals.clone().filter(|_| format.holds_normals()),
                "{format:?}"
            );
            if format.holds_attributes() {
                assert_eq!(read.attributes, mesh.attributes, "{format:?}");
            }
            assert_eq!(read.attributes.is_empty(), !format.holds_attributes(), "{format:?}");
            if format != MeshFormat::Stl {
                assert_eq!(
                    (read.positions, read.triangles),
                    (expected.positions, expected.triangles)
                );
            } else {
                assert_eq!(read.positions.len(), mesh.positions.len());
            }
        }
    }
}

#[test]
fn colours_are_written_as_bytes_or_as_fractions_by_format() {
    let positions = vec![[0.; 3], [1., 0., 0.], [0., 1., 0.]];
    let mesh = |attribute: VertexAttribute| Mesh {
        positions: positions.clone(),
        triangles: vec![[0, 1, 2]],
        attributes: vec![attribute],
        ..Mesh::default()
    };
    let shares = vec![0., 0.2, 1., 0.4, 0.6, 0.8, -1., 2., f32::NAN];
    let floats = mesh(VertexAttribute::new("Cd", 3, shares));
    let bytes = vec![0., 51., 255., 102., 153., 204., 0., 255., 0.];
    let kind = AttributeKind::ByteColour;
    let of_bytes = VertexAttribute::new("Cd", 3, bytes.clone());
    let shorts = bytes.iter().map(|byte| 257.0 * byte).collect();
    let of_shorts = VertexAttribute {
        kind: AttributeKind::ShortColour,
        ..VertexAttribute::new("Cd", 3, shorts)
    };
    let of_kind = VertexAttribute { kind, ..of_bytes.clone() };
    for mesh in [floats, mesh(of_kind), mesh(of_shorts)] {
        for format in FORMATS.into_iter().filter(|format| format.holds_attributes()) {
            let read = format.read(&written(format, &mesh, CoordinateWidth::F32)).unwrap();
            let [colour] = &read.attributes[..] else {
                panic!("{format:?}: expected one attribute")
            };
            assert_eq!((&colour.values, colour.kind), (&bytes, kind), "{format:?}");
            let name = if format == MeshFormat::Ply { "color" } else { "Cd" };
            assert_eq!(colour.name, name, "{format:?}");
        }
        let text = String::from_utf8(written(MeshFormat::Obj, &mesh, CoordinateWidth::F64));
        assert!(text.unwrap().starts_with("v 0 0 0 0 0.2 1\nv 1 0 0 0.4 0.6 0.8\nv 0 1 0 0 1 0\n"));
        let usd = written(MeshFormat::Usdc(UpAxis::Y), &mesh, CoordinateWidth::F32);
        let holds = |text: &[u8]| usd.windows(text.len()).any(|window| window == text);
        assert!(holds(b"primvars:displayColor") && holds(b"color3f[]"));
    }
    let plain = mesh(VertexAttribute { kind: AttributeKind::Number, ..of_bytes });
    let ply = written(MeshFormat::Ply, &plain, CoordinateWidth::F32);
    assert!(String::from_utf8_lossy(&ply).contains("property float Cd_0"));
}

#[test]
fn usdc_attributes_have_only_types_that_blender_reads() {
    let attribute = |name: &str, components: usize, kind, first: f32| {
        let values = (0..3 * components).map(|i| first + i as f32).collect();
        VertexAttribute { kind, ..VertexAttribute::new(name, components, values) }
    };
    let byte = AttributeKind::ByteColour;
    let whole: Vec<i64> = vec![7, -8, 9, 10, 11, -12];
    let values = whole.iter().map(|&x| x as f32).collect();
    let pair = VertexAttribute { whole, ..VertexAttribute::new("pair", 2, values) };
    let mesh = Mesh {
        positions: vec![[0.; 3], [1., 0., 0.], [0., 1., 0.]],
        triangles: vec![[0, 1, 2]],
        attributes: vec![
            attribute("Cd", 3, byte, 0.),
            attribute("rgba", 4, byte, 51.),
            attribute("uv", 2, AttributeKind::Number, 100.),
            attribute("stress", 4, AttributeKind::Number, 200.),
            VertexAttribute { kind: AttributeKind::Signed, ..pair },
        ],
        ..Mesh::default()
    };
    let bytes = written(MeshFormat::Usdc(UpAxis::Y), &mesh, CoordinateWidth::F32);
    let holds = |text: &[u8]| bytes.windows(text.len()).any(|window| window == text);
    // An array is stored as its length, followed by its values.
    let floats = |values: &[f32]| {
        let values: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        holds(&[&3u64.to_le_bytes()[..], &values].concat())
    };
    assert!(holds(b"\0primvars:rgba\0") && holds(b"\0color4f[]\0"));
    assert!(floats(&std::array::from_fn::<f32, 12, _>(|i| (51 + i) as f32 / 255.)));
    assert!(holds(b"\0primvars:uv\0") && holds(b"\0float2[]\0"));
    assert!(floats(&[100., 101., 102., 103., 104., 105.]));
    for component in 0..4u8 {
        assert!(holds(format!("\0primvars:stress_{component}\0").as_bytes()));
        assert!(floats(&[200., 204., 208.].map(|first| first + f32::from(component))));
    }
    for (component, numbers) in [[7, 9, 11], [-8, 10, -12]].iter().enumerate() {
        assert!(holds(format!("\0primvars:pair_{component}\0").as_bytes()));
        assert!(floats(&numbers.map(|number: i32| f32::from_bits(number as u32))));
    }
    assert!(!holds(b"elementSize"));
}

#[test]
fn vtkhdf_marks_normals_and_velocity_as_vtk_does() {
    let positions = vec![[0.; 3], [1., 0., 0.], [0., 1., 0.]];
    let mesh = Mesh {
        positions,
        triangles: vec![[0, 1, 2]],
        normals: Some(vec![[0., 0., 1.]; 3]),
        attributes: vec![
            VertexAttribute::new("velocity", 3, vec![1.; 9]),
            VertexAttribute::new("force", 3, vec![2.; 9]),
        ],
    };
    let bytes = written(MeshFormat::VtkHdf, &mesh, CoordinateWidth::F32);
    let count = |text: &[u8]| bytes.windows(text.len()).filter(|&window| window == text).count();
    // The name is padded to 16 bytes. The type of the value is a string of seven bytes.
    let named = b"Attribute\0\0\0\0\0\0\0\x13\x01\0\0\x07\0\0\0\x01\0\0\0\0\0\0\0";
    assert_eq!(count(named), 2);
    assert_eq!(count(&[named, &b"Normals"[..]].concat()), 1);
    assert_eq!(count(&[named, &b"Vectors"[..]].concat()), 1);
}

#[test]
fn integer_attributes_beyond_f32_precision_are_preserved() {
    let positions = vec![[0.; 3], [1., 0., 0.], [0., 1., 0.]];
    let cases = [
        (AttributeKind::Signed, vec![16_777_217, -2_000_000_001, 2_147_483_647]),
        (AttributeKind::Unsigned, vec![0, 4_294_967_295, 2_139_095_041]),
    ];
    for (kind, whole) in cases {
        let values = whole.iter().map(|&x| x as f32).collect();
        let id = VertexAttribute { kind, whole, ..VertexAttribute::new("id", 1, values) };
        let mesh = Mesh {
            positions: positions.clone(),
            triangles: vec![[0, 1, 2]],
            attributes: vec![id],
            ..Mesh::default()
        };
        for format in FORMATS.into_iter().filter(|format| format.holds_attributes()) {
            let read = format.read(&written(format, &mesh, CoordinateWidth::F32)).unwrap();
            assert_eq!(read.attributes, mesh.attributes, "{format:?}");
        }
    }
}

#[test]
fn colliding_attribute_names_are_renamed_uniquely_and_reported() {
    let mut mesh = with_attributes(sphere(0.7, 1));
    assert!(mesh.normals.is_some());
    let names = ["Normals", "GlobalPointIds", "a/b", "a_b", "a b", "nx", "velocity_"];
    let values = |number: usize| vec![number as f32; mesh.positions.len()];
    let attributes = names
        .iter()
        .enumerate()
        .map(|(number, name)| VertexAttribute::new(*name, 1, values(number)));
    mesh.attributes = attributes.collect();
    let infos: Vec<_> = mesh.attributes.iter().map(VertexAttribute::info).collect();
    for format in FORMATS.into_iter().filter(|format| format.holds_attributes()) {
        let read = format.read(&written(format, &mesh, CoordinateWidth::F32)).unwrap();
        assert_eq!(read.normals, mesh.normals, "{format:?}");
        let found: Vec<_> =
            read.attributes.iter().map(|attribute| attribute.values[0] as usize).collect();
        assert_eq!(
            found,
            (0..names.len()).collect::<Vec<_>>(),
            "{format:?}: {:?}",
            read.attributes
        );
        // An attribute that the format renames must be reported.
        let renamed = format.renamed(&infos, true);
        for (attribute, name) in read.attributes.iter().zip(names) {
            let expected = renamed.iter().find(|[from, _]| from == name).map_or(name, |[_, to]| to);
            assert_eq!(attribute.name, expected, "{format:?}");
        }
        let mut distinct: Vec<_> =
            read.attributes.iter().map(|attribute| &attribute.name).collect();
        distinct.sort();
        distinct.dedup();
        assert_eq!(distinct.len(), names.len(), "{format:?}: {distinct:?}");
    }
}

#[test]
fn stages_and_glb_files_report_renamed_attributes_but_not_conventional_names() {
    let info = |(name, components): (&str, usize)| AttributeInfo::new(name, components);
    let usual = [("velocity", 3), ("Cd", 4), ("stress", 6), ("density", 1)].map(info);
    let odd = [("a b", 1), ("a_b", 1), ("one two", 2), ("é", 1)].map(info);
    let formats = [MeshFormat::Usdc(UpAxis::Y), MeshFormat::Glb(GlbLayout::PLAIN)];
    for (format, expected) in formats.into_iter().zip([
        [["a b", "a_b"], ["a_b", "a_b_"], ["one two", "one_two"], ["é", "_"]],
        [["a b", "_A_B"], ["a_b", "_A_B_"], ["one two", "_ONE_TWO"], ["é", "__"]],
    ]) {
        assert!(format.renamed(&usual, true).is_empty(), "{format}");
        assert_eq!(format.renamed(&odd, true), expected, "{format}");
    }
    let upper = [("Temp", 1), ("temp", 1)].map(info);
    assert_eq!(formats[1].renamed(&upper, false), [["temp", "_TEMP_"]]);
}

#[test]
fn mesh_files_are_independent_of_the_number_of_threads() {
    let mesh = with_attributes(torus(300, 100));
    for format in FORMATS {
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| written(format, &mesh, CoordinateWidth::F64))
        };
        let bytes = on(1);
        assert_eq!(bytes, on(3), "{format:?}");
        assert_eq!(soup(&format.read(&bytes).unwrap()).len(), mesh.triangles.len());
    }
}

#[test]
fn meshes_without_triangles_or_vertices_can_be_written_and_read() {
    let points = Mesh { positions: vec![[1., 2., 3.]], ..Mesh::default() };
    for format in FORMATS {
        for mesh in [&Mesh::default(), &points] {
            let read = format.read(&written(format, mesh, CoordinateWidth::F32)).unwrap();
            assert!(read.triangles.is_empty());
            let kept = if format == MeshFormat::Stl { 0 } else { mesh.positions.len() };
            assert_eq!(read.positions.len(), kept, "{format:?}");
        }
    }
}

#[test]
fn obj_numbers_are_written_with_the_fewest_digits() {
    let mesh = Mesh {
        positions: vec![[0.1, -2., 1e-7], [1., 0.30000000000000004, 0.], [0., 1., 12345678.]],
        triangles: vec![[2, 0, 1]],
        ..Mesh::default()
    };
    let text =
        |mesh: &Mesh, width| String::from_utf8(written(MeshFormat::Obj, mesh, width)).unwrap();
    assert_eq!(
        text(&mesh, CoordinateWidth::F32),
        "v 0.1 -2 0.0000001\nv 1 0.3 0\nv 0 1 12345678\nf 3 1 2\n"
    );
    assert_eq!(
        text(&mesh, CoordinateWidth::F64),
        "v 0.1 -2 0.0000001\nv 1 0.30000000000000004 0\nv 0 1 12345678\nf 3 1 2\n"
    );
    let mesh = Mesh { normals: Some(vec![[0., 0.6, -0.8]; 3]), ..mesh };
    let text = text(&mesh, CoordinateWidth::F32);
    assert!(text.ends_with("vn 0 0.6 -0.8\nf 3//3 1//1 2//2\n"), "{text}");
}

#[test]
fn obj_files_of_other_programs_are_read() {
    let text = b"# made elsewhere\r\nmtllib a.mtl\no \xe9t\xe9\n\n  v 0 0 0\nv 1 0 0 0.5\nv 1 1 0 # colour\nv\t0 1 0\n\
                vt 0 0\nvn 0 0 1\ns off\nusemtl m\nf 1/1/1 2/1/1 3/1/1 4/1/1\nf -4 -3 -2 # back\nf 1/1 2/1 4/1\nl 1 2";
    let mesh = MeshFormat::Obj.read(text).unwrap();
    assert_eq!(mesh.positions, [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]]);
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 1, 3]]);
    // All corners share one normal, so the file has no vertex normals.
    assert_eq!(mesh.normals, None);
    // The file has vertex normals only if the vertex and the normal of every corner have the same
    // index.
    let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvn 0 1 0\nvn 1 0 0\n";
    let normals =
        |face| MeshFormat::Obj.read(format!("{triangle}{face}").as_bytes()).unwrap().normals;
    assert_eq!(normals("f 1//1 2//3 3//2"), None);
    assert_eq!(normals("f 1//1 2//2 3//3"), Some(vec![[0., 0., 1.], [0., 1., 0.], [1., 0., 0.]]));
}

#[test]
fn invalid_obj_lines_are_reported_with_their_number() {
    let fault = |tail: &str| {
        let text = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{tail}\n");
        MeshFormat::Obj.read(text.as_bytes()).unwrap_err().to_string()
    };
    for (tail, expected) in [
        ("v 1 2", "line 4: expected a number, found the end of the line"),
        ("v 1 2 x", "line 4: expected a number, found \"x\""),
        ("f 1 2", "line 4: a face has 2 corners, expected 3 or more"),
        ("f 1 2 4", "line 4: vertex 4 is not defined: only 3 are defined so far"),
        ("f 1 2 0", "line 4: vertex 0 is not defined: only 3 are defined so far"),
        ("f 1 2 -4", "line 4: vertex -4 is not defined: only 3 are defined so far"),
        (
            "f 1 2 9223372036854775808",
            "line 4: \"9223372036854775808\" is not the number of a vertex",
        ),
        (
            "f 1 2 -9223372036854775808",
            "line 4: vertex -9223372036854775808 is not defined: only 3 are defined so far",
        ),
        ("f 1//1 2//1 3//1", "line 4: normal 1 is not defined: only 0 are defined so far"),
        ("f 1 /2 3", "line 4: \"\" is not the number of a vertex"),
        ("\nhello", "line 5: \"hello\" does not begin a valid .obj line"),
    ] {
        assert_eq!(fault(tail), expected);
    }
}

#[test]
fn an_stl_file_has_the_bytes_of_the_format() {
    let mesh = Mesh {
        positions: vec![[0., 0., 0.], [2., 0., 0.], [0., 0., -2.]],
        triangles: vec![[0, 1, 2]],
        ..Mesh::default()
    };
    let bytes = written(MeshFormat::Stl, &mesh, CoordinateWidth::F64);
    assert_eq!(bytes.len(), 84 + 50);
    assert!(!bytes.to_ascii_lowercase().starts_with(b"solid"));
    assert_eq!(bytes[80..84], [1, 0, 0, 0]);
    let numbers = [0_f32, 1., 0., 0., 0., 0., 2., 0., 0., 0., 0., -2.];
    let found = bytes[84..132].as_chunks().0.iter().map(|&number| f32::from_le_bytes(number));
    assert_eq!(found.collect::<Vec<_>>(), numbers);
    assert_eq!(bytes[132..], [0, 0]);
}

#[test]
fn stl_corners_are_merged_only_if_bitwise_equal() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    let read = |mesh: &Mesh| {
        MeshFormat::Stl.read(&written(MeshFormat::Stl, mesh, CoordinateWidth::F32)).unwrap()
    };
    assert_eq!(read(&mesh).positions.len(), 8);
    mesh.positions.push([f64::from(f32::EPSILON) / 64., 0., 0.]);
    mesh.triangles[0] = mesh.triangles[0].map(|v| if v == 0 { 8 } else { v });
    assert_eq!(read(&mesh).positions.len(), 9);
}

#[test]
fn stl_files_of_other_programs_are_read() {
    let text = "solid a cube\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   vertex 1e0 0 0\n\
                VERTEX 0 .5 0\n  endloop\n endfacet\r\nendsolid a cube\nsolid\nendsolid\n";
    let mesh = MeshFormat::Stl.read(text.as_bytes()).unwrap();
    assert_eq!(mesh.positions, [[0., 0., 0.], [1., 0., 0.], [0., 0.5, 0.]]);
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    // A binary file may begin with "solid ", like a text file.
    let mut binary = written(MeshFormat::Stl, &mesh, CoordinateWidth::F32);
    binary[..6].copy_from_slice(b"solid ");
    assert_eq!(MeshFormat::Stl.read(&binary).unwrap(), mesh);

    for (wrong, right) in [
        ("", "VERTEX 0 .5 0\n"),
        ("VERTEX 0 .5 0\nvertex 1 1 1\n", "VERTEX 0 .5 0\n"),
        ("endsolid", "  endloop\n endfacet\r\nendsolid"),
        ("", "endsolid\n"),
    ] {
        let at = text.rfind(right).unwrap();
        let damaged = format!("{}{wrong}{}", &text[..at], &text[at + right.len()..]);
        let fault = MeshFormat::Stl.read(damaged.as_bytes()).unwrap_err();
        assert!(matches!(fault, ReadFault::Line { .. }), "{fault}");
    }
}

#[test]
fn extra_stl_bytes_after_the_last_triangle_are_refused() {
    let mut bytes = written(MeshFormat::Stl, &cuboid([0.; 3], [1.; 3]), CoordinateWidth::F32);
    bytes.push(0);
    assert!(matches!(MeshFormat::Stl.read(&bytes), Err(ReadFault::Malformed { at: 684, .. })));
    bytes[80..84].fill(0xff);
    assert!(matches!(
        MeshFormat::Stl.read(&bytes),
        Err(ReadFault::Truncated { needed: 214_748_364_834, .. })
    ));
}

#[test]
fn a_vtp_header_lists_its_arrays_with_their_offsets() {
    let mut mesh = with_attributes(cuboid([0.; 3], [1.; 3]));
    mesh.attributes[1].name = "a \"<b>\" & c\n\u{1}".to_owned();
    let bytes = written(MeshFormat::Vtp, &mesh, CoordinateWidth::F64);
    let end = bytes.windows(2).position(|two| two == b"\n_").unwrap();
    let expected = "<?xml version=\"1.0\"?>\n\
        <VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
        <PolyData>\n\
        <Piece NumberOfPoints=\"8\" NumberOfVerts=\"0\" NumberOfLines=\"0\" NumberOfStrips=\"0\" NumberOfPolys=\"12\">\n\
        <PointData Normals=\"Normals\" Vectors=\"velocity\">\n\
        <DataArray type=\"Float32\" Name=\"Normals\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/>\n\
        <DataArray type=\"Float32\" Name=\"velocity\" NumberOfComponents=\"3\" format=\"appended\" offset=\"104\"/>\n\
        <DataArray type=\"Float32\" Name=\"a &quot;&lt;b&gt;&quot; &amp; c&#10;\u{fffd}\" \
        NumberOfComponents=\"1\" format=\"appended\" offset=\"208\"/>\n\
        </PointData>\n\
        <Points>\n\
        <DataArray type=\"Float64\" Name=\"Points\" NumberOfComponents=\"3\" format=\"appended\" offset=\"248\"/>\n\
        </Points>\n\
        <Polys>\n\
        <DataArray type=\"Int32\" Name=\"connectivity\" NumberOfComponents=\"1\" format=\"appended\" offset=\"448\"/>\n\
        <DataArray type=\"Int32\" Name=\"offsets\" NumberOfComponents=\"1\" format=\"appended\" offset=\"600\"/>\n\
        </Polys>\n\
        </Piece>\n\
        </PolyData>\n\
        <AppendedData encoding=\"raw\">";
    assert_eq!(std::str::from_utf8(&bytes[..end]).unwrap(), expected);
    let offsets = &bytes[end + 2 + 600..];
    assert_eq!(offsets[..8], 48_u64.to_le_bytes());
    assert_eq!(offsets[8..16], [3, 0, 0, 0, 6, 0, 0, 0]);
    assert_eq!(&offsets[56..], b"\n</AppendedData>\n</VTKFile>\n");
    let read = MeshFormat::Vtp.read(&bytes).unwrap();
    assert_eq!(read.attributes[1].name, "a \"<b>\" & c\n\u{fffd}");
}

const VTP_TEXT: &str = r#"<VTKFile type="PolyData" byte_order="BigEndian"><PolyData>
<FieldData><DataArray type="String" Name="note" format="ascii">65 0</DataArray></FieldData>
<Piece NumberOfPoints="4" NumberOfVerts="1" NumberOfPolys="2">
<PointData Normals="N">
<DataArray type="Float64" Name="N" NumberOfComponents="3" format="ascii"> 0 0 1 0 0 1 0 0 1 0 0 1 </DataArray>
<DataArray type="Int64" Name="id" format="ascii">7 8 9 10</DataArray>
</PointData>
<CellData><DataArray type="Int64" Name="cell" format="binary">AAAA</DataArray></CellData>
<Points><DataArray type="Float32" NumberOfComponents="3" format="ascii">0 0 0 1 0 0 1 1 0 0 1 0</DataArray></Points>
<Verts><DataArray type="Int64" Name="offsets" format="ascii">1</DataArray></Verts>
<Polys>
<DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3 3 2 0</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">4
7</DataArray>
</Polys></Piece></PolyData></VTKFile>"#;

#[test]
fn vtp_files_with_text_arrays_of_other_programs_are_read() {
    let mesh = MeshFormat::Vtp.read(VTP_TEXT.as_bytes()).unwrap();
    assert_eq!(mesh.positions, [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]]);
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [3, 2, 0]]);
    assert_eq!(mesh.normals, Some(vec![[0., 0., 1.]; 4]));
    let id = VertexAttribute::new("id", 1, vec![7., 8., 9., 10.]);
    assert_eq!(mesh.attributes, [id]);
}

#[test]
fn big_endian_vtp_data_with_32_bit_lengths_is_read() {
    let mut bytes = br#"<VTKFile type="PolyData" byte_order="BigEndian" header_type="UInt32"><PolyData>
        <Piece NumberOfPoints="3" NumberOfPolys="1">
        <Points><DataArray type="Float32" NumberOfComponents="3" format="appended" offset="0"/></Points>
        <Polys><DataArray type="UInt8" Name="connectivity" format="appended" offset="40"/>
        <DataArray type="Int16" Name="offsets" format="appended" offset="47"/></Polys>
        </Piece></PolyData><AppendedData encoding="raw"> _"#
        .to_vec();
    bytes.extend(36_u32.to_be_bytes());
    let points = [[0_f32, 0., 0.], [1., 0., 0.], [0., 1., 0.5]];
    bytes.extend(points.as_flattened().iter().flat_map(|x| x.to_be_bytes()));
    bytes.extend([0, 0, 0, 3, 2, 0, 1, 0, 0, 0, 2, 0, 3]);
    bytes.extend(b"</AppendedData></VTKFile>");
    let mesh = MeshFormat::Vtp.read(&bytes).unwrap();
    assert_eq!((mesh.positions[2], &mesh.triangles[..]), ([0., 1., 0.5], &[[2, 0, 1]][..]));
}

#[test]
fn invalid_vtp_files_are_refused_with_the_reason() {
    for (right, wrong, expected) in [
        ("PolyData\" ", "UnstructuredGrid\" ", "UnstructuredGrid"),
        ("BigEndian\"", "BigEndian\" compressor=\"vtkOtherDataCompressor\"", "vtkOther"),
        (
            "Name=\"id\" format=\"ascii\"",
            "Name=\"id\" format=\"hex\"",
            "array id has the unknown format \"hex\"",
        ),
        (
            "Name=\"id\" format=\"ascii\"",
            "Name=\"id\" format=\"binary\"",
            "array id: Invalid input length",
        ),
        ("NumberOfVerts", "NumberOfStrips", "triangle strips"),
        ("<Piece", "<Piece NumberOfPoints=\"0\"/><Piece", "2 pieces"),
        ("7 8 9 10", "7 8 9", "array id must have 1 numbers for each of 4 points"),
        ("4\n7", "4\n8", "the range of corners 4 to 8 of polygon 1 is invalid"),
        ("4\n7", "4\n3", "the range of corners 4 to 3 of polygon 1 is invalid"),
        ("4\n7", "7", "2 polygons are announced, but 1 have offsets"),
        ("2 3 3", "2 4 3", "face 0 refers to vertex 4, but the file has 4"),
        ("<Points>", "<Other>", "expected `</Other>`"),
        ("NumberOfPoints=\"4\"", "NumberOfPoints=\"many\"", "is not a valid number: \"many\""),
        (VTP_TEXT, "<html></html>", "without </VTKFile>"),
        (VTP_TEXT, "<a></a><!-- </VTKFile>", "at byte"),
        (
            "Name=\"id\" format=\"ascii\"",
            "Name=\"id\" format=\"appended\" offset=\"0\"",
            "no <AppendedData>",
        ),
    ] {
        assert!(VTP_TEXT.contains(right));
        let fault =
            MeshFormat::Vtp.read(VTP_TEXT.replacen(right, wrong, 1).as_bytes()).unwrap_err();
        assert!(fault.to_string().contains(expected), "{expected}: {fault}");
    }
}

#[test]
fn a_truncated_file_is_refused_at_every_length() {
    let mesh = with_attributes(cuboid([0.; 3], [1.; 3]));
    for format in [MeshFormat::Ply, MeshFormat::Vtp, MeshFormat::Stl] {
        let bytes = written(format, &mesh, CoordinateWidth::F32);
        let whole = bytes.trim_ascii_end().len();
        for length in 0..if format == MeshFormat::Stl { bytes.len() } else { whole } {
            assert!(
                format.read(&bytes[..length]).is_err(),
                "{format:?}, {length} of {} bytes",
                bytes.len()
            );
        }
    }
    for length in 0..VTP_TEXT.len() {
        assert!(MeshFormat::Vtp.read(&VTP_TEXT.as_bytes()[..length]).is_err(), "{length}");
    }
    // OBJ and legacy VTK do not store the length of the file, so a file that ends between two lines
    // or sections is valid.
    for format in [MeshFormat::Obj, MeshFormat::Vtk] {
        let bytes = written(format, &mesh, CoordinateWidth::F32);
        let readable =
            (0..bytes.len()).filter(|&length| format.read(&bytes[..length]).is_ok()).count();
        assert!(readable < bytes.len() / 2, "{format:?}, {readable} of {} prefixes", bytes.len());
    }
}

#[test]
fn a_flipped_byte_is_an_error_or_a_valid_mesh_but_never_a_panic() {
    let mesh = with_attributes(cuboid([0.; 3], [1.; 3]));
    let texts = [(MeshFormat::Vtp, VTP_TEXT.as_bytes().to_vec())];
    let files = FORMATS.map(|format| (format, written(format, &mesh, CoordinateWidth::F64)));
    for (format, mut bytes) in files.into_iter().chain(texts) {
        for at in 0..bytes.len() {
            for flip in [1, 0x80, 0xff, b'<'] {
                bytes[at] ^= flip;
                if let Ok(mesh) = format.read(&bytes) {
                    let vertices = mesh.positions.len();
                    assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < vertices));
                }
                bytes[at] ^= flip;
            }
        }
    }
}

#[test]
fn huge_vtp_counts_and_lengths_are_refused_without_allocating() {
    for count in ["1000000000000", "18446744073709551615"] {
        for right in ["NumberOfPoints=\"4\"", "NumberOfPolys=\"2\"", "NumberOfComponents=\"3\""] {
            let wrong = format!("{}\"{count}\"", right.split('"').next().unwrap());
            let fault =
                MeshFormat::Vtp.read(VTP_TEXT.replacen(right, &wrong, 1).as_bytes()).unwrap_err();
            assert!(
                matches!(fault, ReadFault::Malformed { .. } | ReadFault::Unsupported(_)),
                "{fault}"
            );
        }
    }
    let bytes = written(MeshFormat::Vtp, &cuboid([0.; 3], [1.; 3]), CoordinateWidth::F64);
    let data = bytes.windows(2).position(|two| two == b"\n_").unwrap() + 2;
    for length in [1 << 40, u64::MAX, u64::MAX - 7] {
        let mut damaged = bytes.clone();
        damaged[data..data + 8].copy_from_slice(&length.to_le_bytes());
        assert!(matches!(MeshFormat::Vtp.read(&damaged), Err(ReadFault::Truncated { .. })));
    }
}

#[test]
fn vtp_arrays_that_share_their_data_are_refused() {
    let bytes = written(MeshFormat::Vtp, &with_attributes(torus(20, 10)), CoordinateWidth::F32);
    let text = bytes.windows(12).position(|part| part == b"</PointData>").unwrap();
    let again =
        b"<DataArray type=\"Float32\" Name=\"x\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/>";
    let damaged = [&bytes[..text], &again.repeat(50), &bytes[text..]].concat();
    let fault = MeshFormat::Vtp.read(&damaged).unwrap_err().to_string();
    assert!(fault.contains("shares its data"), "{fault}");
}

#[test]
fn the_extension_selects_the_mesh_format_ignoring_case() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = cuboid([0.; 3], [1.; 3]);
    for (name, format) in ["a.ply", "a.OBJ", "a.b.Vtk", "a.vtp", ".x.stl"].into_iter().zip(FORMATS)
    {
        let path = folder.path().join(name);
        let output = MeshOutput::prepare(&path, Replace::Refuse).unwrap();
        assert_eq!(output.format(), format);
        let bytes = output.write(&mesh, CoordinateWidth::F32).unwrap();
        assert_eq!(bytes, fs::metadata(&path).unwrap().len());
        assert_eq!(soup(&read_mesh(&path).unwrap()), soup(&mesh));
    }
    assert_eq!(names(folder.path()), [".x.stl", "a.OBJ", "a.b.Vtk", "a.ply", "a.vtp"]);
    let packed = folder.path().join("a.ply.gz");
    fs::write(&packed, gzip(&fs::read(folder.path().join("a.ply")).unwrap())).unwrap();
    assert_eq!(soup(&read_mesh(&packed).unwrap()), soup(&mesh));
    for name in ["a.gltf", "ply", ".ply", "a.", "a.ply.gz"] {
        let path = folder.path().join(name);
        let fault = MeshOutput::prepare(&path, Replace::Allow).unwrap_err().fault;
        assert!(matches!(fault, WriteFault::UnknownExtension { .. }), "{name}: {fault}");
        let read = read_mesh(&path).map_err(|error| error.fault);
        assert!(path == packed || matches!(read, Err(ReadFault::UnknownExtension { .. })));
    }
}

#[test]
fn an_existing_file_is_replaced_only_on_request_and_atomically() {
    // Also test a folder in memory, which is below /dev although it is not a device.
    let shared = Path::new("/dev/shm").is_dir().then(|| tempfile::tempdir_in("/dev/shm").unwrap());
    for folder in shared.into_iter().chain([tempfile::tempdir().unwrap()]) {
        let path = folder.path().join("a.ply");
        fs::write(&path, "precious".repeat(1000)).unwrap();
        let refused = MeshOutput::prepare(&path, Replace::Refuse).unwrap_err();
        assert!(matches!(refused.fault, WriteFault::Exists), "{refused}");
        let output = MeshOutput::prepare(&path, Replace::Allow).unwrap();
        assert_eq!(names(folder.path()).len(), 2);
        assert_eq!(fs::read(&path).unwrap(), "precious".repeat(1000).as_bytes());
        drop(output);
        assert_eq!(names(folder.path()), ["a.ply"]);
        let output = MeshOutput::prepare(&path, Replace::Allow).unwrap();
        output.write(&cuboid([0.; 3], [1.; 3]), CoordinateWidth::F32).unwrap();
        assert_eq!(read_mesh(&path).unwrap().triangles.len(), 12);
        assert_eq!(names(folder.path()), ["a.ply"]);
    }
}

#[test]
fn a_file_that_appears_during_the_work_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    let output = MeshOutput::prepare(&path, Replace::Refuse).unwrap();
    fs::write(&path, "precious").unwrap();
    let fault = output.write(&cuboid([0.; 3], [1.; 3]), CoordinateWidth::F32).unwrap_err().fault;
    assert!(matches!(fault, WriteFault::Exists), "{fault}");
    assert_eq!(
        (names(folder.path()), fs::read(&path).unwrap()),
        (vec!["a.obj".to_owned()], b"precious".to_vec())
    );
}

#[test]
fn missing_folders_and_invalid_output_paths_are_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let kind = |path: &Path| match MeshOutput::prepare(path, Replace::Allow).unwrap_err().fault {
        WriteFault::Io(fault) => fault.kind(),
        other => panic!("{other}"),
    };
    assert_eq!(kind(&folder.path().join("none/a.ply")), io::ErrorKind::NotFound);
    fs::create_dir(folder.path().join("b.ply")).unwrap();
    assert_eq!(kind(&folder.path().join("b.ply")), io::ErrorKind::IsADirectory);
    fs::write(folder.path().join("file"), "").unwrap();
    let below_file =
        if cfg!(windows) { io::ErrorKind::NotFound } else { io::ErrorKind::NotADirectory };
    assert_eq!(kind(&folder.path().join("file/a.ply")), below_file);
    let long = "x".repeat(300) + ".ply";
    assert_eq!(kind(&folder.path().join(long)), io::ErrorKind::InvalidFilename);
    assert_eq!(names(folder.path()), ["b.ply", "file"]);
}

#[cfg(unix)]
#[test]
fn a_folder_removed_during_the_work_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("inner");
    fs::create_dir(&inner).unwrap();
    let output = MeshOutput::prepare(&inner.join("a.stl"), Replace::Refuse).unwrap();
    fs::remove_dir_all(&inner).unwrap();
    let fault = output.write(&cuboid([0.; 3], [1.; 3]), CoordinateWidth::F32).unwrap_err();
    assert!(
        matches!(fault.fault, WriteFault::Io(_)) && fault.path == inner.join("a.stl"),
        "{fault}"
    );
    assert!(names(folder.path()).is_empty());
}

#[cfg(unix)]
#[test]
fn a_write_that_exceeds_the_size_limit_leaves_no_file() {
    // Files may not exceed 8 blocks of 512 or 1024 bytes.
    let limit = "trap '' XFSZ; ulimit -f 8";
    alone_after(limit, "mesh_files::a_write_that_exceeds_the_size_limit_leaves_no_file", || {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.vtp");
        fs::write(&path, "precious").unwrap();
        let output = MeshOutput::prepare(&path, Replace::Allow).unwrap();
        let fault = output.write(&torus(200, 100), CoordinateWidth::F32).unwrap_err().fault;
        let is_too_large =
            matches!(&fault, WriteFault::Io(e) if e.kind() == io::ErrorKind::FileTooLarge);
        assert!(is_too_large, "{fault}");
        assert_eq!(fs::read(&path).unwrap(), b"precious");
        assert_eq!(names(folder.path()), ["a.vtp"]);
    });
}

#[cfg(unix)]
#[test]
fn an_output_has_the_default_permissions_of_a_new_file() {
    use std::os::unix::fs::MetadataExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let output = MeshOutput::prepare(&path, Replace::Refuse).unwrap();
    output.write(&Mesh::default(), CoordinateWidth::F32).unwrap();
    fs::write(folder.path().join("other"), "").unwrap();
    let mode = |name| fs::metadata(folder.path().join(name)).unwrap().mode();
    assert_eq!(mode("a.ply"), mode("other"));
}

#[cfg(unix)]
#[test]
fn overwriting_a_symlink_replaces_its_target_and_keeps_the_link() {
    let folder = tempfile::tempdir().unwrap();
    let (link, file) = (folder.path().join("link.ply"), folder.path().join("file.ply"));
    fs::write(&file, "old").unwrap();
    std::os::unix::fs::symlink("file.ply", &link).unwrap();
    assert!(MeshOutput::prepare(&link, Replace::Refuse).is_err());
    let output = MeshOutput::prepare(&link, Replace::Allow).unwrap();
    output.write(&cuboid([0.; 3], [1.; 3]), CoordinateWidth::F32).unwrap();
    assert!(link.symlink_metadata().unwrap().is_symlink());
    assert_eq!(read_mesh(&file).unwrap().positions.len(), 8);
}

#[cfg(unix)]
#[test]
fn pipes_and_devices_are_written_directly() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe.stl");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let mesh = sphere(1., 3);
    let output = MeshOutput::prepare(&pipe, Replace::Refuse).unwrap();
    let reader = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        fs::File::open(pipe).unwrap().read_to_end(&mut bytes).unwrap();
        bytes
    });
    let count = output.write(&mesh, CoordinateWidth::F32).unwrap();
    let bytes = reader.join().unwrap();
    assert_eq!(bytes, written(MeshFormat::Stl, &mesh, CoordinateWidth::F32));
    assert_eq!((count, names(folder.path())), (bytes.len() as u64, vec!["pipe.stl".to_owned()]));

    let null = MeshOutput::prepare(Path::new("/dev/null"), Replace::Refuse).unwrap();
    assert_eq!(null.format(), MeshFormat::Ply);
    null.write(&mesh, CoordinateWidth::F32).unwrap();
    let full = MeshOutput::prepare(Path::new("/dev/full"), Replace::Refuse).unwrap();
    let fault = full.write(&mesh, CoordinateWidth::F32).unwrap_err().fault;
    assert!(
        matches!(&fault, WriteFault::Io(e) if e.kind() == io::ErrorKind::StorageFull),
        "{fault}"
    );
}
