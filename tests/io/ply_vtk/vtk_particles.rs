//! Tests of reading particles from legacy .vtk files.

use std::path::Path;

use meniscus::internals::io::bytes::{Unpacking, open_bytes};
use meniscus::internals::io::{ReadFault, UnreadPart, vtk};
use meniscus::internals::particles::{Particles, velocity_attribute};

use super::{
    TWO, TWO_POSITIONS, VTK, VtkBuilder, attribute, attributes, dual, positions, splish,
    stored_big, toolkit,
};

#[test]
fn vtk_files_of_every_program_are_read_exactly() {
    let v = vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    for ascii in [true, false] {
        type Wanted = Vec<(&'static str, Vec<f32>)>;
        let cases: [(VtkBuilder, Wanted); 3] = [
            (
                splish(ascii),
                vec![
                    ("id", vec![7., 8.]),
                    ("velocity", v.clone()),
                    ("mass density", vec![1000., 9.]),
                ],
            ),
            (dual(ascii), vec![("Idp", vec![7., 8.]), ("Vel", v.clone()), ("Type", vec![3., 3.])]),
            (
                toolkit(ascii),
                vec![
                    ("velocity", v.clone()),
                    ("gid", vec![1., 2.]),
                    ("density", vec![1000., 9.]),
                    ("ofCells", vec![5., 5.]),
                ],
            ),
        ];
        for (number, (file, wanted)) in cases.into_iter().enumerate() {
            let read = VTK.particles(&file.bytes).unwrap();
            let wanted: Vec<_> = wanted
                .into_iter()
                .map(|(name, values)| (name.to_owned(), values.len() / 2, values))
                .collect();
            let single = number == 2 && !ascii;
            let exact =
                TWO_POSITIONS.map(|p| p.map(|c| if single { f64::from(c as f32) } else { c }));
            assert_eq!(positions(&read), exact, "layout {number}, ascii {ascii}");
            assert_eq!(attributes(&read), wanted, "layout {number}, ascii {ascii}");
            assert!(!vtk::has_faces(file.bytes[..].into()).unwrap());
            assert!(vtk::read_mesh(&file.bytes).unwrap().triangles.is_empty());
        }
    }
}

#[test]
fn separate_components_of_a_velocity_in_a_vtk_are_also_a_vector() {
    for ascii in [true, false] {
        let mut file = VtkBuilder::new("3.0", ascii, "POLYDATA")
            .line("POINTS 2 double")
            .data("double", &TWO)
            .line("POINT_DATA 2");
        let arrays = [
            ("velocity_z", [5.0, 6.0]),
            ("rho", [7.0, 8.0]),
            ("velocity_x", [1.0, 2.0]),
            ("velocity_y", [3.0, 4.0]),
        ];
        for (name, values) in arrays {
            file = file.line(&format!("SCALARS {name} float 1"));
            file = file.line("LOOKUP_TABLE default").data("float", &values);
        }
        let read = VTK.particles(&file.bytes).unwrap();
        assert_eq!(velocity_attribute(read.particles.attributes()), Some(4));
        assert_eq!(attribute(&read, "velocity"), [1.0, 3.0, 5.0, 2.0, 4.0, 6.0]);
        assert_eq!(attribute(&read, "velocity_x"), [1.0, 2.0]);
    }
}

#[test]
fn vtk_arrays_of_every_type_are_read_exactly() {
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
        let mut file = VtkBuilder::new("4.2", ascii, "POLYDATA")
            .line("POINTS 1 float")
            .data("float", &[1.0; 3]);
        file = file.line("POINT_DATA 1").line(&format!("FIELD FieldData {}", kinds.len()));
        for (kind, value) in kinds {
            file = file.line(&format!("a_{kind} 1 1 {kind}")).data(kind, &[value]);
        }
        let file = VTK.particles(&file.bytes).unwrap();
        for (kind, value) in kinds {
            assert_eq!(
                attribute(&file, &format!("a_{kind}")),
                [value as f32],
                "{kind}, ascii {ascii}"
            );
        }
    }
}

