//! Tests random pairs and triples of options on a small frame. Each combination must give either a
//! closed mesh that does not depend on threads, memory and backend, or an error and no file.
//!
//! `MENISCUS_OPTIONS=5000` tries 5000 combinations, and `MENISCUS_OPTION=77` repeats number 77.

use std::fs;
use std::path::Path;

use meniscus::internals::io::output::{MeshFormat, read_mesh};
use meniscus::internals::surface::mesh::check::check;
use tempfile::TempDir;

use crate::common::files::{raw, tree};
use crate::common::fill;
use crate::common::program::{command, run};
use crate::common::scene::Random;

/// Default number of combinations to try.
const COMBINATIONS: u64 = 60;

/// Options, each with several values. Most values are valid with some other options, and some
/// values are invalid.
const OPTIONS: [(&str, &[&str]); 33] = [
    ("--spacing", &["1", "0.9", "0", "-1", "nan", "1e300"]),
    ("--radius", &["0.5", "0"]),
    ("--cell", &["0.5", "0.8", "2", "0.01", "1e9"]),
    ("--cell-size", &["0.5", "0.7", "1e-300"]),
    ("--origin", &["0,0,0", "0.1,0.2,0.3", "1e9,0,0", "0,0"]),
    ("--domain", &["-9,-9,-9,9,9,9", "-,-1,-,-,9,-", "1,1,1,0,0,0", "100,100,100,101,101,101"]),
    ("--periodic", &["-8,-,-,8,-,-", "-8,-8,-8,8,8,8", "0,-,-,1,-,-"]),
    ("--periodic-mesh", &["cut", "overlap"]),
    ("--indicator", &["cloud", "counting", "symmetry"]),
    ("--method", &["dif", "mueller", "zhu-bridson", "yu-turk"]),
    ("--mu0", &["4", "8", "0", "-3"]),
    ("--smooth", &["0.8", "1.6", "4", "0", "99"]),
    ("--sigma", &["1", "2.5", "0", "1e9"]),
    ("--iso", &["0.5", "0.2", "plateau", "0", "1", "2"]),
    ("--detail", &[""]),
    ("--normals", &[""]),
    ("--attributes", &["none", "velocity"]),
    ("--simplify", &["0.2", "1", "9", "0"]),
    ("--smallest-component", &["1", "1e6", "0"]),
    ("--smallest-drop", &["1", "5", "100000"]),
    ("--compress", &[""]),
    ("--up", &["y", "z", "x"]),
    ("--particles-up", &["y", "z"]),
    ("--skip-invalid", &[""]),
    ("--format", &["xyz", "csv"]),
    ("--where", &["x>-1e9"]),
    ("--threads", &["1", "3", "0", "4096"]),
    ("--memory", &["64MiB", "1GiB", "1", "20MiB"]),
    ("--backend", &["cpu", "auto"]),
    ("--scratch", &[".", "none"]),
    ("--preview", &[""]),
    ("--stats", &["s.json", "m.ply"]),
    ("--dry-run", &[""]),
];

/// Options that must not change the result.
const NEUTRAL: [[&str; 2]; 3] = [["--threads", "1"], ["--memory", "96MiB"], ["--backend", "cpu"]];

struct Run {
    arguments: Vec<String>,
    output: &'static str,
    code: i32,
    errors: String,
}

impl Run {
    fn of(folder: &Path, output: &'static str, arguments: &[String]) -> Self {
        let first = ["reconstruct", "f.xyz", "-o", output].map(str::to_owned);
        let arguments = [&first[..], arguments].concat();
        let borrowed: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let ended = command(folder, &borrowed).output().unwrap();
        let errors = String::from_utf8(ended.stderr).unwrap();
        let code = ended.status.code().unwrap_or_else(|| panic!("{arguments:?}: killed: {errors}"));
        Self { arguments, output, code, errors }
    }

    fn has(&self, option: &str) -> bool {
        self.arguments.iter().any(|argument| argument == option)
    }

