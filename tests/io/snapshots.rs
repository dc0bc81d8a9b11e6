//! Tests of HDF5 frames of large simulation codes: valid files are read, and damaged files never
//! cause a panic. `tests/data/README.md` says which library wrote each file.
//!
//! `MENISCUS_EVERY_BYTE=1` truncates each file at every byte, and flips every byte.

use std::fs;
use std::path::{Path, PathBuf};

use meniscus::Where;
use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::frame_files::snapshot_pieces;
use meniscus::internals::io::input::{holds_mesh, open_particles, open_wanted, steps};
use meniscus::internals::io::wanted::{WantedAttributes, WantedParticles};
use meniscus::internals::io::{ParticleFile, ReadError, ReadFault};
use meniscus::internals::particles::Particles;
use meniscus::internals::particles::sizes::SizeChoice;
use tempfile::TempDir;

use crate::common::files;
use crate::common::particle_files::{attribute, positions};
use crate::common::program::command;
use crate::memory;

const GADGET: [&str; 3] = ["gadget_005.0.hdf5", "gadget_005.1.hdf5", "gadget_005.2.hdf5"];
/// Every file with a single frame, and its number of ghosts.
const FRAMES: [(&str, usize); 6] = [
    ("swift_0003.hdf5", 0),
    ("gadget_005.0.hdf5", 0),
    ("pysph_40.hdf5", 2),
    ("openpmd.h5#100", 0),
    ("grid.vtkhdf", 2),
    ("steps.vtkhdf#2", 0),
];

fn data(name: &str) -> PathBuf {
    files::data("simulations").join(name)
}

fn open(name: &str) -> Result<ParticleFile, ReadError> {
    open_particles(&data(name), Unpacking::in_memory())
}

fn open_type<'a>(path: &Path, name: impl Into<Option<&'a str>>) -> Result<ParticleFile, ReadError> {
    let condition = |name| format!("type={name}").parse().expect("a valid condition");
    let conditions: Vec<Where> = name.into().map(condition).into_iter().collect();
    let wanted = WantedParticles { conditions: &conditions, ..WantedParticles::default() };
    open_wanted(path, wanted, Unpacking::in_memory())
}

/// The points, which are the same in every file.
fn points() -> Vec<[f64; 3]> {
    positions(&open("points.csv").unwrap())
}

/// A folder with copies of the files whose names begin with this prefix.
fn copied(prefix: &str) -> TempDir {
    let folder = TempDir::new().unwrap();
    for entry in fs::read_dir(data("")).unwrap().map(Result::unwrap) {
        let name = entry.file_name().into_string().unwrap();
        if name.starts_with(prefix) && entry.path().is_file() {
            fs::copy(entry.path(), folder.path().join(name)).unwrap();
        }
    }
    folder
}

#[test]
fn frames_of_every_simulation_code_give_the_same_particles() {
    for (name, ghosts) in FRAMES {
        let file = open(name).unwrap();
        let mut expected = points();
        if name == "grid.vtkhdf" {
            // Remove the points that are flagged as ghosts.
            expected.remove(5);
            expected.remove(1);
        }
        // The positions in other files are rounded: some files contain f32, and openPMD positions
        // are computed from values, units and offsets.
        let exact = ["swift_0003.hdf5", "pysph_40.hdf5", "grid.vtkhdf"].contains(&name);
        let tolerance = if exact { 0.0 } else { 1e-6 };
        let shift = if name == "steps.vtkhdf#2" { 20.0 } else { 0.0 };
        let found = positions(&file);
        assert_eq!((found.len(), file.ghosts), (expected.len(), ghosts), "{name}");
        let velocity = if file.format.contains("GADGET") { "Velocities" } else { "velocity" };
        let velocities = attribute(&file, velocity);
        for (i, (found, point)) in found.iter().zip(expected).enumerate() {
            for axis in 0..3 {
                let right = point[axis] + shift;
                assert!((found[axis] - right).abs() <= tolerance * right, "{name}: particle {i}");
                let speed = f64::from(velocities[3 * i + axis]);
                assert!((speed - 2.0 * right).abs() <= 1e-6 * right, "{name}: velocity {i}");
            }
        }
        let time = if name == "steps.vtkhdf#2" { 1.5 } else { 0.75 };
        let has_time = name != "grid.vtkhdf";
        assert_eq!(file.time, has_time.then_some(time), "{name}");
        assert!(!holds_mesh(&data(name)).unwrap(), "{name}");
    }
}

