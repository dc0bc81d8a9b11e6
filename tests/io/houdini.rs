//! Tests of Houdini geometries: points are read in every form and arrangement, and damaged files
//! give an error.

use std::path::Path;

use meniscus::files::{Info, Primitives, info};
use meniscus::internals::io::bytes::{Bytes, Unpacking, open_bytes};
use meniscus::internals::io::input;
use meniscus::internals::io::output::{MeshFormat, read_mesh};
use meniscus::internals::io::up::recorded_up;
use meniscus::internals::io::wanted::{WantedAttributes, WantedParticles};
use meniscus::internals::io::{
    CoordinateWidth, ParticleFile, ReadFault, UnreadPart, UpAxis, houdini,
};
use meniscus::internals::particles::sizes::SizeChoice;
use meniscus::internals::particles::{AttributeKind, Particles, RereadError};
use meniscus::internals::surface::mesh::up::TurnedMesh;
use meniscus::internals::surface::mesh::{Mesh, VertexAttribute};

use crate::build::houdini::{
    Codec, Container, Form, Layout, SIDES, STORAGES, Shuffle, Value, cloud, cubes, definition,
    geometry, keyed, numeric, primitive, strings, text,
};
use crate::build::{gzip, tuples};
use crate::common::particle_files::{attribute, positions};
use crate::common::shapes::sphere;
use crate::memory;

fn read(bytes: Vec<u8>) -> Result<ParticleFile, ReadFault> {
    houdini::read_particles(bytes.into(), WantedAttributes::All, Unpacking::in_memory())
}

/// Numbers that every storage type represents exactly. Points 1024 to 2047 have equal numbers.
fn numbers(points: usize, components: usize) -> Vec<f64> {
    let number = |point: usize, component: usize| match point {
        1024..2048 => component as f64,
        _ => ((7 * point + component) % 100) as f64,
    };
    (0..points).flat_map(|point| (0..components).map(move |c| number(point, c))).collect()
}

/// The text of a string attribute, for each particle.
fn texts(file: &ParticleFile, name: &str) -> Vec<String> {
    let labels = file.particles.labels();
    let index = labels.iter().position(|label| label.name == name).expect(name);
    let mut places = vec![0; file.particles.len()];
    file.particles.label(index, 0, &mut places);
    places.iter().map(|&place| labels[index].texts[place as usize].clone()).collect()
}

/// The attribute of positions, as f32 in pages of 1024 points.
fn position(points: usize) -> Value {
    let layout = Layout::Pages(1024, vec![3]);
    numeric("P", "fpreal32", 3, tuples(points).as_flattened(), &layout)
}

#[test]
fn every_storage_type_is_read_in_every_form_and_arrangement() {
    let mut files = 0;
    let layouts = |components: usize| {
        let pages = |size| move |packing| Layout::Pages(size, packing);
        let packings = match components {
            4 => vec![vec![4], vec![3, 1], vec![1; 4]],
            _ => vec![vec![components]],
        };
        let paged = [1024, 100].map(|size| packings.clone().into_iter().map(pages(size)));
        [Layout::Tuples, Layout::Arrays].into_iter().chain(paged.into_iter().flatten())
    };
    for form in Form::ALL {
        for (storage, ..) in STORAGES {
            for points in [0, 1, 1024, 1025, 2100] {
                // The file contains one attribute for each layout and each number of components.
                let mut attributes = vec![position(points)];
                let mut expected = Vec::new();
                for components in [1, 2, 4] {
                    for (number, layout) in layouts(components).enumerate() {
                        let name = format!("a{components}_{number}");
                        let values = numbers(points, components);
                        attributes.push(numeric(&name, storage, components, &values, &layout));
                        expected.push((name, values));
                    }
                }
                let document = cloud(points, attributes).document(form);
                for bytes in [document.clone(), Container::USUAL.pack(&document)] {
                    let file = read(bytes).unwrap_or_else(|fault| {
                        panic!("{form:?} {storage} {points}: {fault}");
                    });
                    assert_eq!(positions(&file), tuples(points));
                    assert_eq!(file.particles.attributes().len(), expected.len());
                    for (name, values) in &expected {
                        let values: Vec<f32> = values.iter().map(|&value| value as f32).collect();
                        assert!(attribute(&file, name) == values, "{form:?} {storage} {name}");
                    }
                    files += 1;
                }
            }
        }
    }
    assert_eq!(files, 4 * 9 * 5 * 2);
}