    #[track_caller]
    fn ensure(&self, holds: bool, failure: &str) {
        assert!(
            holds,
            "{}: {failure}, code {}: {}",
            self.arguments.join(" "),
            self.code,
            self.errors
        );
    }

    /// Checks the result of a run. `before` lists the files that were in the folder before the run.
    fn check_result(&self, folder: &Path, before: &[String]) {
        self.ensure([0, 2, 3].contains(&self.code), "an unexpected exit code");
        self.ensure(!self.errors.contains("panicked"), "the program panicked");
        let files: Vec<String> = tree(folder).into_keys().collect();
        let new: Vec<&String> = files.iter().filter(|file| !before.contains(file)).collect();
        if self.code != 0 {
            self.ensure(new.is_empty(), &format!("the files {new:?} remain"));
            self.ensure(!self.errors.trim().is_empty(), "no error message");
            return;
        }
        let mesh = folder.join(self.output);
        if self.has("--dry-run") {
            self.ensure(!mesh.exists(), "a dry run wrote a mesh");
            return;
        }
        let stem = self.output.split('.').next().unwrap();
        let own = |file: &&&String| file.starts_with(stem) || file.as_str() == "s.json";
        self.ensure(
            new.iter().filter(own).count() == new.len(),
            &format!("unexpected new files in {new:?}"),
        );
        if MeshFormat::of(&mesh).unwrap().is_read() {
            let report = check(&read_mesh(&mesh).unwrap());
            self.ensure(report.is_closed_oriented_manifold(), &report.to_string());
        }
    }
}

/// A random combination of two or three options, each with one of its values.
fn combination(random: &mut Random) -> Vec<String> {
    let mut options: Vec<(&str, &[&str])> = OPTIONS.to_vec();
    let mut arguments = Vec::new();
    for _ in 0..2 + random.bits() % 2 {
        let (option, values) = options.swap_remove((random.bits() % options.len() as u64) as usize);
        let value = values[(random.bits() % values.len() as u64) as usize];
        arguments.push(match value {
            "" => option.to_owned(),
            value => format!("{option}={value}"),
        });
    }
    arguments
}

/// A ball with a few drops around it, and sometimes a NaN particle.
fn frame(random: &mut Random) -> Vec<u8> {
    let mut particles = fill(12.0, 1.0, 0.3, 1, |p| p.length() < 5.0);
    if random.bits().is_multiple_of(4) {
        particles.push([f64::NAN, 0.0, 0.0]);
    }
    particles.extend([[7.0, 0.0, 0.0], [0.0, -7.5, 0.5], [7.3, 0.2, 0.1]]);
    raw(&particles)
}

fn try_combination(seed: u64) {
    let mut random = Random::new(seed.wrapping_mul(0x9e37_79b9).wrapping_add(7));
    let output =
        ["m.ply", "m.obj", "m.vtk", "m.vtp", "m.stl", "m.usdc", "m.glb", "m.vtkhdf", "m.abc"]
            [(random.bits() % 9) as usize];
    let arguments = combination(&mut random);
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("f.xyz"), frame(&mut random)).unwrap();
    let run = Run::of(folder.path(), output, &arguments);
    run.check_result(folder.path(), &["f.xyz".to_owned()]);
    let mesh = folder.path().join(output);
    if !mesh.exists() {
        return;
    }
    let bytes = fs::read(&mesh).unwrap();
    for [option, value] in NEUTRAL {
        if arguments.iter().any(|argument| argument.starts_with(&format!("{option}="))) {
            continue;
        }
        let more = [option, value, "--overwrite"].map(str::to_owned);
        let again = Run::of(folder.path(), output, &[&arguments[..], &more].concat());
        // With less memory, the run may also fail.
        if again.code == 0 {
            again.ensure(fs::read(&mesh).unwrap() == bytes, "the meshes differ");
        } else {
            again.ensure(option == "--memory" && again.code == 2, "the repeated run failed");
        }
    }
}