#[test]
fn the_box_and_unit_of_a_header_are_reported_but_not_applied() {
    let swift = open("swift_0003.hdf5").unwrap();
    assert_eq!(swift.box_size, Some([4.0; 3]));
    let megaparsec = swift.unit_metres.unwrap();
    assert!((megaparsec / 3.0857e22 - 1.0).abs() < 1e-4, "{megaparsec}");
    let gadget = open(GADGET[2]).unwrap();
    assert_eq!((gadget.box_size, gadget.unit_metres), (Some([4.0; 3]), Some(1.0)));
    let output = command(Path::new("."), &["info"])
        .args([data("swift_0003.hdf5"), data("grid.vtkhdf")])
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text.contains("edges [4.0, 4.0, 4.0]; if fluid that leaves through a face re-enters"),
        "{text}"
    );
    assert!(text.contains("2 ghosts"), "{text}");
}

#[test]
fn particle_types_can_be_named_and_default_to_gas_or_fluid() {
    let dark = open_type(&data(GADGET[0]), "PartType1").unwrap();
    assert_eq!(positions(&dark), [[[1.0; 3]; 4].as_slice(), [[2.0; 3]; 2].as_slice()].concat());
    assert_eq!(positions(&open_type(&data("pysph_40.hdf5"), "wall").unwrap()), points()[..3]);
    assert_eq!(open_type(&data("openpmd.h5#200"), "water").unwrap().particles.len(), 24);
    for (name, kind, message) in [
        (GADGET[0], "PartType4", "no particles of type PartType4; available: PartType0, PartType1"),
        ("pysph_40.hdf5", "gas", "available: fluid, wall"),
        ("openpmd.h5#100", "ions", "available: water"),
    ] {
        let error = open_type(&data(name), kind).unwrap_err();
        assert!(
            matches!(&error.fault, ReadFault::Unsupported(what) if what.contains(message)),
            "{error}"
        );
        assert!(error.path.ends_with(name), "{error}");
    }
}

#[test]
fn steps_and_iterations_are_frames_with_their_own_numbers_and_times() {
    assert_eq!(steps(&data("steps.vtkhdf"), None).unwrap(), [0, 1, 2]);
    assert_eq!(steps(&data("openpmd.h5"), None).unwrap(), [100, 200]);
    for (name, _) in FRAMES.into_iter().filter(|(name, _)| !name.contains('#')) {
        assert_eq!(steps(&data(name), None).unwrap(), [0; 0], "{name}");
    }
    let second = open("steps.vtkhdf#1").unwrap();
    assert_eq!((second.particles.len(), second.time), (8, Some(0.75)));
    let right: Vec<_> =
        points()[..8].iter().map(|p| p.map(|x| f64::from((x + 10.0) as f32))).collect();
    assert_eq!(positions(&second), right);
    let later = open("openpmd.h5#200").unwrap();
    assert_eq!(later.time, Some(1.5));
    assert!(
        positions(&later).iter().zip(points()).all(|(a, b)| (a[0] - b[0] - 10.0).abs() < 1e-12)
    );
    for (name, message) in [
        ("steps.vtkhdf", "steps 0 to 2"),
        ("steps.vtkhdf#3", "no step 3"),
        ("grid.vtkhdf#0", "no step 0"),
        ("openpmd.h5", "steps 100 to 200"),
        ("openpmd.h5#150", "no iteration 150"),
        ("swift_0003.hdf5#0", "a single frame"),
    ] {
        let error = open(name).unwrap_err();
        assert!(
            matches!(&error.fault, ReadFault::Unsupported(what) if what.contains(message)),
            "{error}"
        );
    }
}

#[test]
fn a_snapshot_is_read_completely_from_any_of_its_files_or_its_view() {
    let whole = positions(&open(GADGET[0]).unwrap());
    for name in [GADGET[1], GADGET[2], "gadget_005.hdf5"] {
        assert_eq!(snapshot_pieces(&data(name)), Some(3));
        assert_eq!(positions(&open(name).unwrap()), whole, "{name}");
    }
    // The first file contains f64 and the third f32. The f64 positions must not be rounded to f32.
    assert_eq!(whole[..9], points()[..9]);
    let single: Vec<_> = points()[9..].iter().map(|p| p.map(|x| f64::from(x as f32))).collect();
    assert_eq!(whole[9..], single);
    // One file has no particles of this type, and no virtual file joins the files.
    let folder = copied("gadget_005.");
    fs::remove_file(folder.path().join("gadget_005.hdf5")).unwrap();
    assert_eq!(open_type(&folder.path().join(GADGET[2]), None).unwrap().particles.len(), 24);
}