#[test]
fn separate_components_of_a_velocity_are_read_by_default() {
    let number = |name: &str, value: f64| {
        numeric(name, "fpreal32", 1, &[value; 5], &Layout::Pages(1024, vec![1]))
    };
    let numbers = [number("vz", 3.0), number("rho", 7.0), number("vx", 1.0), number("vy", 2.0)];
    let attributes: Vec<Value> = [position(5)].into_iter().chain(numbers).collect();
    let wanted =
        WantedAttributes::Only { names: None, conditions: &[], sizes: &SizeChoice::Ignored };
    for form in Form::ALL {
        let document = cloud(5, attributes.clone()).document(form);
        let file =
            houdini::read_particles(document.into(), wanted, Unpacking::in_memory()).unwrap();
        assert_eq!(
            attribute(&file, "velocity"),
            [[1.0_f32, 2.0, 3.0]; 5].as_flattened(),
            "{form:?}"
        );
        let unread: Vec<_> = file.unread.iter().map(|info| info.name.as_str()).collect();
        assert_eq!(unread, ["rho"], "{form:?}");
    }
}

#[test]
fn positions_of_every_storage_type_and_arrangement_are_read() {
    for form in Form::ALL {
        for storage in ["fpreal16", "fpreal32", "fpreal64"] {
            for (size, layout) in [
                (3, Layout::Tuples),
                (3, Layout::Arrays),
                (3, Layout::Pages(1024, vec![3])),
                (3, Layout::Pages(1024, vec![1, 1, 1])),
                (4, Layout::Pages(1024, vec![3, 1])),
                (4, Layout::Pages(512, vec![4])),
            ] {
                let values = numbers(2100, size);
                let expected: Vec<[f64; 3]> =
                    values.chunks(size).map(|p| [p[0], p[1], p[2]]).collect();
                let p = numeric("P", storage, size, &values, &layout);
                let file = read(cloud(2100, vec![p]).document(form)).unwrap();
                assert!(positions(&file) == expected, "{form:?} {storage} {layout:?}");
            }
        }
    }
}

#[test]
fn every_container_is_decompressed_in_memory_or_through_scratch_files() {
    let document = cloud(5000, vec![position(5000)]).document(Form::ALL[1]);
    let folder = tempfile::tempdir().unwrap();
    for codec in [Codec::Stored, Codec::Lz4, Codec::Zlib, Codec::Zstd] {
        for shuffle in [Shuffle::None, Shuffle::Bytes, Shuffle::Bits] {
            for type_size in [1, 2, 4, 7, 8, 24] {
                for split in [false, true] {
                    let chunk = 10_000;
                    let block = 256 * type_size;
                    let container = Container { codec, shuffle, type_size, chunk, block, split };
                    let packed = container.pack(&document);
                    for in_memory in [0, 30_000, 1 << 40] {
                        let unpacking =
                            Unpacking { in_memory, scratch: folder.path(), control: None };
                        let bytes = Bytes::from(packed.clone());
                        let file = houdini::read_particles(bytes, WantedAttributes::All, unpacking);
                        let file = file.unwrap_or_else(|fault| panic!("{container:?}: {fault}"));
                        assert!(positions(&file) == tuples(5000), "{container:?}");
                        let is_scratch = file.particles.scratch_bytes() > 0;
                        assert_eq!(is_scratch, in_memory < document.len() as u64);
                    }
                }
            }
        }
    }
}

#[test]
fn attribute_kinds_follow_from_names_and_storage_types() {
    let values = numbers(10, 3);
    let layout = Layout::Pages(1024, vec![3]);
    let one = Layout::Pages(1024, vec![1]);
    let attributes = vec![
        position(10),
        numeric("Cd", "fpreal32", 3, &vec![0.5; 30], &layout),
        numeric("v", "fpreal32", 3, &values, &layout),
        numeric("id", "int32", 1, &numbers(10, 1), &one),
        numeric("big", "int64", 1, &[(1_i64 << 52) as f64; 10], &one),
    ];
    for form in Form::ALL {
        let file = read(cloud(10, attributes.clone()).document(form)).unwrap();
        let kind = |name: &str| {
            let infos = file.particles.attributes();
            infos.iter().find(|info| info.name == name).expect(name).kind
        };
        assert!(kind("Cd").is_colour());
        assert_eq!(kind("v"), AttributeKind::Number);
        assert_eq!(kind("id"), AttributeKind::Signed);
        assert_eq!(kind("big"), AttributeKind::Wide);
    }
}