#[test]
fn inconsistent_vtk_files_are_refused_with_the_reason() {
    let head = "# vtk DataFile Version 3.0\nt\nASCII\n";
    let points = format!("{head}DATASET POLYDATA\nPOINTS 1 float\n1 2 3\n");
    let refused = [
        (format!("{head}DATASET STRUCTURED_POINTS\n"), "DATASET STRUCTURED_POINTS"),
        (format!("{head}DATASET POLYDATA\n"), "without POINTS"),
        (format!("{points}POINT_DATA 2\n"), "line 7: POINT_DATA is for 2 points, but POINTS has 1"),
        (format!("{points}POINTS 1 float\n1 2 3\n"), "two sections POINTS"),
        (format!("{points}VECTORS v float\n1 2 3\n"), "line 7: an attribute must come after"),
        (format!("{points}POINT_DATA 1\nSCALARS a float\n1\n"), "has no LOOKUP_TABLE"),
        (
            format!("{points}POINT_DATA 1\nFIELD f 1\na 1 2 float\n1 2\n"),
            "a has 2 entries for 1 points",
        ),
        (format!("{points}POINT_DATA 1\nFIELD f 1\na 1 1 variant\n1\n"), "\"variant\""),
        (format!("{points}CELLS 1 2\n1 0\n"), "1 CELLS, but 0 CELL_TYPES"),
        (format!("{points}NONSENSE\n"), "line 7: \"NONSENSE\" is not a section"),
        (format!("{points}METADATA\nINFORMATION 0\n"), "does not end with an empty line"),
        ("# vtk DataFile Version x\n".into(), "line 1"),
        ("# vtk DataFile Version 3.0\nt\nTEXT\n".into(), "line 3: expected ASCII or BINARY"),
    ];
    for (text, reason) in refused {
        let fault = VTK.particles(text.as_bytes()).expect_err(&text).to_string();
        assert!(fault.contains(reason), "{text}: {fault}");
    }
    let bad = points.replace("1 2 3", "1 2x 3");
    assert!(
        VTK.particles(bad.as_bytes())
            .unwrap_err()
            .to_string()
            .contains("line 6: expected a number, found \"2x\"")
    );
}

#[test]
fn a_splishsplash_vtk_frame_matches_the_values_of_its_simulation() {
    let path = Path::new("tests/data/dambreak_small/ParticleData_Fluid_10.vtk");
    let file = vtk::read_particles(open_bytes(path).unwrap(), Unpacking::in_memory()).unwrap();
    let positions = positions(&file);
    assert_eq!(positions.len(), 8664);
    let fold = |pick: fn(f64, f64) -> f64| {
        positions
            .iter()
            .copied()
            .reduce(|a, b| [0, 1, 2].map(|axis| pick(a[axis], b[axis])))
            .unwrap()
    };
    assert_eq!(fold(f64::min), [-1.9498687982559204, 0.0397249311208725, -0.7047143578529358]);
    assert_eq!(fold(f64::max), [-0.18260399997234344, 1.037776231765747, 0.704704761505127]);
    let speed = |v: &[f32]| v.iter().map(|&c| f64::from(c) * f64::from(c)).sum::<f64>().sqrt();
    let fastest = attribute(&file, "velocity").chunks(3).map(speed).fold(0.0, f64::max);
    assert!((fastest - 7.032591819763184).abs() < 1e-6, "{fastest}");
    let mut ids = attribute(&file, "id");
    ids.sort_by(f32::total_cmp);
    assert!(ids.windows(2).all(|pair| pair[0] < pair[1]), "an id occurs twice");
    // Because of a bug, SPlisHSPlasH's exporter also writes the density under the name "pressure".
    assert_eq!(attribute(&file, "pressure"), attribute(&file, "density"));
    assert_eq!(file.particles.attributes().len(), 4);
}