#[test]
fn an_error_in_a_snapshot_names_the_file_that_causes_it() {
    for (piece, name) in GADGET.iter().enumerate() {
        let folder = copied("gadget");
        let (path, start) = (folder.path().join(name), folder.path().join(GADGET[(piece + 1) % 3]));
        let bytes = fs::read(&path).unwrap();
        let refused = |message: &str| {
            let error = open_type(&start, None).expect_err(message);
            assert!(error.path == path && error.to_string().contains(message), "{error}");
        };
        for cut in [100, bytes.len() / 2, bytes.len() - 1] {
            fs::write(&path, &bytes[..cut]).unwrap();
            refused("");
        }
        // The next file of the snapshot must not be the single file of another snapshot.
        fs::copy(data("swift_0003.hdf5"), &path).unwrap();
        refused("another snapshot");
        fs::remove_file(&path).unwrap();
        let error = open_type(&start, None).unwrap_err();
        assert!(error.path == path && matches!(error.fault, ReadFault::Io(_)), "{error}");
    }
    // The number of particles in the header shows that a file occurs twice.
    let folder = copied("gadget");
    fs::copy(data(GADGET[2]), folder.path().join(GADGET[0])).unwrap();
    let error = open_type(&folder.path().join(GADGET[0]), None).unwrap_err();
    assert!(error.to_string().contains("announces 24 particles of PartType0"), "{error}");
    // Change the name of an attribute in one file, so that this file lacks the attribute.
    let folder = copied("gadget");
    let path = folder.path().join(GADGET[2]);
    let mut bytes = fs::read(&path).unwrap();
    let at = bytes.windows(11).position(|name| name == b"ParticleIDs").unwrap();
    bytes[at] = b'X';
    fs::write(&path, bytes).unwrap();
    let error = open_type(&folder.path().join(GADGET[0]), None).unwrap_err();
    assert!(error.path == path && error.to_string().contains("XarticleIDs"), "{error}");
}

#[test]
fn a_snapshot_with_a_huge_file_count_is_refused_without_allocating() {
    let folder = copied("gadget");
    let path = folder.path().join(GADGET[0]);
    let mut bytes = fs::read(&path).unwrap();
    let name = b"NumFilesPerSnapshot";
    let at = bytes.windows(name.len()).position(|found| found == name).unwrap();
    let value = at + bytes[at..].windows(8).position(|found| found == 3u64.to_le_bytes()).unwrap();
    bytes[value..value + 8].copy_from_slice(&(1u64 << 62).to_le_bytes());
    fs::write(&path, bytes).unwrap();
    let (result, largest) = memory::largest_allocation(|| open_type(&path, None));
    let error = result.unwrap_err();
    assert!(
        error.path.ends_with("gadget_005.3.hdf5") && largest < 1 << 20,
        "{largest} bytes for {error}"
    );
}

#[test]
fn only_wanted_attributes_are_read_unless_one_is_missing() {
    let scratch = TempDir::new().unwrap();
    let unpacking = Unpacking { in_memory: 0, scratch: scratch.path(), control: None };
    let names = |of: &[meniscus::internals::particles::AttributeInfo]| -> Vec<String> {
        of.iter().map(|info| info.name.clone()).collect()
    };
    let ids = ["ParticleIDs".to_owned()];
    let wrong = ["nobody".to_owned()];
    let conditions = ["ParticleIDs>=0".parse().unwrap()];
    let only = |names, conditions| WantedAttributes::Only {
        names,
        conditions,
        sizes: &SizeChoice::Ignored,
    };
    let mut bytes = Vec::new();
    for (attributes, read, unread) in [
        (only(None, &[][..]), vec!["Velocities"], vec!["ParticleIDs"]),
        (only(Some(&ids[..]), &[]), vec!["ParticleIDs"], vec!["Velocities"]),
        (only(Some(&[]), &[]), vec![], vec!["ParticleIDs", "Velocities"]),
        (only(Some(&wrong), &[]), vec!["ParticleIDs", "Velocities"], vec![]),
        (only(Some(&[]), &conditions), vec!["ParticleIDs"], vec!["Velocities"]),
        (WantedAttributes::All, vec!["ParticleIDs", "Velocities"], vec![]),
    ] {
        let wanted = WantedParticles { attributes, ..WantedParticles::default() };
        let file = open_wanted(&data(GADGET[0]), wanted, unpacking).unwrap();
        assert_eq!(
            (names(file.particles.attributes()), names(&file.unread)),
            (
                read.iter().map(|n| n.to_string()).collect(),
                unread.iter().map(|n| n.to_string()).collect()
            )
        );
        assert_eq!(positions(&file), positions(&open(GADGET[0]).unwrap()));
        bytes.push(file.particles.scratch_bytes());
    }
    // Nine particles have f64 positions, and fifteen have f32 positions. Each particle has a
    // velocity of 12 bytes and an identifier of 8 bytes.
    let positions = 9 * 24 + 15 * 12;
    assert_eq!(bytes, [12, 8, 0, 20, 8, 20].map(|wide| positions + 24 * wide));
}