#[test]
fn string_attributes_become_labels_and_no_index_is_an_empty_string() {
    let known = ["water", "foam", "", "water"];
    let indices: Vec<f64> =
        (0..2100).map(|i| if i < 1100 { 1.0 } else { f64::from(i % 5) - 1.0 }).collect();
    let expected: Vec<&str> =
        indices.iter().map(|&index| if index < 0.0 { "" } else { known[index as usize] }).collect();
    for form in Form::ALL {
        for layout in [Layout::Arrays, Layout::Tuples, Layout::Pages(1024, vec![1])] {
            let names = strings("name", &known, &indices, &layout);
            let file = read(cloud(2100, vec![position(2100), names]).document(form)).unwrap();
            assert!(texts(&file, "name") == expected, "{form:?} {layout:?}");
            assert_eq!(positions(&file), tuples(2100));
        }
    }
    for beyond in [-2.0, 4.0, 1e6] {
        let indices = [0.0, beyond, 0.0];
        let names = strings("name", &known, &indices, &Layout::Pages(1024, vec![1]));
        let fault = read(cloud(3, vec![position(3), names]).document(Form::ALL[1])).unwrap_err();
        assert!(matches!(fault, ReadFault::Malformed { .. }), "{fault}");
    }
}

#[test]
fn unwanted_attributes_are_listed_but_not_read() {
    let layout = Layout::Pages(1024, vec![1]);
    let damaged = strings("path", &["a"], &[7.0; 10], &layout);
    let attributes = vec![
        position(10),
        numeric("age", "fpreal32", 1, &numbers(10, 1), &layout),
        numeric("v", "fpreal32", 3, &numbers(10, 3), &Layout::Tuples),
        damaged,
    ];
    let bytes = cloud(10, attributes).document(Form::ALL[1]);
    let wanted =
        WantedAttributes::Only { names: None, conditions: &[], sizes: &SizeChoice::Ignored };
    let file = houdini::read_particles(bytes.into(), wanted, Unpacking::in_memory()).unwrap();
    let names = |infos: &[meniscus::internals::particles::AttributeInfo]| -> Vec<String> {
        infos.iter().map(|info| info.name.clone()).collect()
    };
    assert_eq!(names(file.particles.attributes()), ["v"]);
    assert_eq!(names(&file.unread), ["age"]);
}

#[test]
fn points_of_primitives_are_omitted_and_counted_by_kind() {
    let polygons = primitive(
        "p_r",
        vec![
            ("s_v", Value::Integer(0)),
            ("n_p", Value::Integer(2)),
            ("r_v", Value::Numbers("uint8", vec![3.0, 2.0])),
        ],
    );
    let sphere = primitive("Sphere", vec![("vertex", Value::Integer(6))]);
    let particles = primitive("Part", vec![("vertex", Value::Numbers("int32", vec![7.0, 8.0]))]);
    let run = Value::List(vec![
        keyed(vec![("type", text("run")), ("runtype", text("Poly"))]),
        Value::List(vec![Value::List(vec![Value::Numbers("int32", vec![0.0, 1.0, 2.0])])]),
    ]);
    // Two triangles with the points 0 to 3, a sphere at point 5, and a particle system with the
    // points 6 and 8.
    let vertices = [0.0, 1.0, 2.0, 2.0, 1.0, 3.0, 5.0, 6.0, 8.0];
    let primitives = vec![polygons, sphere, particles.clone(), run];
    for form in Form::ALL {
        let whole = geometry(10, vec![position(10)], &vertices, primitives.clone());
        let file = read(whole.document(form)).unwrap();
        let all = tuples(10);
        assert_eq!(positions(&file), [all[4], all[6], all[7], all[8], all[9]]);
        let kinds = vec![("Sphere primitive".to_owned(), 1), ("polygon".to_owned(), 3)];
        let [UnreadPart::Primitives(Primitives { kinds: found, points: 5 })] = &file.left_out[..]
        else {
            panic!("{:?}", file.left_out);
        };
        let mut found = found.clone();
        found.sort();
        assert_eq!(found, kinds);
        // The points of a particle system are particles, even if it contains all points of the
        // file.
        let system = geometry(10, vec![position(10)], &vertices, vec![particles.clone()]);
        let file = read(system.document(form)).unwrap();
        assert_eq!((positions(&file), file.left_out.len()), (tuples(10), 0));
    }
}

#[test]
fn a_geometry_of_primitives_gives_an_error_with_a_remedy_by_kind() {
    let bound: Vec<f64> = (0..10).map(f64::from).collect();
    for (kind, name, node) in [
        ("p_r", "polygon", "Add SOP"),
        ("Tube", "Tube primitive", "Add SOP"),
        ("PackedGeometry", "PackedGeometry primitive", "Unpack SOP"),
        ("AlembicRef", "AlembicRef primitive", "Unpack SOP"),
        ("Volume", "volume", "Points from Volume SOP"),
        ("VDB", "VDB volume", "Points from Volume SOP"),
    ] {
        let all = primitive(kind, vec![("n_p", Value::Integer(4))]);
        let whole = geometry(10, vec![position(10)], &bound, vec![all]);
        let fault = read(whole.document(Form::ALL[0])).unwrap_err();
        let ReadFault::OnlyPrimitives(found) = &fault else { panic!("{fault}") };
        assert_eq!(*found, Primitives { kinds: vec![(name.to_owned(), 4)], points: 10 });
        assert!(found.remedy().contains(node), "{fault}");
    }
}