/// A file with points along x and a vertex for each of `corners`. With `types`, the file is an
/// unstructured grid, and its cells have these types. `data` adds the lines after `CELL_DATA`.
pub(super) fn flagged(
    ascii: bool,
    version: &str,
    points: usize,
    corners: &[f64],
    types: Option<&[f64]>,
    data: impl FnOnce(VtkBuilder) -> VtkBuilder,
) -> VtkBuilder {
    let (set, keyword) = match types {
        Some(_) => ("UNSTRUCTURED_GRID", "CELLS"),
        None => ("POLYDATA", "VERTICES"),
    };
    let along_x: Vec<f64> = (0..points).flat_map(|i| [i as f64, 0.0, 0.0]).collect();
    let file = VtkBuilder::new(version, ascii, set).line(&format!("POINTS {points} double"));
    let file = file.data("double", &along_x).end();
    let cells = corners.len();
    let file = if version.starts_with('5') {
        let ends: Vec<f64> = (0..=cells).map(|end| end as f64).collect();
        file.line(&format!("{keyword} {} {cells}", cells + 1))
            .line("OFFSETS vtktypeint64")
            .data("vtktypeint64", &ends)
            .line("CONNECTIVITY vtktypeint64")
            .data("vtktypeint64", corners)
    } else {
        let stream: Vec<f64> = corners.iter().flat_map(|&point| [1.0, point]).collect();
        file.line(&format!("{keyword} {cells} {}", 2 * cells)).data("int", &stream)
    };
    let file = match types {
        Some(types) => file.line(&format!("CELL_TYPES {}", types.len())).data("int", types),
        None => file,
    };
    data(file.end().line(&format!("CELL_DATA {cells}")).end()).end()
}

/// Adds flags of cells, as VTK writes them.
pub(super) fn field(file: VtkBuilder, name: &str, flags: &[f64]) -> VtkBuilder {
    let file =
        file.line("FIELD FieldData 1").line(&format!("{name} 1 {} unsigned_char", flags.len()));
    file.data("unsigned_char", flags)
}

/// The numbers of the points that are not ghosts.
fn left(bytes: &[u8]) -> Vec<usize> {
    let file = VTK.particles(bytes).expect("particles");
    positions(&file).iter().map(|position| position[0] as usize).collect()
}

#[test]
fn points_whose_vertices_are_all_ghosts_are_omitted() {
    let order = [5., 4., 3., 2., 1., 0.];
    let all: Vec<usize> = (0..6).collect();
    for (ascii, version) in [(true, "3.0"), (false, "3.0"), (true, "5.1"), (false, "5.1")] {
        for types in [None, Some(&[1.0; 6][..])] {
            let read = |corners: &[f64], name: &str, flags: &[f64]| {
                let types = types.map(|types| &types[..corners.len()]);
                left(
                    &flagged(ascii, version, 6, corners, types, |file| field(file, name, flags))
                        .bytes,
                )
            };
            for (name, flags, expected) in [
                ("vtkGhostType", [1., 0., 0., 8., 0., 32.], &[1, 3, 4][..]),
                ("vtkGhostType", [2., 4., 16., 0., 0., 0.], &all),
                ("vtkGhostLevels", [2., 1., 0., 0., 0., 0.], &[0, 1, 2, 3]),
                ("vtkGhostType", [1.; 6], &[]),
                ("other", [1.; 6], &all),
            ] {
                assert_eq!(
                    read(&order, name, &flags),
                    expected,
                    "{version}, ascii {ascii}: {name} {flags:?}"
                );
            }
            // A point with a flagged and an unflagged vertex is not a ghost, and neither is a point
            // without vertices.
            assert_eq!(
                read(&[0., 0., 1., 2., 2.], "vtkGhostType", &[1., 0., 1., 1., 1.]),
                [0, 3, 4, 5]
            );
            // SCALARS are also read as flags if they are single integers, but not if they are
            // floats or pairs.
            for (kind, components, expected) in
                [("int", 1, &[1, 3, 4][..]), ("float", 1, &all), ("int", 2, &all)]
            {
                let scalars = flagged(ascii, version, 6, &order, types, |file| {
                    let flags: Vec<f64> = [1., 0., 0., 8., 0., 32.]
                        .into_iter()
                        .flat_map(|f| vec![f; components])
                        .collect();
                    file.line(&format!("SCALARS vtkGhostType {kind} {components}"))
                        .line("LOOKUP_TABLE default")
                        .data(kind, &flags)
                });
                assert_eq!(left(&scalars.bytes), expected, "{components} {kind}");
            }
        }
    }
}