#[test]
fn every_option_combination_gives_a_valid_mesh_or_an_error_without_files() {
    let number = |name: &str| Some(std::env::var(name).ok()?.parse::<u64>().unwrap());
    match number("MENISCUS_OPTION") {
        Some(seed) => try_combination(seed),
        None => (0..number("MENISCUS_OPTIONS").unwrap_or(COMBINATIONS)).for_each(try_combination),
    }
}

#[test]
fn options_of_other_programs_lead_to_a_hint_with_our_option() {
    let folder = TempDir::new().unwrap();
    let pairs = [
        ("--particle-radius=0.025", "'--radius'"),
        ("-r=0.025", "'--radius'"),
        ("--cube-size=0.5", "'--cell-size'"),
        ("--smoothing-length=2", "'--smooth'"),
        ("--surface-threshold=0.6", "'--iso'"),
        ("--num-threads=4", "'--threads'"),
        ("--particle-aabb-min", "'--domain'"),
        ("--output-file=a.ply", "'--output'"),
    ];
    for (theirs, ours) in pairs {
        let errors = run(folder.path(), &["reconstruct", "a.npy", theirs], 2);
        assert!(errors.contains(ours) && !errors.contains("similar"), "{theirs}: {errors}");
    }
    let errors = run(folder.path(), &["check", "--cube-size=3"], 2);
    assert!(!errors.contains("--cell-size"), "`check` has no such option: {errors}");
}

#[test]
fn vertices_take_the_nearest_particles_id_for_any_particle_order() {
    let folder = TempDir::new().unwrap();
    let places: Vec<[f64; 3]> =
        (0..512).map(|i| [i % 8, i / 8 % 8, i / 64].map(f64::from)).collect();
    let write = |name: &str, scalar: &str, offset: i64, backwards: bool| {
        let mut rows: Vec<String> =
            (offset..).zip(&places).map(|(id, [x, y, z])| format!("{x} {y} {z} {id}\n")).collect();
        if backwards {
            rows.reverse();
        }
        let header = format!(
            "ply\nformat ascii 1.0\nelement vertex 512\nproperty double x\nproperty double y\n\
             property double z\nproperty {scalar} id\nend_header\n"
        );
        fs::write(folder.path().join(name), header + &rows.concat()).unwrap();
    };
    write("forwards.ply", "int", 16_777_216, false);
    write("backwards.ply", "int", 16_777_216, true);
    write("long.ply", "int64", 16_777_216, false);
    write("wide.ply", "int64", 5_000_000_000, false);
    let of = |input: &str, code: i32| {
        let output = format!("mesh_{input}");
        let arguments = ["reconstruct", input, "--spacing", "1", "--attributes", "id", "-o"];
        let errors = run(folder.path(), &[&arguments[..], &[&output]].concat(), code);
        (folder.path().join(output), errors)
    };
    let [forwards, backwards, long] = ["forwards.ply", "backwards.ply", "long.ply"].map(|input| {
        let (output, _) = of(input, 0);
        fs::read(output).unwrap()
    });
    assert!(
        forwards == backwards && forwards == long,
        "the order of the particles or the width of the integers changes the mesh"
    );
    let mesh = read_mesh(&folder.path().join("mesh_forwards.ply")).unwrap();
    for (vertex, id) in mesh.positions.iter().zip(&mesh.attributes[0].whole) {
        let squared = |place: &[f64; 3]| -> f64 {
            place.iter().zip(vertex).map(|(a, b)| (a - b).powi(2)).sum()
        };
        let nearest = places.iter().map(squared).fold(f64::INFINITY, f64::min);
        let own = squared(&places[(id - 16_777_216) as usize]);
        assert!(own - nearest < 1e-3, "{own} instead of {nearest}");
    }
    let (output, errors) = of("wide.ply", 3);
    assert!(errors.contains("id") && errors.contains("5000000511") && !output.exists(), "{errors}");
}
