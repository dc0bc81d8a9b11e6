//! Tests of reading particles from .ply files.

use std::io::Write;

use meniscus::internals::io::bytes::{Unpacking, open_bytes};
use meniscus::internals::io::{ReadFault, ply};
use meniscus::internals::particles::{
    AttributeKind, Particles, attribute_called, velocity_attribute,
};
use tempfile::NamedTempFile;

use super::{
    ENCODINGS, PLY, PlyBuilder, TRIANGLE, attribute, attributes, ply_with_face, positions,
};

#[test]
fn ply_scalars_of_every_type_and_encoding_are_read_exactly() {
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
            properties.map(|(kind, _, value)| {
                (kind, if kind.contains("loat") { value * scale } else { value })
            })
        });
        let header = format!("element vertex 2\n{lines}");
        let file = PlyBuilder::new(encoding, &header).row(&rows[0]).row(&rows[1]).bytes;
        let file = PLY.particles(&file).unwrap();
        let at =
            |row: usize, name| rows[row][properties.iter().position(|p| p.1 == name).unwrap()].1;
        let wanted = [0, 1].map(|row| ["x", "y", "z"].map(|axis| at(row, axis)));
        assert_eq!(positions(&file), wanted, "{encoding}");
        for name in "a b c d e f g h i j k l m".split(' ') {
            let wanted = [0, 1].map(|row| at(row, name) as f32);
            assert_eq!(attribute(&file, name), wanted, "{encoding}: {name}");
        }
    }
}

#[test]
fn ply_properties_of_a_vector_become_one_attribute() {
    let spelled = [
        ["vx", "vy", "vz"],
        ["velocity_x", "velocity_y", "velocity_z"],
        ["vel_x", "vel_y", "vel_z"],
    ];
    for [a, b, c] in spelled {
        let names = ["x", "y", "z", c, "id", a, "nx", "ny", "b_0", "b_1", b, "nz", "c_0", "d_1"];
        let lines: String = names.iter().map(|name| format!("property float {name}\n")).collect();
        let row: Vec<_> = (0..names.len()).map(|i| ("float", i as f64)).collect();
        let file = PlyBuilder::new("binary_big_endian", &format!("element vertex 1\n{lines}"))
            .row(&row)
            .bytes;
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
fn separate_components_of_a_velocity_in_a_ply_are_also_a_vector() {
    for [x, y, z] in [["velx", "vely", "velz"], ["v_x", "v_y", "v_z"], ["velX", "velY", "velZ"]] {
        let names = ["x", "y", "z", z, "id", x, y];
        let lines: String = names.iter().map(|name| format!("property float {name}\n")).collect();
        let row: Vec<_> = (0..names.len()).map(|i| ("float", i as f64)).collect();
        let header = format!("element vertex 1\n{lines}");
        for encoding in ENCODINGS {
            let file = PLY.particles(&PlyBuilder::new(encoding, &header).row(&row).bytes).unwrap();
            let wanted = [(z, vec![3.0]), ("id", vec![4.0]), (x, vec![5.0]), (y, vec![6.0])];
            let wanted = wanted.into_iter().chain([("velocity", vec![5.0, 6.0, 3.0])]);
            let wanted = wanted.map(|(name, values)| (name.to_owned(), values.len(), values));
            assert_eq!(attributes(&file), wanted.collect::<Vec<_>>(), "{encoding} {x}");
        }
    }
}

/// A .ply with three points. A face with three corners is a triangle.
fn ply_with_faces(encoding: &'static str, faces: &[&[f64]]) -> Vec<u8> {
    let header = format!(
        "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\n",
        faces.len()
    );
    let mut file = PlyBuilder::new(encoding, &header);
    for axes in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
        file = file.row(&axes.map(|axis| ("float", axis)));
    }
    for corners in faces {
        let length = ("uchar", corners.len() as f64);
        let corners = corners.iter().map(|&corner| ("int", corner));
        file = file.row(&[length].into_iter().chain(corners).collect::<Vec<_>>());
    }
    file.bytes
}

#[test]
fn a_ply_whose_faces_have_no_area_contains_particles() {
    let (point, line, triangle): (&[f64], &[f64], &[f64]) = (&[1.0], &[0.0, 1.0], &[0.0, 1.0, 2.0]);
    let read = |bytes: &[u8]| {
        let mut written = NamedTempFile::new().unwrap();
        written.write_all(bytes).unwrap();
        let opened = open_bytes(written.path()).unwrap();
        let found = [opened.view(), bytes.into()].map(|bytes| ply::has_faces(bytes).unwrap());
        assert_eq!(found[0], found[1], "by position and in memory");
        (found[0], ply::read_particles(opened, Unpacking::in_memory()))
    };
    for encoding in ENCODINGS {
        for (faces, only_lines) in
            [([point, point, point], false), ([line, &[], line], true), ([point, line, &[]], false)]
        {
            let (has_faces, file) = read(&ply_with_faces(encoding, &faces));
            let file = file.unwrap();
            assert_eq!((has_faces, file.particles.len()), (false, 3), "{encoding} {faces:?}");
            assert_eq!(file.only_lines, only_lines, "{encoding} {faces:?}");
        }
        // With 40,000 points, the reader must find the triangle behind more one-point faces than it
        // reads at first.
        for points in [2, 40_000] {
            let faces = [vec![point; points], vec![triangle]].concat();
            let (has_faces, file) = read(&ply_with_faces(encoding, &faces));
            assert!(has_faces, "{encoding}");
            let count = faces.len() as u64;
            assert!(matches!(file, Err(ReadFault::Mesh { faces }) if faces == count), "{encoding}");
        }
    }
}

#[test]
fn other_ply_elements_are_skipped() {
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
        assert_eq!(
            ply::read_mesh(&file).unwrap().triangles,
            [[0, 0, 0]],
            "{encoding}: a line has no area"
        );
    }
}