#[test]
fn array_attributes_are_skipped() {
    let lists = Value::List(vec![
        definition("lists", "arraynumeric"),
        keyed(vec![("sizerepeat", Value::Numbers("int32", vec![1.0, 2.0]))]),
    ]);
    for form in Form::ALL {
        let file = read(cloud(5, vec![lists.clone(), position(5)]).document(form)).unwrap();
        assert_eq!(positions(&file), tuples(5));
    }
}

#[test]
fn text_geometries_may_contain_nan_and_infinity() {
    let document = cloud(3, vec![numeric("P", "fpreal32", 3, &[1.0; 9], &Layout::Tuples)]);
    let document = String::from_utf8(document.document(Form::Text)).unwrap();
    let document = document.replacen("[1,1,1", "[nan,-inf,1e1", 1);
    let file = read(document.into_bytes()).unwrap();
    let [first, ..] = positions(&file)[..] else { panic!() };
    assert!(first[0].is_nan() && first[1] == f64::NEG_INFINITY && first[2] == 10.0);
}

#[test]
fn the_content_selects_the_houdini_form_not_the_extension() {
    let folder = tempfile::tempdir().unwrap();
    let document = |form: Form| cloud(7, vec![position(7)]).document(form);
    let binary = document(Form::ALL[1]);
    let forms = [
        document(Form::Text),
        binary.clone(),
        gzip(&binary),
        Container::USUAL.pack(&binary),
        gzip(&document(Form::Text)),
        crate::build::bgeo(&tuples(7)),
    ];
    for bytes in forms {
        for extension in ["bgeo", "geo", "bgeo.sc", "BGEO", "bgeo.gz", "bhclassic"] {
            let path = folder.path().join(format!("frame.{extension}"));
            std::fs::write(&path, &bytes).unwrap();
            let file =
                input::open_wanted(&path, WantedParticles::default(), Unpacking::in_memory());
            assert_eq!(positions(&file.unwrap()), tuples(7), "{extension}");
        }
    }
}

/// One small file of each form, with an attribute for each arrangement.
fn samples() -> Vec<Vec<u8>> {
    let mut files = Vec::new();
    for form in Form::ALL {
        let attributes = vec![
            position(7),
            numeric("a", "fpreal32", 4, &numbers(7, 4), &Layout::Pages(4, vec![3, 1])),
            numeric("c", "int32", 1, &[5.0; 7], &Layout::Pages(4, vec![1])),
            strings("name", &["x", "y"], &[0.0, 1.0, -1.0, 0.0, 0.0, 1.0, 1.0], &Layout::Arrays),
        ];
        let document = cloud(7, attributes).document(form);
        files.push(Container { chunk: 300, block: 128, ..Container::USUAL }.pack(&document));
        files.push(document);
    }
    files
}

#[test]
fn every_truncated_geometry_is_refused() {
    for (number, bytes) in samples().into_iter().enumerate() {
        for end in 1..bytes.len() {
            let cut = read(bytes[..end].to_vec());
            assert!(cut.is_err(), "file {number} cut at {end} of {}", bytes.len());
        }
    }
}

#[test]
fn flipped_bytes_never_add_particles_or_panic() {
    for bytes in samples() {
        for at in 0..bytes.len() {
            for flip in [0x01, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                if let Ok(file) = read(damaged) {
                    assert!(positions(&file).len() <= 7);
                }
            }
        }
    }
}

