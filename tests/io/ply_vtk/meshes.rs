//! Tests of reading and writing meshes as .ply and legacy .vtk files.

use meniscus::internals::io::{CoordinateWidth, ReadFault, ply, vtk};
use meniscus::internals::particles::Particles;
use meniscus::internals::surface::mesh::{Mesh, VertexAttribute};

use super::{ENCODINGS, PLY, PlyBuilder, VTK, VtkBuilder, ply_with_face, some_mesh};

#[test]
fn a_real_mesh_is_read_as_closed() {
    let bytes = std::fs::read("tests/data/spot.ply").unwrap();
    assert!(ply::has_faces(bytes[..].into()).unwrap());
    let mesh = ply::read_mesh(&bytes).unwrap();
    assert_eq!((mesh.positions.len(), mesh.triangles.len()), (2930, 5856));
    let mut edges: Vec<_> =
        mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
    edges.sort_unstable();
    assert!(edges.windows(2).all(|pair| pair[0] != pair[1]));
    assert!(edges.iter().all(|&[a, b]| edges.binary_search(&[b, a]).is_ok()));
}

#[test]
fn polygons_are_split_into_fans_and_cells_without_area_are_ignored() {
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
            VtkBuilder::new(version, ascii, dataset)
                .line("POINTS 4 float")
                .data("float", &[1.0; 12])
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
            assert!(vtk::has_faces(file.bytes[..].into()).unwrap());
        }
        let typed = |types: [f64; 5]| {
            let cells =
                [1., 3., 2., 0., 1., 4., 0., 1., 2., 3., 3., 3., 2., 1., 4., 0., 1., 2., 3.];
            let file = points("4.2", "UNSTRUCTURED_GRID").line("CELLS 5 19").data("int", &cells);
            file.line("CELL_TYPES 5").data("int", &types).bytes
        };
        let mesh = vtk::read_mesh(&typed([1.0, 3.0, 9.0, 5.0, 6.0])).unwrap();
        assert_eq!(
            mesh.triangles,
            [[0, 1, 2], [0, 2, 3], [3, 2, 1], [0, 1, 2], [2, 1, 3]],
            "ascii {ascii}"
        );
        let mesh = vtk::read_mesh(&typed([1.0, 3.0, 8.0, 7.0, 4.0])).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 3], [0, 3, 2], [3, 2, 1]], "ascii {ascii}");
        assert!(!vtk::has_faces(typed([1.0, 3.0, 4.0, 2.0, 0.0])[..].into()).unwrap());
        let solid = typed([1.0, 3.0, 10.0, 5.0, 6.0]);
        assert!(vtk::has_faces(solid[..].into()).unwrap());
        assert!(matches!(vtk::read_mesh(&solid), Err(ReadFault::Unsupported(_))));
    }
}

#[test]
fn a_face_with_a_missing_vertex_is_refused_by_number() {
    for encoding in ENCODINGS {
        let good = ply_with_face(encoding);
        let bad = match encoding {
            "ascii" => String::from_utf8(good).unwrap().replace("3 0 1 2", "3 0 1 3").into_bytes(),
            "binary_little_endian" => [&good[..good.len() - 4], &3i32.to_le_bytes()].concat(),
            _ => [&good[..good.len() - 4], &(-1i32).to_be_bytes()].concat(),
        };
        let fault = ply::read_mesh(&bad).unwrap_err();
        assert!(matches!(fault, ReadFault::Malformed { .. }), "{encoding}: {fault}");
        assert!(fault.to_string().contains("face 0 refers to vertex"), "{encoding}: {fault}");
    }
    for ascii in [true, false] {
        let file = |cells: [f64; 8]| {
            let file = VtkBuilder::new("3.0", ascii, "POLYDATA")
                .line("POINTS 3 float")
                .data("float", &[1.0; 9]);
            vtk::read_mesh(&file.line("POLYGONS 2 8").data("int", &cells).bytes)
        };
        file([3., 0., 1., 2., 3., 0., 1., 2.]).unwrap();
        let fault = file([3., 0., 1., 2., 3., 0., 1., 3.]).unwrap_err();
        assert!(
            fault.to_string().contains("face 1 refers to vertex 3, but the file has 3"),
            "{fault}"
        );
        let fault = file([3., 0., 1., 2., -3., 0., 1., 2.]).unwrap_err();
        assert!(fault.to_string().contains("cell 1"), "{fault}");
        let fault = file([3., 0., 1., 2., 4., 0., 1., 2.]).unwrap_err();
        assert!(fault.to_string().contains("cell 1 of 2 ends beyond"), "{fault}");
    }
}