#[test]
fn ply_headers_with_crlf_line_ends_are_read() {
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
fn ply_colour_channels_become_one_byte_or_float_attribute() {
    let xyz = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
    let bytes = AttributeKind::ByteColour;
    let floats = AttributeKind::Colour;
    let cases: [(&str, &[&str], Option<AttributeKind>); 6] = [
        ("uchar", &["red", "green", "blue"], Some(bytes)),
        ("uchar", &["alpha", "blue", "green", "red"], Some(bytes)),
        ("float", &["red", "green", "blue", "Alpha"], Some(floats)),
        ("uchar", &["diffuse_red", "diffuse_green", "diffuse_blue"], Some(bytes)),
        ("uchar", &["red", "green"], None),
        ("int", &["red", "green", "blue"], None),
    ];
    for (scalar, names, kind) in cases {
        let lines: String =
            names.iter().map(|name| format!("property {scalar} {name}\n")).collect();
        for encoding in ENCODINGS {
            let mut row = vec![("float", 1.0); 3];
            row.extend((0..names.len()).map(|i| (scalar, i as f64)));
            let file = PlyBuilder::new(encoding, &format!("{xyz}{lines}")).row(&row).bytes;
            let read = PLY.particles(&file).unwrap();
            let infos = read.particles.attributes();
            let Some(kind) = kind else {
                assert_eq!(infos.len(), names.len(), "{names:?}");
                continue;
            };
            assert_eq!((infos.len(), &*infos[0].name, infos[0].kind), (1, "color", kind));
            assert_eq!(attribute_called("red", infos), Some(0));
            let backwards = names[0] == "alpha";
            let expected = if backwards { &[3.0, 2.0, 1.0, 0.0] } else { &[0.0, 1.0, 2.0, 3.0] };
            assert_eq!(attribute(&read, "color"), expected[..names.len()], "{names:?} {encoding}");
        }
    }
}

#[test]
fn ply_vertex_lists_are_skipped_and_axis_names_ignore_case() {
    let header = "element vertex 2\nproperty list uchar int near\nproperty double X\n\
                  property float Z\nproperty double Y\nproperty int64 id\n\
                  property list ushort double weights\n";
    for encoding in ENCODINGS {
        let file = PlyBuilder::new(encoding, header)
            .row(&[
                ("uchar", 2.0),
                ("int", 7.0),
                ("int", 8.0),
                ("double", 1.5),
                ("float", 3.5),
                ("double", 2.5),
                ("long", 77.0),
                ("ushort", 1.0),
                ("double", 0.25),
            ])
            .row(&[
                ("uchar", 0.0),
                ("double", 4.5),
                ("float", 6.5),
                ("double", 5.5),
                ("long", 78.0),
                ("ushort", 0.0),
            ])
            .bytes;
        let read = PLY.particles(&file).unwrap();
        assert_eq!(positions(&read), [[1.5, 2.5, 3.5], [4.5, 5.5, 6.5]], "{encoding}");
        assert_eq!(attribute(&read, "id"), [77.0, 78.0], "{encoding}");
        assert_eq!(read.particles.attributes().len(), 1, "lists became attributes");
        for cut in 2..8 {
            assert!(PLY.particles(&file[..file.len() - cut]).is_err(), "{encoding} {cut}");
        }
    }
}

#[test]
fn invalid_ply_files_are_refused_with_the_reason() {
    let xyz = "property float x\nproperty float y\nproperty float z\n";
    let header = |lines: &str| format!("ply\nformat ascii 1.0\n{lines}end_header\n");
    let refused = [
        (
            header(&format!("element vertex 1\nproperty list char int n\n{xyz}")) + "-1 1 2 3 4\n",
            "has the length -1",
        ),
        (
            header(&format!("element vertex 1\nproperty list char int n\n{xyz}")) + "4 1 2 3 4\n",
            "line 9: expected a number, found the end of the line",
        ),
        (header("element vertex 0\nproperty float x\nproperty float y\n"), "no property `z`"),
        (header("element point 0\n"), "no element `vertex`"),
        (
            header(&format!("element vertex 1\n{xyz}")) + "1.25 2\n",
            "line 8: expected a number, found the end of the line",
        ),
        (
            header(&format!("element vertex 1\n{xyz}")) + "1 2 3 4\n",
            "line 8: the row has more values",
        ),
        (
            header(&format!("element vertex 1\n{xyz}")) + "\n1 two 3\n",
            "line 9: expected a number, found \"two\"",
        ),
        (header("element vertex -1\n"), "line 3: \"-1\" is not a count"),
        (header("property float x\n"), "line 3: a property precedes the first element"),
        (
            header("element vertex 1\nproperty quad x\n"),
            "line 4: \"property quad x\" is not a valid property",
        ),
        ("ply\nformat ascii 2.0\n".into(), "line 2"),
        ("ply\nformat text 1.0\n".into(), "line 2: format \"text\""),
        ("ply\nend_header\n".into(), "line 2: the header does not name a format"),
        ("plyer\n".into(), "line 1"),
    ];
    for (text, reason) in refused {
        let fault = PLY.particles(text.as_bytes()).expect_err(&text).to_string();
        assert!(fault.contains(reason), "{text}: {fault}");
    }
    let strips = header(&format!(
        "element vertex 0\n{xyz}element tristrips 1\nproperty list int int vertex_indices\n"
    ));
    assert!(matches!(ply::has_faces(strips.as_bytes().into()), Err(ReadFault::Unsupported(_))));
    let plain = header(&format!("element vertex 0\n{xyz}element face 1\nproperty int a\n"));
    assert!(matches!(ply::has_faces(plain.as_bytes().into()), Err(ReadFault::Malformed { .. })));
}