#[test]
fn counts_beyond_the_file_size_are_refused_without_allocating() {
    let mut cases = Vec::new();
    let pages = |size: i64, points: i64| {
        keyed(vec![
            ("size", Value::Integer(3)),
            ("storage", text("fpreal32")),
            ("pagesize", Value::Integer(size)),
            ("constantpageflags", Value::List(vec![Value::Bits(vec![true])])),
            ("rawpagedata", Value::Numbers("fpreal32", vec![0.0; 3])),
            ("points", Value::Integer(points)),
        ])
    };
    for (size, points) in
        [(i64::MAX, i64::MAX), (1 << 40, 1 << 40), (1 << 40, 1 << 50), (0, 5), (-1, 5)]
    {
        let p = keyed(vec![("values", pages(size, points))]);
        let p = Value::List(vec![definition("P", "numeric"), p]);
        cases.push(cloud(points as usize, vec![p]));
    }
    cases.push(cloud(usize::MAX >> 1, vec![position(7)]));
    cases.push(cloud(8, vec![position(7)]));
    for form in Form::ALL {
        for case in &cases {
            let bytes = case.document(form);
            let (result, largest) = memory::largest_allocation(|| read(bytes));
            let fault = result.expect_err("refused");
            assert!(largest < 1 << 20, "{largest} bytes: {fault}");
        }
    }
    // Use lengths that are far too large, in the binary form.
    for length in [vec![0xf4, 0xff, 0xff, 0xff, 0xff], [&[0xf8][..], &[0xff; 8]].concat()] {
        for kind in [0x27, 0x26, 0x40] {
            let mut bytes = b"\x7fNSJb\x5b".to_vec();
            bytes.push(kind);
            bytes.extend(if kind == 0x40 { vec![0x1a] } else { Vec::new() });
            bytes.extend(&length);
            let (result, largest) = memory::largest_allocation(|| read(bytes));
            assert!(result.is_err() && largest < 1 << 20);
        }
    }
    let packed = Container::USUAL.pack(&cloud(7, vec![position(7)]).document(Form::ALL[1]));
    let length = packed.len();
    // Damage the lengths of a container's metadata, header, chunks and index.
    for (at, bytes) in [
        (4, 8),
        (12 + 16 + 4, 4),
        (12 + 16 + 8, 4),
        (length - 28, 8),
        (length - 20, 8),
        (length - 12, 8),
    ] {
        let mut damaged = packed.clone();
        damaged[at..at + bytes].fill(0x7f);
        let (result, largest) = memory::largest_allocation(|| read(damaged));
        assert!(result.is_err() && largest < 1 << 20, "{at}: {largest}");
    }
}

#[test]
fn deeply_nested_lists_are_refused_without_a_stack_overflow() {
    for bytes in [b"[".repeat(1 << 20), [b"\x7fNSJb".to_vec(), vec![0x5b; 1 << 20]].concat()] {
        assert!(read(bytes).is_err());
    }
}

#[test]
fn a_geometry_truncated_while_open_is_reported_as_changed() {
    let folder = tempfile::tempdir().unwrap();
    for (number, bytes) in samples().into_iter().enumerate() {
        for left in (1..bytes.len()).step_by(37) {
            let path = folder.path().join(format!("{number}.{left}"));
            std::fs::write(&path, &bytes).unwrap();
            let opened = open_bytes(&path).unwrap();
            let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
            file.set_len(left as u64).unwrap();
            match houdini::read_particles(opened, WantedAttributes::All, Unpacking::in_memory()) {
                Err(ReadFault::Changed) => {}
                Ok(file) => assert_eq!(file.particles.check(), Err(RereadError::Changed)),
                Err(fault) => panic!("{number} cut to {left}: {fault}"),
            }
        }
    }
}

#[test]
fn files_that_are_not_point_geometries_are_refused_with_the_reason() {
    for (bytes, words) in [
        (&b"PGEOMETRY V5\nNPoints 3"[..], "classic"),
        (b"Point(1) = {0, 0, 0, 1.0};", "not a Houdini geometry"),
        (b"[1, 2, 3]", "key"),
    ] {
        let fault = read(bytes.to_vec()).unwrap_err().to_string();
        assert!(fault.contains(words), "{fault}");
    }
    let no_position = cloud(1, vec![numeric("v", "fpreal32", 3, &[0.0; 3], &Layout::Tuples)]);
    for form in Form::ALL {
        let fault = read(no_position.document(form)).unwrap_err();
        assert!(matches!(fault, ReadFault::Unsupported(_)), "{fault}");
    }
    let missing = input::open_particles(Path::new("none.bgeo.sc"), Unpacking::in_memory());
    assert!(matches!(missing.unwrap_err().fault, ReadFault::Io(_)));
}

#[test]
fn polygons_of_every_form_become_the_same_outward_triangles() {
    let expected: Vec<[u32; 3]> =
        SIDES.iter().flat_map(|&[a, b, c, d]| [[a, d, c], [a, c, b]]).collect();
    for (number, cube) in cubes().into_iter().enumerate() {
        for form in Form::ALL {
            let mesh = houdini::read_mesh(cube.document(form).into()).unwrap();
            assert_eq!(mesh.positions.len(), 8);
            assert_eq!(mesh.triangles, expected, "geometry {number} in {form:?}");
            let volume = meniscus::mesh::measure(&mesh).volume.unwrap();
            assert!((volume - 1.0).abs() < 1e-12, "{volume}");
            assert!(meniscus::mesh::check(&mesh).is_closed_oriented_manifold());
        }
    }
}