#[test]
fn flags_of_cells_other_than_vertices_omit_no_points() {
    let flags = |file: VtkBuilder, count: usize| field(file, "vtkGhostType", &vec![1.0; count]);
    let start = |ascii| {
        VtkBuilder::new("3.0", ascii, "POLYDATA").line("POINTS 2 double").data("double", &TWO)
    };
    for ascii in [true, false] {
        let vertices = |ascii| start(ascii).line("VERTICES 2 4").data("int", &[1., 0., 1., 1.]);
        let several =
            start(ascii).line("VERTICES 1 3").data("int", &[2., 0., 1.]).line("CELL_DATA 1");
        let lines =
            vertices(ascii).line("LINES 1 3").data("int", &[2., 0., 1.]).line("CELL_DATA 3");
        let twice = vertices(ascii).line("VERTICES 1 2").data("int", &[1., 0.]).line("CELL_DATA 3");
        let faces =
            vertices(ascii).line("POLYGONS 1 4").data("int", &[3., 0., 1., 0.]).line("CELL_DATA 3");
        let none = start(ascii).line("CELL_DATA 2");
        for (file, cells) in [(several, 1), (lines, 3), (twice, 3), (faces, 3), (none, 2)] {
            let file = VTK.particles(&flags(file, cells).bytes).unwrap();
            assert_eq!((positions(&file).len(), file.ghosts), (2, 0));
        }
        let types = [1., 1., 3., 1., 1., 1.];
        let file = flagged(ascii, "5.1", 6, &[0., 1., 2., 3., 4., 5.], Some(&types), |file| {
            flags(file, 6)
        });
        assert_eq!(left(&file.bytes).len(), 6);
    }
}

#[test]
fn vtk_cell_data_of_one_vertex_per_point_in_order_are_attributes() {
    let masses = [7., 5., 3., 2., 1., 0.];
    let (order, line) = ([0., 1., 2., 3., 4., 5.], [1., 1., 3., 1., 1., 1.]);
    for (ascii, version) in [(true, "3.0"), (false, "3.0"), (true, "5.1"), (false, "5.1")] {
        for types in [None, Some(&[1.0; 6][..]), Some(&line)] {
            let read = |corners: &[f64]| {
                let of = |file| field(file, "mass", &masses);
                VTK.particles(&flagged(ascii, version, 6, corners, types, of).bytes).unwrap()
            };
            let left_out = [UnreadPart::CellData("mass".into())];
            let (file, other) = (read(&order), read(&[1., 0., 2., 3., 4., 5.]));
            assert_eq!(other.left_out, left_out);
            if types == Some(&line) {
                assert_eq!(file.left_out, left_out);
            } else {
                assert_eq!(attribute(&file, "mass"), [7., 5., 3., 2., 1., 0.], "{version}");
                assert_eq!(file.left_out, []);
            }
        }
    }
}

#[test]
fn little_endian_positions_in_a_binary_vtk_are_refused() {
    for (kind, size) in [("float", 4), ("double", 8)] {
        for scale in [1.0, 0.1] {
            let mut values: Vec<f64> = (0..60).map(|i| f64::from(i - 20) * scale).collect();
            values[30] = 1e30;
            let file = |values: &[f64]| {
                let points = VtkBuilder::new("3.0", false, "POLYDATA").line("POINTS 20 X");
                let points = String::from_utf8(points.bytes).unwrap().replace('X', kind);
                let swap = |&value| stored_big(kind, value);
                (points.into_bytes(), values.iter().flat_map(swap).collect::<Vec<u8>>())
            };
            let (head, mut numbers) = file(&values);
            let read = |numbers: &[u8]| VTK.particles(&[&head[..], numbers].concat());
            assert_eq!(positions(&read(&numbers).unwrap()).len(), 20);
            numbers.chunks_exact_mut(size).for_each(<[u8]>::reverse);
            let fault = read(&numbers).unwrap_err();
            let what = fault.to_string();
            assert!(matches!(fault, ReadFault::Unsupported(_)), "{what}");
            assert!(what.contains("look little-endian"), "{what}");
            // Numbers that are invalid in both byte orders are not refused.
            let far: Vec<f64> = values.iter().map(|x| 1e20 * (x + 0.3)).collect();
            assert!(read(&file(&[f64::NAN; 60]).1).is_ok() && read(&file(&far).1).is_ok());
        }
    }
}

