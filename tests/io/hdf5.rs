//! Tests of particles in HDF5 files that h5py wrote: valid files are read, and damaged files never
//! cause a panic.

use std::fs;
use std::path::{Path, PathBuf};

use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::input::{open_particles, open_wanted, steps};
use meniscus::internals::io::wanted::WantedParticles;
use meniscus::internals::io::{ParticleFile, ReadError, ReadFault, UnreadPart, h5};
use meniscus::internals::particles::Particles;
use meniscus::internals::particles::selection::SelectionFault;
use meniscus::{Error, Reconstruction, Warning};

use crate::common::files;
use crate::common::particle_files::{attribute, positions};
use crate::common::program::{command, run};

fn data(name: &str) -> PathBuf {
    files::data("h5").join(name)
}

fn open(name: &str) -> Result<ParticleFile, ReadError> {
    open_particles(&data(name), Unpacking::in_memory())
}

#[test]
fn an_h5part_step_is_a_frame_with_its_time_and_vector_columns() {
    assert_eq!(steps(&data("steps.h5part"), None).unwrap(), [0, 2, 10]);
    let [zero, two] = ["steps.h5part#0", "steps.h5part#2"].map(|name| open(name).unwrap());
    assert_eq!((zero.particles.len(), zero.time, two.time), (60, Some(0.0), Some(0.5)));
    let names: Vec<_> =
        two.particles.attributes().iter().map(|a| (&*a.name, a.components)).collect();
    assert_eq!(names, [("id", 1), ("v", 3)]);
    for (a, b) in positions(&zero).into_iter().zip(positions(&two)) {
        assert!((0..3).all(|axis| (b[axis] - a[axis] - 2.0).abs() < 1e-12));
    }
    let v: Vec<f32> = positions(&zero).into_iter().flatten().map(|x| x as f32).collect();
    assert_eq!(attribute(&two, "v"), v);
    assert_eq!(attribute(&two, "id")[59], 59.0);

    for (name, message) in [("steps.h5part", "steps 0 to 10"), ("steps.h5part#1", "no step 1")] {
        let error = open(name).unwrap_err();
        assert!(
            matches!(&error.fault, ReadFault::Unsupported(what) if what.contains(message)),
            "{error}"
        );
    }
}

#[test]
fn hdf5_with_two_coordinates_leads_to_advice_to_add_a_third() {
    // Rename the data set z, so that the third coordinate is missing.
    let mut bytes = fs::read(data("steps.h5part")).unwrap();
    let places: Vec<_> =
        (0..bytes.len()).filter(|&at| bytes[at..].starts_with(b"\0z\0\0\0\0\0\0\0")).collect();
    places.into_iter().for_each(|at| bytes[at + 1] = b'~');
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("plane.h5part"), bytes).unwrap();
    let error = open_particles(&folder.path().join("plane.h5part#0"), Unpacking::in_memory());
    let error = error.unwrap_err().to_string();
    assert!(error.contains("save zeros as z: np.zeros_like(y)"), "{error}");
}

#[test]
fn root_data_sets_are_a_frame_even_if_chunked_and_compressed() {
    let packed = open("packed.h5").unwrap();
    assert_eq!((packed.particles.len(), packed.time), (60, Some(1.5)));
    let names: Vec<_> =
        packed.particles.attributes().iter().map(|a| (&*a.name, a.components)).collect();
    assert_eq!(names, [("mass", 1), ("velocity", 3)]);
    let exact = positions(&open("steps.h5part#0").unwrap());
    assert!(exact.iter().zip(positions(&packed)).all(|(a, b)| a.map(|x| f64::from(x as f32)) == b));
    let doubled: Vec<f32> = exact.into_iter().flatten().map(|x| (2.0 * x) as f32).collect();
    assert_eq!(attribute(&packed, "velocity"), doubled);
    // A scratch file gives the same particles as memory.
    let folder = tempfile::tempdir().unwrap();
    let unpacking = Unpacking { in_memory: 0, scratch: folder.path(), control: None };
    assert_eq!(
        positions(&open_particles(&data("packed.h5"), unpacking).unwrap()),
        positions(&packed)
    );
}

fn open_where(name: &str, condition: &str) -> Result<ParticleFile, ReadError> {
    let conditions = [condition.parse().expect("a valid condition")];
    let wanted = WantedParticles { conditions: &conditions, ..WantedParticles::default() };
    open_wanted(&data(name), wanted, Unpacking::in_memory())
}

fn names(file: &ParticleFile) -> Vec<(&str, usize)> {
    file.particles.attributes().iter().map(|a| (&*a.name, a.components)).collect()
}

/// The points that all files contain, moved by `by` along each axis.
fn points(by: f64) -> Vec<[f64; 3]> {
    let exact = positions(&open("steps.h5part#0").unwrap());
    exact.into_iter().map(|point| point.map(|x| x + by)).collect()
}

