//! Particles from legacy .vtk files.

use std::path::Path;

use meniscus::internals::io::bytes::{Unpacking, open_bytes};
use meniscus::internals::io::vtk;
use meniscus::internals::particles::Particles;

use super::{TWO_POSITIONS, VTK, VtkBuilder, attribute, attributes, dual, positions, splish, toolkit};

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
            assert!(!vtk::has_faces(file.bytes[..].into()).unwrap());
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
    let file = vtk::read_particles(open_bytes(path).unwrap(), Unpacking::in_memory()).unwrap();
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