#[test]
fn meshes_are_read_from_every_container_and_extension() {
    let folder = tempfile::tempdir().unwrap();
    let cube = &cubes()[3];
    let [text, binary] = [Form::ALL[0], Form::ALL[1]].map(|form| cube.document(form));
    let packed = Container::USUAL.pack(&binary);
    for (name, bytes) in [
        ("a.geo", text),
        ("a.bgeo.gz", gzip(&binary)),
        ("a.bgeo", binary),
        ("a.bgeo.sc.gz", gzip(&packed)),
        ("A.BGEO.SC", packed),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(read_mesh(&path).unwrap().triangles.len(), 12, "{name}");
    }
    std::fs::write(folder.path().join("old.bgeo"), b"BgeoV\0\0\0\x05").unwrap();
    let fault = read_mesh(&folder.path().join("old.bgeo")).unwrap_err().fault;
    assert!(matches!(fault, ReadFault::Unsupported(_)), "{fault}");
}

#[test]
fn primitives_with_a_surface_that_is_not_polygonal_are_refused_by_name() {
    let bound: Vec<f64> = (0..10).map(f64::from).collect();
    let triangle = || {
        let vertex = Value::Numbers("int32", vec![0.0, 1.0, 2.0]);
        primitive("Poly", vec![("vertex", vertex), ("closed", Value::Bool(true))])
    };
    let other = |kind: &str| primitive(kind, vec![("vertex", Value::Integer(6))]);
    let mesh = |primitives| {
        let whole = geometry(10, vec![position(10)], &bound, primitives);
        houdini::read_mesh(whole.document(Form::ALL[1]).into())
    };
    for (kind, node) in [
        ("Sphere", "a Convert SOP"),
        ("PackedGeometry", "an Unpack SOP"),
        ("VDB", "a Convert VDB SOP"),
        ("PolySoup", "a Convert SOP"),
        ("NURBMesh", "a Convert SOP"),
    ] {
        let fault = mesh(vec![triangle(), other(kind)]).unwrap_err();
        let ReadFault::Unsupported(what) = &fault else { panic!("{fault}") };
        assert!(what.contains(&format!("1 {kind}")) && what.contains(node), "{what}");
    }
    // A closed curve is a filled face.
    let curve = |closed: bool| {
        let entries = vec![("vertex", Value::Integer(6)), ("closed", Value::Bool(closed))];
        primitive("NURBCurve", entries)
    };
    let fault = mesh(vec![triangle(), curve(true)]).unwrap_err();
    assert!(fault.to_string().contains("1 closed NURBCurve"), "{fault}");
    // Particle systems, curves and unused points have no surface.
    let particles = primitive("Part", vec![("vertex", Value::Numbers("int32", vec![7.0, 8.0]))]);
    let read = mesh(vec![triangle(), particles.clone(), curve(false)]).unwrap();
    assert_eq!((read.positions.len(), read.triangles), (10, vec![[0, 2, 1]]));
    // Without any polygon, the file is not a mesh.
    for primitives in [vec![], vec![particles], vec![curve(false)]] {
        let fault = mesh(primitives).unwrap_err();
        assert!(matches!(fault, ReadFault::Unsupported(_)), "{fault}");
    }
}