#[test]
fn numeric_members_of_a_compound_table_are_read_as_columns() {
    let table = open("table.h5").unwrap();
    assert_eq!(names(&table), [("id", 1), ("velocity", 3)]);
    let expected: Vec<_> = points(0.0)
        .iter()
        .map(|&[x, y, z]| [f64::from(x as f32), y, f64::from(z as f32)])
        .collect();
    assert_eq!(positions(&table), expected);
    let doubled: Vec<f32> = points(0.0).as_flattened().iter().map(|x| (2.0 * x) as f32).collect();
    assert_eq!((attribute(&table, "velocity"), attribute(&table, "id")[59]), (doubled, 59.0));
}

#[test]
fn arrays_with_components_along_the_first_axis_are_read() {
    let columns = open("columns.h5").unwrap();
    assert_eq!((positions(&columns), columns.time), (points(0.0), Some(0.5)));
    // The array `X`, the reference configuration, must become an attribute and not the position.
    assert_eq!(names(&columns), [("X", 3), ("v", 3), ("C", 9)]);
    let doubled: Vec<f32> = points(0.0).as_flattened().iter().map(|x| (2.0 * x) as f32).collect();
    assert_eq!(attribute(&columns, "v"), doubled);
}

#[test]
fn h5md_frames_contain_only_the_present_particles_and_their_data() {
    assert_eq!(steps(&data("h5md.h5"), None).unwrap(), [0, 1, 2]);
    let [one, two] = ["h5md.h5#1", "h5md.h5#2"].map(|name| open(name).unwrap());
    assert_eq!((one.time, one.box_size), (Some(0.5), Some([1.0, 2.0, 3.0])));
    assert_eq!(positions(&two), points(2.0));
    let mut present = points(1.0);
    present.drain(7..9);
    assert_eq!(positions(&one), present);
    assert_eq!(names(&two), [("mass", 1), ("id", 1), ("velocity", 3)]);
    let error = open("h5md.h5#3").unwrap_err();
    assert!(matches!(error.fault, ReadFault::Unsupported(_)), "{error}");
}

#[test]
fn one_of_several_particle_groups_must_be_named() {
    assert_eq!(steps(&data("groups.h5"), None).unwrap(), [3, 20]);
    let open = |condition: &str| open_where("groups.h5#20", condition);
    let error = open("x>0").unwrap_err();
    assert!(
        matches!(&error.fault, ReadFault::Unsupported(what) if what.contains("sand, wall")),
        "{error}"
    );
    let sand = open("type=sand").unwrap();
    assert_eq!((positions(&sand), sand.time), (points(20.0), Some(5.0)));
    assert_eq!(sand.particle_types, ["sand", "wall"]);
    assert_eq!(open("type=ParticleTypes/wall").unwrap().particles.len(), 4);
    assert!(open("type=PartType0").is_err() && open("type=1").is_err());
}

#[test]
fn the_type_that_is_called_a_fluid_is_read_by_default() {
    for (name, fluid, other) in
        [("fluid.h5", "Fluid", "boundary"), ("species.h5", "fluid", "walls")]
    {
        let file = open(name).unwrap();
        assert_eq!(
            (positions(&file), &file.particle_types[..]),
            (points(0.0), &[fluid, other].map(String::from)[..])
        );
        assert_eq!(open_where(name, &format!("type={other}")).unwrap().particles.len(), 4);
    }
}

#[test]
fn a_gas_is_not_read_by_default_if_another_type_may_be_a_liquid() {
    for name in ["gas_groups.h5", "gas_pysph.hdf5", "gas_openpmd.h5"] {
        let error = open(name).unwrap_err();
        assert!(
            matches!(&error.fault, ReadFault::Unsupported(what) if what.contains("gas, liquid")),
            "{error}"
        );
        let liquid = open_where(name, "type=liquid").unwrap();
        assert_eq!(positions(&liquid), points(0.0), "{name}");
        assert_eq!(liquid.particle_types, ["liquid", "gas"], "{name}");
        assert_eq!(open_where(name, "type=gas").unwrap().particles.len(), 4, "{name}");
    }
}