#[test]
fn flags_of_many_cells_are_read_in_chunks() {
    let count = 40_000;
    let corners: Vec<f64> = (0..count).rev().map(f64::from).collect();
    let flags: Vec<f64> = (0..count).map(|cell| f64::from(cell % 7 / 6)).collect();
    let expected: Vec<usize> =
        (0..count as usize).filter(|point| (count as usize - 1 - point) % 7 < 6).collect();
    for (ascii, version) in [(true, "3.0"), (false, "3.0"), (false, "5.1")] {
        let file = flagged(ascii, version, count as usize, &corners, None, |file| {
            field(file, "vtkGhostType", &flags)
        });
        assert_eq!(left(&file.bytes), expected, "{version}, ascii {ascii}");
    }
}

#[test]
fn inconsistent_cell_counts_are_refused() {
    let order = [5., 4., 3., 2., 1., 0.];
    for types in [None, Some(&[1.0; 6][..])] {
        for version in ["3.0", "5.1"] {
            let assert_refused =
                |corners: &[f64], flags: &[f64], from: &str, to: &str, message: &str| {
                    let file = flagged(true, version, 6, corners, types, |file| {
                        field(file, "vtkGhostType", flags)
                    });
                    let text = String::from_utf8(file.bytes).unwrap();
                    assert!(text.contains(from), "{text}");
                    let fault = VTK
                        .particles(text.replace(from, to).as_bytes())
                        .expect_err(message)
                        .to_string();
                    assert!(fault.contains(message), "{fault} instead of {message}");
                };
            let flags = [1.; 6];
            assert_refused(
                &[5., 4., 3., 2., 1., 6.],
                &flags,
                "",
                "",
                "cell 5 refers to point 6, but there are 6 cells",
            );
            assert_refused(
                &[5., 4., 3., 2., 1., -1.],
                &flags,
                "",
                "",
                "cell 5 refers to point -1, but there are 6 cells",
            );
            assert_refused(
                &order,
                &[1.; 5],
                "",
                "",
                "vtkGhostType must have one number for each of 6 cells",
            );
            let keyword = if types.is_some() { "CELLS" } else { "VERTICES" };
            match version {
                "5.1" => {
                    let [from, to] = [6, 5].map(|corners| format!("{keyword} 7 {corners}\n"));
                    let [long, short] = ["5 4 3 2 1 0\n", "5 4 3 2 1\n"];
                    let text = [(from, to), (long.to_owned(), short.to_owned())];
                    let file = flagged(true, version, 6, &order, types, |file| {
                        field(file, "vtkGhostType", &flags)
                    });
                    let file = text
                        .iter()
                        .fold(String::from_utf8(file.bytes).unwrap(), |file, (from, to)| {
                            file.replacen(from.as_str(), to, 1)
                        });
                    let fault = VTK.particles(file.as_bytes()).unwrap_err().to_string();
                    assert!(fault.contains("6 cells refer to 5 points"), "{fault}");
                }
                _ if types.is_none() => {
                    assert_refused(
                        &order,
                        &flags,
                        "VERTICES 6 12",
                        "VERTICES 7 12",
                        "7 vertex cells need two numbers each, but the file has 12",
                    );
                    let huge = "VERTICES 9223372036854775814 12";
                    assert_refused(
                        &order,
                        &flags,
                        "VERTICES 6 12",
                        huge,
                        "vertex cells need two numbers each, but the file has 12",
                    );
                }
                _ => assert_refused(
                    &order,
                    &flags,
                    "CELLS 6 12",
                    "CELLS 7 12",
                    "7 CELLS, but 6 CELL_TYPES",
                ),
            }
        }
    }
}