#[test]
fn polygons_that_do_not_fit_the_vertices_are_refused() {
    let integer = Value::Integer;
    let sized = |first: i64, count: i64, sizes: Value| {
        primitive("p_r", vec![("s_v", integer(first)), ("n_p", integer(count)), ("r_v", sizes)])
    };
    let run = |first: i64, count: i64, sizes: Vec<f64>| {
        sized(first, count, Value::Numbers("int64", sizes))
    };
    let huge = (1_u64 << 62) as f64;
    let lists = |lists: Vec<Value>| {
        primitive("Poly", lists.into_iter().map(|list| ("vertex", list)).collect())
    };
    let list = |corners: &[f64]| Value::Numbers("int64", corners.to_vec());
    let vertex = |vertex: f64| lists(vec![list(&[0.0, 1.0, vertex])]);
    let varying = |fields: &[&str]| {
        let fields = Value::List(fields.iter().map(|name| text(name)).collect());
        let kind =
            vec![("type", text("run")), ("runtype", text("Poly")), ("varyingfields", fields)];
        Value::List(vec![keyed(kind), Value::List(vec![Value::List(vec![])])])
    };
    let read = |primitives: Vec<Value>| {
        let whole = geometry(4, vec![position(4)], &[0.0, 1.0, 2.0, 3.0], primitives);
        houdini::read_mesh(whole.document(Form::ALL[1]).into())
    };
    let triangle = || run(1, 1, vec![3.0, 1.0]);
    assert_eq!(read(vec![triangle()]).unwrap().triangles, [[1, 3, 2]]);
    // A polygon without corners has no surface.
    let with_empty = run(1, 3, vec![0.0, 2.0, 3.0, 1.0]);
    assert_eq!(read(vec![with_empty]).unwrap().triangles, [[1, 3, 2]]);
    let mixed = Value::List(vec![integer(3), text("x"), integer(1)]);
    for (number, damaged) in [
        vec![run(2, 1, vec![3.0, 1.0])],
        vec![run(0, 2, vec![3.0, 1.0])],
        vec![run(0, i64::MAX, vec![3.0, huge])],
        vec![run(0, 1, vec![-3.0, 1.0])],
        vec![run(0, 1, vec![3.0])],
        vec![run(0, 1, vec![3.0, 1.0, 0.0])],
        vec![run(i64::MAX, 1, vec![3.0, 1.0])],
        vec![run(0, 100, vec![0.0; 200])],
        vec![sized(0, 1, mixed.clone())],
        vec![sized(0, 1, Value::Bits(vec![true; 2]))],
        // Every vertex belongs to one polygon.
        vec![triangle(), triangle()],
        vec![triangle(), vertex(0.0)],
        vec![vertex(4.0)],
        vec![vertex(-1.0)],
        vec![lists(vec![mixed])],
        vec![lists(vec![])],
        vec![lists(vec![list(&[0.0, 1.0]), list(&[2.0, 3.0])])],
        vec![varying(&[])],
        vec![varying(&["vertex", "vertex"])],
    ]
    .into_iter()
    .enumerate()
    {
        let (fault, largest) = memory::largest_allocation(|| read(damaged).unwrap_err());
        assert!(matches!(fault, ReadFault::Malformed { .. }), "{number}: {fault}");
        assert!(largest < 1 << 16, "{number}: {largest}");
    }
}

#[test]
fn a_geometry_with_a_part_twice_is_refused() {
    let whole = || geometry(4, vec![position(4)], &[0.0, 1.0, 2.0], Vec::new());
    for key in ["pointcount", "topology", "attributes", "primitives"] {
        let Value::List(mut parts) = whole() else { unreachable!() };
        let is_key = |part: &Value| matches!(part, Value::Text(text) if text == key);
        let at = parts.iter().position(is_key).expect(key);
        parts.extend([text(key), parts[at + 1].clone()]);
        let document = Value::List(parts).document(Form::ALL[1]);
        let mesh = houdini::read_mesh(document.clone().into()).map(|_| ());
        for fault in [mesh.unwrap_err(), read(document).map(|_| ()).unwrap_err()] {
            assert!(matches!(fault, ReadFault::Malformed { .. }), "{key}: {fault}");
        }
    }
}

#[test]
fn damaged_polygons_never_panic_and_never_add_triangles() {
    for cube in cubes() {
        for form in Form::ALL {
            let bytes = cube.document(form);
            for at in 0..bytes.len() {
                for flip in [0x01, 0x80, 0xff] {
                    let mut damaged = bytes.clone();
                    damaged[at] ^= flip;
                    if let Ok(mesh) = houdini::read_mesh(damaged.into()) {
                        // The 28 vertices are the corners of a single polygon at most.
                        assert!(mesh.triangles.len() <= 26, "byte {at}");
                    }
                }
                assert!(houdini::read_mesh(bytes[..at].to_vec().into()).is_err());
            }
        }
    }
}

/// A mesh larger than a chunk, with an attribute of each kind.
fn mesh_with_attributes() -> Mesh {
    let mut mesh = sphere(0.7, 6);
    let count = mesh.positions.len();
    let values = |size: usize| numbers(count, size).into_iter().map(|x| x as f32 / 100.0);
    mesh.normals =
        Some(values(3).collect::<Vec<_>>().chunks(3).map(|n| [n[0], n[1], n[2]]).collect());
    let whole = |name: &str, kind, whole: i64| {
        let whole = vec![whole; count];
        let values = whole.iter().map(|&whole| whole as f32).collect();
        VertexAttribute { kind, whole, ..VertexAttribute::new(name, 1, values) }
    };
    mesh.attributes = vec![
        VertexAttribute::new("velocity", 3, values(3).collect()),
        VertexAttribute::new("Cd", 4, values(4).collect()),
        whole("id", AttributeKind::Signed, -7),
        whole("flags", AttributeKind::Unsigned, 4_000_000_000),
        VertexAttribute::new("rest density", 1, values(1).collect()),
        VertexAttribute::new("P", 2, values(2).collect()),
        VertexAttribute {
            kind: AttributeKind::ByteColour,
            ..VertexAttribute::new("rgba", 4, (0..4 * count).map(|i| (i % 256) as f32).collect())
        },
    ];
    mesh
}