#[test]
fn groups_of_the_root_that_are_called_by_numbers_are_frames() {
    assert_eq!(steps(&data("numbers.h5"), None).unwrap(), [9, 10, 11]);
    let ten = open("numbers.h5#10").unwrap();
    assert_eq!((positions(&ten), ten.time), (points(10.0), Some(2.5)));
    assert_eq!(ten.particle_types, ["fluid", "wall"]);
    for (name, message) in [("numbers.h5", "steps 9 to 11"), ("numbers.h5#8", "no step 8")] {
        let error = open(name).unwrap_err();
        assert!(
            matches!(&error.fault, ReadFault::Unsupported(what) if what.contains(message)),
            "{error}"
        );
    }
    // If the groups have different members, or if there is another group of particles, the numbers
    // may be types of particles, so the groups are not frames.
    for (name, types) in [("number_types.h5", "0, 1"), ("number_walls.h5", "0, 1, wall")] {
        assert!(steps(&data(name), None).unwrap().is_empty(), "{name}");
        let error = open(name).unwrap_err();
        assert!(
            matches!(&error.fault, ReadFault::Unsupported(what) if what.contains(types)),
            "{error}"
        );
    }
}

fn other_shape(name: &str, shape: &[u64]) -> UnreadPart {
    UnreadPart::OtherShape { name: name.into(), shape: shape.into(), particles: 60, frames: None }
}

#[test]
fn arrays_that_do_not_match_the_number_of_particles_are_named() {
    let file = open("shapes.h5").unwrap();
    assert_eq!(names(&file), [("mass", 1)]);
    assert_eq!(file.left_out, [other_shape("bounds", &[2, 3]), other_shape("vel", &[55, 3])]);
    let is_unexpected: Vec<_> = file.left_out.iter().map(UnreadPart::is_unexpected).collect();
    assert_eq!(is_unexpected, [false, true]);
    for (name, shape) in [
        ("gas_pysph.hdf5", other_shape("gradient", &[540])),
        ("gas_openpmd.h5", other_shape("mass", &[55])),
    ] {
        assert_eq!(open_where(name, "type=liquid").unwrap().left_out, [shape], "{name}");
    }
    for requested in ["vel", "velocity", "bounds"] {
        let request = Reconstruction::new().spacing(1.0).attributes([requested]);
        let error = request.run_file(data("shapes.h5")).unwrap_err();
        assert!(matches!(&error, Error::NoAttribute { left_out: Some(_), .. }), "{error}");
    }
}

#[test]
fn a_frame_with_an_array_of_another_length_gives_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    fs::copy(data("shapes.h5"), folder.path().join("shapes.h5")).unwrap();
    let arguments = ["reconstruct", "shapes.h5", "-o", "m.ply", "--spacing", "0.25"];
    let messages = run(folder.path(), &arguments, 0);
    let warning = "warning: meniscus left out array \"vel\"";
    assert_eq!(messages.matches(warning).count(), 1, "{messages}");
    assert!(!messages.contains("bounds"), "{messages}");
    let plan = [&arguments[..], &["--parts", "2", "--plan", "--overwrite"]].concat();
    let messages = run(folder.path(), &plan, 0);
    assert_eq!(messages.matches(warning).count(), 1, "{messages}");
    let surface = Reconstruction::new().spacing(0.25).run_file(data("shapes.h5")).unwrap();
    let left_out = |warning: &&Warning| matches!(warning, Warning::LeftOut(_));
    let left_out: Vec<_> = surface.report().warnings.iter().filter(left_out).collect();
    assert_eq!(left_out.len(), 1, "{left_out:?}");
    assert!(left_out[0].to_string().contains("\"vel\""), "{left_out:?}");
}

#[test]
fn messages_name_the_type_that_was_read_once_per_conversion() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["fluid.h5", "numbers.h5"] {
        fs::copy(data(name), folder.path().join(name)).unwrap();
    }
    let reconstruct = |input: &str, output: &str| {
        let arguments = ["reconstruct", input, "-o", output, "--spacing", "0.25"];
        run(folder.path(), &arguments, 0)
    };
    let messages = reconstruct("fluid.h5", "m.ply");
    let line = "fluid.h5: 60 particles, HDF5, type Fluid (not read: boundary)\n";
    assert!(messages.contains(line), "{messages}");
    let messages = reconstruct("numbers.h5", "m/");
    assert_eq!(messages.matches("type fluid (not read: wall)\n").count(), 1, "{messages}");
    assert_eq!(fs::read_dir(folder.path().join("m")).unwrap().filter(is_mesh).count(), 3);
}

fn is_mesh(entry: &std::io::Result<fs::DirEntry>) -> bool {
    entry.as_ref().is_ok_and(|entry| entry.path().extension().is_some_and(|end| end == "ply"))
}

#[test]
fn a_virtual_data_set_is_refused_by_its_name() {
    let error = open("virtual.h5").unwrap_err();
    let ReadFault::Unsupported(what) = &error.fault else { panic!("{error}") };
    assert!(what.contains("pos") && what.contains("virtual"), "{what}");
}