fn hollow(attributes: &[VertexAttribute]) -> Vec<VertexAttribute> {
    attributes
        .iter()
        .map(|attribute| VertexAttribute { values: Vec::new(), ..attribute.clone() })
        .collect()
}

fn rounded(mut mesh: Mesh) -> Mesh {
    mesh.positions.iter_mut().for_each(|p| *p = p.map(|c| f64::from(c as f32)));
    mesh
}

#[test]
fn a_written_mesh_reads_back_unchanged() {
    let whole = some_mesh();
    let bare = Mesh { normals: None, attributes: Vec::new(), ..whole.clone() };
    let scalar = Mesh { attributes: vec![whole.attributes[1].clone()], ..bare.clone() };
    let empty = Mesh::default();
    let loose = Mesh { triangles: Vec::new(), ..whole.clone() };
    let hollow = Mesh {
        normals: Some(Vec::new()),
        attributes: hollow(&whole.attributes),
        ..Mesh::default()
    };
    for mesh in [whole, bare, scalar, empty, loose, hollow] {
        for format in [PLY, VTK] {
            let double = format.written(&mesh, CoordinateWidth::F64);
            assert_eq!((format.read_mesh)(&double).unwrap(), mesh);
            let single = format.written(&mesh, CoordinateWidth::F32);
            assert_eq!((format.read_mesh)(&single).unwrap(), rounded(mesh.clone()));
            assert_eq!((format.has_faces)(single[..].into()).unwrap(), !mesh.triangles.is_empty());
            assert_eq!(format.particles(&double).unwrap().particles.len(), mesh.positions.len());
        }
    }
}

#[test]
fn unusual_attribute_names_cannot_break_a_header() {
    let names = [
        "a b",
        "x",
        "x",
        "nx",
        "end_header\n",
        "",
        "%20",
        "\u{e9}t\u{e9}",
        "METADATA",
        "NULL_ARRAY",
    ];
    let attributes =
        names.map(|name| VertexAttribute::new(name, 1, (0..6).map(|i| i as f32).collect()));
    let mesh = Mesh { attributes: attributes.to_vec(), ..some_mesh() };
    let read = ply::read_mesh(&PLY.written(&mesh, CoordinateWidth::F64)).unwrap();
    let found: Vec<_> = read.attributes.iter().map(|a| a.name.as_str()).collect();
    let altered = [
        "a_b",
        "x_",
        "x__",
        "nx_",
        "end_header_",
        "_",
        "%20",
        "\u{e9}t\u{e9}",
        "METADATA",
        "NULL_ARRAY",
    ];
    assert_eq!(found, altered);
    let read = vtk::read_mesh(&VTK.written(&mesh, CoordinateWidth::F64)).unwrap();
    let found: Vec<_> = read.attributes.iter().map(|a| a.name.as_str()).collect();
    assert_eq!(
        found,
        [
            "a b",
            "x",
            "x_",
            "nx",
            "end_header\n",
            "_",
            "%20",
            "\u{e9}t\u{e9}",
            "METADATA",
            "NULL_ARRAY"
        ]
    );
    assert_eq!((read.positions, read.normals), (mesh.positions, mesh.normals));
}

#[test]
fn written_ply_and_vtk_are_independent_of_the_number_of_threads() {
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

#[test]
fn vtk_normals_are_found_after_duplicate_arrays() {
    let values = [0.0, 0.0, 1.0, 0.0, 1.0, 0.0];
    for ascii in [true, false] {
        let points = || {
            VtkBuilder::new("3.0", ascii, "POLYDATA")
                .line("POINTS 2 float")
                .data("float", &[1.0; 6])
                .line("POINT_DATA 2")
        };
        let scalars = |file: VtkBuilder| {
            file.line("SCALARS a float 1").line("LOOKUP_TABLE default").data("float", &[7.0, 8.0])
        };
        let normals = |file: VtkBuilder, name: &str| {
            file.line(&format!("NORMALS {name} float")).data("float", &values)
        };
        let read = |file: VtkBuilder| vtk::read_mesh(&file.bytes).unwrap();
        let expected = Some(vec![[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]);
        let twice = read(normals(scalars(scalars(points())), "n"));
        assert_eq!((twice.normals, twice.attributes.len()), (expected.clone(), 1), "ascii {ascii}");
        let again = read(normals(normals(points(), "n"), "n"));
        assert_eq!((again.normals, again.attributes.len()), (expected, 0), "ascii {ascii}");
        let taken = read(normals(scalars(points()), "a"));
        assert_eq!((taken.normals, taken.attributes[0].values.len()), (None, 2), "ascii {ascii}");
    }
}