#[test]
fn contiguous_arrays_are_read_in_place_without_scratch_files() {
    let nowhere = Unpacking { in_memory: 0, scratch: Path::new("nowhere"), control: None };
    let attributes =
        WantedAttributes::Only { names: None, conditions: &[], sizes: &SizeChoice::Ignored };
    let wanted = WantedParticles { attributes, ..WantedParticles::default() };
    for name in ["steps.vtkhdf#2", "steps.vtkhdf#1"] {
        let file = open_wanted(&data(name), wanted, nowhere).unwrap();
        assert_eq!(file.particles.scratch_bytes(), 0, "{name}");
    }
    // The reader must copy an array that is stored in chunks to memory or to a scratch file, and
    // neither is available here.
    let error = open_wanted(&data("grid.vtkhdf"), wanted, nowhere).unwrap_err();
    assert!(matches!(error.fault, ReadFault::Scratch(_)), "{error}");
}

#[test]
fn damaged_files_cause_neither_panics_nor_large_allocations() {
    let folder = copied("gadget");
    let path = |name: &str| folder.path().join(name.split('#').next().unwrap());
    // By default, test only some bytes, because testing every byte takes minutes.
    let every = std::env::var_os("MENISCUS_EVERY_BYTE").is_some();
    for (name, _) in FRAMES {
        let step = name.split_once('#').map(|(_, step)| format!("#{step}")).unwrap_or_default();
        let whole = fs::read(data(name.split('#').next().unwrap())).unwrap();
        let opened = PathBuf::from(format!("{}{step}", path(name).display()));
        let values = positions(&open(name).unwrap());
        let read = |bytes: &[u8]| {
            fs::write(path(name), bytes).unwrap();
            let (result, largest) = memory::largest_allocation(|| {
                let _ = (
                    steps(&path(name), None),
                    holds_mesh(&path(name)),
                    snapshot_pieces(&path(name)),
                );
                open_type(&opened, None)
            });
            // Reading an uncompressed file never needs a block of memory larger than 64 MiB.
            assert!(largest <= 64 << 20, "{name}: {largest} bytes");
            result.map(|file| positions(&file))
        };
        let stride = |[small, large]: [usize; 2]| match every {
            true => 1,
            false if whole.len() > 20_000 => large,
            false => small,
        };
        let prefixes = (0..whole.len()).step_by(stride([3, 41]));
        for length in prefixes {
            // A truncated file may be valid if only padding is missing.
            if let Ok(found) = read(&whole[..length]) {
                assert_eq!(found, values, "{name} cut at {length}");
            }
        }
        let mut random = 12345u64;
        for at in (0..whole.len()).step_by(stride([3, 13])) {
            random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let mut bytes = whole.clone();
            bytes[at] ^= [0x01, 0x80, 0xff][(random >> 33) as usize % 3];
            let _ = read(&bytes);
        }
        fs::write(path(name), &whole).unwrap();
    }
}

#[test]
fn each_snapshot_in_a_folder_is_one_frame() {
    let folder = copied("gadget");
    let path = folder.path();
    // Add a second snapshot. Neither snapshot has a virtual file that joins its pieces.
    for (piece, name) in GADGET.iter().enumerate() {
        fs::copy(path.join(name), path.join(format!("gadget_006.{piece}.hdf5"))).unwrap();
    }
    fs::remove_file(path.join("gadget_005.hdf5")).unwrap();
    let run = |arguments: &[&str]| {
        let output = command(path, &["reconstruct"]).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        let list = fs::read(path.join("m/gadget.ply.json")).unwrap();
        let list: serde_json::Value = serde_json::from_slice(&list).unwrap();
        let frames = list["frames"].as_array().unwrap();
        let file = |frame: &serde_json::Value| {
            (frame["file"].as_str().unwrap().to_owned(), frame["particles"].as_u64().unwrap())
        };
        frames.iter().map(file).collect::<Vec<_>>()
    };
    let expected = [("gadget_005.ply".to_owned(), 24), ("gadget_006.ply".to_owned(), 24)];
    let names: Vec<String> = [5, 6]
        .iter()
        .flat_map(|frame| (0..3).map(move |k| format!("gadget_00{frame}.{k}.hdf5")))
        .collect();
    let files: Vec<&str> = names.iter().map(String::as_str).collect();
    for inputs in [vec!["."], vec!["gadget_*.hdf5"], files] {
        let arguments = [&inputs[..], &["-o", "m/", "--spacing", "1", "--overwrite"]].concat();
        assert_eq!(run(&arguments), expected, "{inputs:?}");
    }
    // If a virtual file joins the pieces of a snapshot, it represents the snapshot.
    fs::copy(data("gadget_005.hdf5"), path.join("gadget_005.hdf5")).unwrap();
    fs::copy(data("gadget_005.hdf5"), path.join("gadget_006.hdf5")).unwrap();
    assert_eq!(run(&[".", "-o", "m/", "--spacing", "1", "--overwrite"]), expected);
}