#[test]
fn a_type_is_a_group_or_else_a_value_of_the_attribute_of_that_name() {
    let open = |condition: &str| open_where("types.h5", condition);
    for (condition, group, count) in [
        ("x>-1", "PartType0", 60),
        ("type=wall", "wall", 60),
        ("type=1", "PartType0", 20),
        ("type=0,2", "PartType0", 40),
        ("type!=1", "PartType0", 40),
        ("type=wall and type=1", "wall", 20),
        ("type=2 and type=wall", "wall", 20),
    ] {
        let file = open(condition).unwrap();
        assert_eq!((&*file.particle_types[0], file.particles.len()), (group, count), "{condition}");
    }
    let none = open("type=3").unwrap();
    assert!(none.particles.is_empty() && none.none_selected.is_some());
    let error = open("type=sand and type=1").unwrap_err();
    assert!(
        matches!(&error.fault, ReadFault::Unsupported(what) if what.contains("PartType0, wall")),
        "{error}"
    );
    let error = open_where("groups.h5#20", "type=sand and type=1").unwrap_err();
    assert!(
        matches!(&error.fault, ReadFault::Selection(SelectionFault::Types { condition, known })
            if condition == "type=1" && *known == ["sand", "wall"]),
        "{error}"
    );
}

#[test]
fn an_array_with_too_many_numbers_per_particle_is_named() {
    let file = open("types.h5").unwrap();
    assert_eq!(names(&file), [("type", 1), ("gradient", 9)]);
    assert_eq!(attribute(&file, "gradient"), (0..540).map(|x| x as f32).collect::<Vec<_>>());
    let wide = UnreadPart::WideArray { name: "spectrum".into(), numbers: 100 };
    assert_eq!(file.left_out, [wide]);
    for (requested, is_left_out) in [("spectrum", true), ("heat", false)] {
        let request = Reconstruction::new().spacing(1.0).attributes([requested]);
        let error = request.run_file(data("types.h5")).unwrap_err();
        assert!(
            matches!(&error, Error::NoAttribute { name, left_out, .. }
                if name == requested && left_out.is_some() == is_left_out),
            "{error}"
        );
    }
}

#[test]
fn more_rows_than_the_file_can_contain_are_refused() {
    let error = open("huge.h5").unwrap_err();
    assert!(matches!(error.fault, ReadFault::Compression(_)), "{error}");
}

#[test]
fn damaged_hdf5_files_never_panic_and_truncation_never_changes_values() {
    for name in ["steps.h5part", "packed.h5", "table.h5", "columns.h5", "h5md.h5"] {
        let whole = fs::read(data(name)).unwrap();
        let read = |bytes: Vec<u8>| {
            h5::open_particles(
                Path::new(name),
                bytes.into(),
                Some(2).filter(|_| matches!(name, "steps.h5part" | "h5md.h5")),
                WantedParticles::default(),
                Unpacking::in_memory(),
            )
        };
        let values = positions(&read(whole.clone()).unwrap());
        for length in 0..whole.len() {
            // A truncated file may be valid if only padding is missing.
            if let Ok(file) = read(whole[..length].to_vec()) {
                assert_eq!(positions(&file), values, "{name} cut at {length}");
            }
        }
        for at in (0..whole.len()).step_by(whole.len() / (8 << 10) + 1) {
            for flip in [0x01, 0x80, 0xff] {
                let mut bytes = whole.clone();
                bytes[at] ^= flip;
                let _ = read(bytes);
            }
        }
    }
}

#[test]
fn an_h5part_file_with_steps_is_converted_as_a_sequence() {
    let folder = tempfile::tempdir().unwrap();
    fs::copy(data("steps.h5part"), folder.path().join("sim.h5part")).unwrap();
    let run = |arguments: &[&str]| {
        let output = command(folder.path(), &["reconstruct"]).args(arguments).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, messages) = run(&["sim.h5part", "-o", "m/", "--spacing", "0.25"]);
    assert_eq!(code, Some(0), "{messages}");
    let list: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.path().join("m/sim.ply.json")).unwrap()).unwrap();
    let listed: Vec<_> = list["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| (f["file"].as_str().unwrap(), f["time"].as_f64()))
        .collect();
    assert_eq!(
        listed,
        [("sim_0.ply", Some(0.0)), ("sim_2.ply", Some(0.5)), ("sim_10.ply", Some(2.5))]
    );
    let (code, messages) = run(&["sim.h5part", "-o", "m/", "--spacing", "0.25", "--resume"]);
    assert_eq!(code, Some(0));
    assert!(messages.contains("3 of 3 frames are already finished"), "{messages}");
    let (code, messages) = run(&["sim.h5part", "-o", "n/", "--watch"]);
    assert!(code == Some(2) && messages.contains("--watch"), "{messages}");
    let (code, messages) = run(&["sim.h5part#2", "-o", "one.ply", "--spacing", "0.25"]);
    assert_eq!(code, Some(0), "{messages}");
}