#[test]
fn a_written_bgeo_sc_contains_points_with_all_attributes() {
    let mesh = mesh_with_attributes();
    for width in [CoordinateWidth::F32, CoordinateWidth::F64] {
        let mut bytes = Vec::new();
        MeshFormat::BgeoSc.write(&mut bytes, &mesh, width).unwrap();
        let opened = Bytes::from(bytes.clone());
        let all = WantedAttributes::All;
        let file = houdini::read_points(opened, all, Unpacking::in_memory()).unwrap();
        let expected: Vec<[f64; 3]> = match width {
            CoordinateWidth::F64 => mesh.positions.clone(),
            CoordinateWidth::F32 => {
                mesh.positions.iter().map(|p| p.map(|x| f64::from(x as f32))).collect()
            }
        };
        assert!(positions(&file) == expected);
        let names: Vec<&str> = file.particles.attributes().iter().map(|a| &*a.name).collect();
        assert_eq!(names, ["N", "v", "Cd", "Alpha", "id", "flags", "rest_density", "P_", "rgba"]);
        assert!(attribute(&file, "N") == mesh.normals.clone().unwrap().as_flattened());
        assert!(attribute(&file, "v") == mesh.attributes[0].values);
        let colours = mesh.attributes[1].values.chunks(4);
        let (rgb, alpha): (Vec<_>, Vec<_>) = colours.map(|c| ([c[0], c[1], c[2]], c[3])).unzip();
        assert!(attribute(&file, "Cd") == rgb.as_flattened() && attribute(&file, "Alpha") == alpha);
        assert!(attribute(&file, "id").iter().all(|&id| id == -7.0));
        assert!(attribute(&file, "flags").iter().all(|&flags| flags == 4e9));
        assert!(attribute(&file, "rest_density") == mesh.attributes[4].values);
        let shares = mesh.attributes[6].values.iter().map(|byte| byte / 255.0);
        assert!(attribute(&file, "rgba") == shares.collect::<Vec<_>>());
        // A mesh is not read as particles.
        let fault = read(bytes.clone()).unwrap_err();
        let ReadFault::OnlyPrimitives(found) = &fault else { panic!("{fault}") };
        let kinds = vec![("polygon".to_owned(), mesh.triangles.len() as u64)];
        assert_eq!(*found, Primitives { kinds, points: mesh.positions.len() as u64 });
        // `info` describes such a file, also if it is compressed.
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in [("a.bgeo.sc", bytes.clone()), ("a.bgeo.sc.gz", gzip(&bytes))] {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            let Info::Geometry(info) = info(&path).unwrap() else { panic!("{name}") };
            assert_eq!((&info.file, &info.primitives), (&path, found));
            assert_eq!(info.attributes, file.particles.attributes());
            let [low, high] = info.bounds.unwrap();
            assert!(
                positions(&file).iter().all(|p| (0..3).all(|i| low[i] <= p[i] && p[i] <= high[i]))
            );
            // The mesh itself is read back.
            let read = read_mesh(&path).unwrap();
            assert!(read.triangles == mesh.triangles);
            assert!(read.positions == expected && read.normals == mesh.normals);
            assert!(read.attributes[0] == mesh.attributes[0]);
        }
    }
}

#[test]
fn a_written_bgeo_sc_is_independent_of_the_number_of_threads() {
    let mesh = mesh_with_attributes();
    let written = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut bytes = Vec::new();
        pool.install(|| {
            MeshFormat::BgeoSc.write(&mut bytes, &mesh, CoordinateWidth::F32).unwrap();
        });
        bytes
    };
    assert!(written(1) == written(3));
}

#[test]
fn the_up_axis_of_a_bgeo_sc_is_recorded_in_its_comment() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bgeo.sc");
    for (up, recorded) in [(UpAxis::Y, None), (UpAxis::Z, Some(UpAxis::Z))] {
        let mut bytes = Vec::new();
        let ball = sphere(1.0, 2);
        let mesh = TurnedMesh::new(&ball, up, up);
        MeshFormat::BgeoSc.write(&mut bytes, &mesh, CoordinateWidth::F32).unwrap();
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(recorded_up(&path), recorded);
    }
}

#[test]
fn an_empty_mesh_can_be_written_as_bgeo_sc() {
    let mut bytes = Vec::new();
    MeshFormat::BgeoSc.write(&mut bytes, &Mesh::default(), CoordinateWidth::F32).unwrap();
    assert!(read(bytes).unwrap().particles.is_empty());
}
