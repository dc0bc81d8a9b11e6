//! Tests of the command line: results and exit codes are right, and no temporary files remain.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use meniscus::Settings;
use meniscus::internals::io::output::read_mesh;
use meniscus::internals::surface::mesh::check::check;
use meniscus::internals::surface::mesh::measure::measure;
use tempfile::TempDir;

use crate::common::files::{data, names, raw};
use crate::common::program::{command, in_shell, shell_command, wait_until};
use crate::common::scene::Random;
use crate::common::{device, fill, splashes};

fn meniscus(folder: &Path, arguments: &[&str]) -> Output {
    command(folder, arguments).output().unwrap()
}

/// A folder with a ball of particles at spacing 0.5, in the file `ball.xyz`.
fn folder_with_ball() -> TempDir {
    let folder = TempDir::new().unwrap();
    let ball = fill(10.0, 2.0, 0.2, 3, |p| p.length() < 5.0);
    fs::write(folder.path().join("ball.xyz"), raw(&ball)).unwrap();
    folder
}

/// Runs `reconstruct`, which must fail with `code`, print `message`, and leave the folder
/// unchanged.
#[track_caller]
fn assert_refused(folder: &Path, arguments: &[&str], code: i32, message: &[&str]) {
    let before = names(folder);
    let output = meniscus(folder, &[&["reconstruct"], arguments].concat());
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {errors}");
    for word in message {
        assert!(errors.contains(word), "{arguments:?} does not print {word:?}: {errors}");
    }
    assert!(!errors.contains("panicked"), "{errors}");
    assert_eq!(names(folder), before, "{arguments:?} changed the folder");
}

#[test]
fn every_bundled_frame_becomes_a_watertight_mesh_without_options() {
    let folder = TempDir::new().unwrap();
    let mut frames = 0;
    for entry in ["dambreak_small", "dualsphysics_dambreak"].map(data) {
        for frame in fs::read_dir(entry).unwrap().map(|e| e.unwrap().path()) {
            let extension = frame.extension().unwrap().to_str().unwrap();
            if !["bgeo", "vtk", "bi4"].contains(&extension) {
                continue;
            }
            frames += 1;
            for output in ["mesh.ply", "mesh.obj", "mesh.vtk", "mesh.vtp", "mesh.stl"] {
                let run = meniscus(
                    folder.path(),
                    &["reconstruct", frame.to_str().unwrap(), "-o", output, "--overwrite"],
                );
                assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
                let mesh = read_mesh(&folder.path().join(output)).unwrap();
                assert!(mesh.triangles.len() > 1000);
                let report = check(&mesh);
                assert!(
                    report.is_closed_oriented_manifold(),
                    "{} as {output}: {report}",
                    frame.display()
                );
                let velocity =
                    mesh.attributes.iter().any(|a| a.name == "velocity" && a.components == 3);
                assert_eq!(velocity, !["mesh.obj", "mesh.stl"].contains(&output), "{output}");
            }
        }
    }
    assert!(frames >= 4, "{frames} frames");
}

#[test]
fn the_output_is_independent_of_threads_particle_order_and_run() {
    let folder = TempDir::new().unwrap();
    let mut particles = splashes(5);
    fs::write(folder.path().join("a.xyz"), raw(&particles)).unwrap();
    particles.reverse();
    fs::write(folder.path().join("b.xyz"), raw(&particles)).unwrap();
    let bytes = |input: &str, threads: &str| {
        let options = [
            "--cell-size",
            "0.9",
            "--normals",
            "--smooth",
            "1.4",
            "--overwrite",
            "--threads",
            threads,
        ];
        let run = meniscus(
            folder.path(),
            &[&["reconstruct", input, "-o", "out.ply"], &options[..]].concat(),
        );
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        fs::read(folder.path().join("out.ply")).unwrap()
    };
    let first = bytes("a.xyz", "1");
    assert!(
        first == bytes("a.xyz", "1")
            && first == bytes("a.xyz", "2")
            && first == bytes("b.xyz", "3")
    );
}

#[test]
fn invalid_arguments_exit_with_2_and_leave_no_files() {
    let folder = folder_with_ball();
    let ball = |more: &[&'static str]| [&["ball.xyz", "-o", "out.ply"], more].concat();
    for (arguments, message) in [
        (vec!["ball.xyz"], "--output"),
        (vec!["ball.xyz", "-o", "out.fbx"], "out.fbx"),
        (vec!["ball.xyz", "-o", "out"], "out"),
        (vec!["ball.xyz", "-o", "out.stl", "--normals"], "normals"),
        (vec!["ball.xyz", "-o", "out.obj", "--attributes", "velocity"], "attributes"),
        (vec!["ball.xyz", "-o", "other.xyz"], "unknown extension"),
        (vec!["ball.abc", "-o", "out.ply"], "unknown extension"),
        (ball(&["--sigma", "0"]), "sigma"),
        (ball(&["--sigma", "nan"]), "sigma"),
        (ball(&["--iso", "1.5"]), "--iso must be"),
        (ball(&["--iso", "high"]), "auto"),
        (ball(&["--mu0", "3", "--indicator", "symmetry"]), "symmetry"),
        (ball(&["--method", "guess"]), "guess"),
        (ball(&["--method", "mueller", "--sigma", "1"]), "--sigma"),
        (ball(&["--method", "yu-turk", "--smooth", "2"]), "--smooth"),
        (ball(&["--adaptive"]), "--adaptive"),
        (ball(&["--smooth", "0.79"]), "--smooth must be from 0.8 to 4 spacings, got 0.79"),
        (ball(&["--smooth", "4.01"]), "--smooth must be from 0.8 to 4 spacings, got 4.01"),
        (ball(&["--smooth", "-1"]), "--smooth must be"),
        (ball(&["--smooth", "nan"]), "--smooth must be"),
        (ball(&["--sigma", "1"]), "--sigma needs the indicator counting or symmetry"),
        (
            ball(&["--iso", "0.4"]),
            "--iso needs the indicator counting or symmetry, but --indicator is cloud (the \
             default); alternatively, set --method to mueller or yu-turk",
        ),
        (ball(&["--sigma", "1"]), "--indicator is cloud (the default); use --smooth instead"),
        (ball(&["--detail"]), "--detail needs the indicator counting or symmetry"),
        (ball(&["--mu0", "3"]), "--mu0 needs the indicator counting, but --indicator is cloud"),
        (
            ball(&["--smooth", "2", "--indicator", "counting"]),
            "--smooth needs the indicator cloud (the default)",
        ),
        (
            ball(&["--smooth", "2", "--indicator", "symmetry"]),
            "--indicator is symmetry; use --sigma instead",
        ),
        (ball(&["--method", "zhu-bridson", "--iso", "0.4"]), "--iso"),
        (ball(&["--method", "mueller", "--mu0", "3"]), "--mu0"),
        (ball(&["--method", "mueller", "--cell", "0.05"]), "at most 16 cells per spacing, got 20"),
        (ball(&["--indicator", "counting", "--mu0", "-3"]), "mu0"),
        (ball(&["--cell", "0"]), "--cell must be positive and finite, got 0"),
        (ball(&["--cell-size", "-1"]), "--cell-size"),
        (ball(&["--cell-size", "1", "--cell", "1"]), "cannot be used with"),
        (ball(&["--spacing", "inf"]), "--spacing"),
        (ball(&["--radius", "0"]), "--radius"),
        (ball(&["--origin", "1,2"]), "3 numbers"),
        (ball(&["--origin", "1,2,nan"]), "origin"),
        (ball(&["--domain", "0,0,0,1,-1,1"]), "domain"),
        (ball(&["--domain", "0,0,0,0.01,1,1", "--cell-size", "0.5"]), "too thin along x"),
        (ball(&["--attributes", "colour"]), "colour"),
        (ball(&["--threads", "0"]), "--threads"),
        (ball(&["--memory", "much"]), "--memory"),
        (ball(&["--backend", "abacus"]), "abacus"),
    ] {
        assert_refused(folder.path(), &arguments, 2, &[message]);
    }
}

/// Writes a ball as a .ply whose particles all have the values `values` of the properties
/// `properties`, which are lines of the header.
fn write_ball(path: &Path, properties: &str, values: &str) {
    let ball = fill(10.0, 2.0, 0.2, 3, |p| p.length() < 5.0);
    let rows: String = ball.iter().map(|[x, y, z]| format!("{x} {y} {z} {values}\n")).collect();
    let places = ["x", "y", "z"].map(|name| format!("property float {name}\n")).concat();
    let count = ball.len();
    let text = format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\n{places}{properties}end_header\n{rows}"
    );
    fs::write(path, text).unwrap();
}

#[test]
fn an_obj_stores_one_colour_and_other_named_attributes_are_refused() {
    let folder = TempDir::new().unwrap();
    let cd = |scalar: &str| {
        ["Cd_0", "Cd_1", "Cd_2"].map(|name| format!("property {scalar} {name}\n")).concat()
    };
    let rgb = ["red", "green", "blue"].map(|name| format!("property uchar {name}\n")).concat();
    let at = |name: &str| folder.path().join(name);
    write_ball(&at("bytes.ply"), &cd("int"), "255 51 0");
    write_ball(&at("shorts.ply"), &cd("ushort"), "65535 13107 0");
    write_ball(&at("numbers.ply"), &cd("int"), "300 51 0");
    write_ball(&at("one.ply"), "property float Cd\n", "0.5");
    write_ball(&at("two.ply"), &(cd("int") + &rgb), "255 51 0 1 2 3");
    for (input, names) in [("numbers", "Cd"), ("one", "Cd"), ("two", "Cd,color")] {
        let input = format!("{input}.ply");
        let arguments = [&*input, "-o", "m.obj", "--attributes", names];
        let message = ".obj cannot store --attributes other than one colour";
        assert_refused(folder.path(), &arguments, 2, &[message]);
        assert_refused(folder.path(), &[&arguments[..], &["--dry-run"]].concat(), 2, &[message]);
    }
    // The names of the last list have blanks around them.
    for (input, names) in [("bytes", "Cd"), ("shorts", "Cd"), ("two", " Cd , Cd ")] {
        let (input, output) = (format!("{input}.ply"), format!("{input}.obj"));
        let arguments = ["reconstruct", &input, "-o", &output, "--attributes", names];
        let run = meniscus(folder.path(), &arguments);
        assert!(run.status.success(), "{run:?}");
        let text = fs::read_to_string(at(&output)).unwrap();
        let vertex = text.lines().find(|line| line.starts_with("v ")).unwrap();
        let numbers = vertex.split(' ').skip(1).map(|word| word.parse().unwrap());
        let numbers: Vec<f64> = numbers.collect();
        let [_, _, _, red, green, blue] = numbers[..] else { panic!("{input}: {vertex}") };
        let is_equal = |(a, b): (f64, f64)| (a - b).abs() < 1e-5;
        assert!([(red, 1.0), (green, 0.2), (blue, 0.0)].into_iter().all(is_equal), "{vertex}");
    }
}

#[test]
fn every_method_makes_a_watertight_ball_and_is_named_in_the_statistics() {
    let folder = folder_with_ball();
    for method in ["dif", "mueller", "zhu-bridson", "yu-turk"] {
        let out = format!("{method}.ply");
        let arguments =
            ["reconstruct", "ball.xyz", "-o", &out, "--method", method, "--stats", "stats.jsonl"];
        let run = meniscus(folder.path(), &arguments);
        assert!(run.status.success(), "{method}: {run:?}");
        assert!(meniscus(folder.path(), &["check", &out]).status.success(), "{method}");
        let stats = fs::read_to_string(folder.path().join("stats.jsonl")).unwrap();
        let record: serde_json::Value =
            serde_json::from_str(stats.lines().next_back().unwrap()).unwrap();
        assert_eq!(record["method"], method);
        assert!(record["triangles"].as_u64().unwrap() > 100);
    }
}

#[test]
fn kernel_methods_do_not_mention_an_indicator() {
    let folder = folder_with_ball();
    for (method, has_indicator) in
        [("dif", true), ("mueller", false), ("zhu-bridson", false), ("yu-turk", false)]
    {
        let given = [
            "reconstruct",
            "ball.xyz",
            "-o",
            "a.ply",
            "--overwrite",
            "--cell",
            "0.6",
            "--method",
            method,
        ];
        let run = meniscus(folder.path(), &given);
        assert!(run.status.success(), "{method}: {run:?}");
        let notes = String::from_utf8(run.stderr).unwrap();
        assert_eq!(notes.contains("indicator"), has_indicator, "{method}: {notes}");
    }
}

#[test]
fn default_cell_size_and_smoothing_depend_on_the_indicator() {
    let folder = folder_with_ball();
    for (more, cell, width, indicator) in [
        (&[][..], 0.25, 1.6, "cloud"),
        (&["--smooth", "2.5"], 0.25, 2.5, "cloud"),
        (&["--cell", "0.8"], 0.4, 1.6, "cloud"),
        (&["--cell-size", "0.2"], 0.2, 1.6, "cloud"),
        (&["--indicator", "counting"], 2.0 / 6.0, 1.5, "counting"),
        (&["--indicator", "counting", "--cell", "2"], 1.0, 1.0, "counting"),
        (&["--indicator", "counting", "--cell", "0.5", "--sigma", "1.2"], 0.25, 1.2, "counting"),
        (&["--indicator", "symmetry", "--cell", "1"], 0.5, 1.0, "symmetry"),
    ] {
        let [name, other] =
            if indicator == "cloud" { ["smooth", "sigma"] } else { ["sigma", "smooth"] };
        let given = ["reconstruct", "ball.xyz", "-o", "a.ply", "--overwrite", "--stats", "s.jsonl"];
        let given = [&given[..], &["--spacing", "0.5"], more].concat();
        assert!(meniscus(folder.path(), &given).status.success());
        let stats = fs::read_to_string(folder.path().join("s.jsonl")).unwrap();
        let record: serde_json::Value =
            serde_json::from_str(stats.lines().next_back().unwrap()).unwrap();
        let number = |name: &str| record[name].as_f64().unwrap();
        assert!(
            (number("cell_size") - cell).abs() < 1e-12 && (number(name) - width).abs() < 1e-12,
            "{record}"
        );
        assert!(record[other].is_null(), "{record}");
        assert_eq!(record["indicator"], indicator, "{more:?}");
    }
}

#[test]
fn an_existing_output_is_replaced_only_with_overwrite() {
    let folder = folder_with_ball();
    let out = folder.path().join("out.ply");
    fs::write(&out, "precious").unwrap();
    assert_refused(folder.path(), &["ball.xyz", "-o", "out.ply"], 2, &["out.ply", "--overwrite"]);
    assert_eq!(fs::read(&out).unwrap(), b"precious");
    // If the run fails, an existing file is kept, even with --overwrite.
    assert_refused(
        folder.path(),
        &["ball.xyz", "-o", "out.ply", "--overwrite", "--indicator", "counting", "--iso", "0.999"],
        3,
        &["empty"],
    );
    assert_eq!(fs::read(&out).unwrap(), b"precious");
    let run = meniscus(folder.path(), &["reconstruct", "ball.xyz", "-o", "out.ply", "--overwrite"]);
    assert!(run.status.success());
    assert!(fs::read(&out).unwrap().starts_with(b"ply"));
    assert_eq!(names(folder.path()), ["ball.xyz", "out.ply"]);
}

#[test]
fn an_input_is_never_its_own_output() {
    let folder = TempDir::new().unwrap();
    fs::copy(data("spot.ply"), folder.path().join("spot.ply")).unwrap();
    let before = fs::read(folder.path().join("spot.ply")).unwrap();
    assert_refused(
        folder.path(),
        &["spot.ply", "-o", "./spot.ply", "--overwrite"],
        2,
        &["choose another output"],
    );
    assert_eq!(fs::read(folder.path().join("spot.ply")).unwrap(), before);
}

#[test]
fn an_unwritable_output_exits_with_4_before_the_input_is_opened() {
    let folder = folder_with_ball();
    assert_refused(folder.path(), &["ball.xyz", "-o", "ball.xyz/no/out.ply"], 4, &["ball.xyz/no"]);
    // The program checks the output before it opens the input.
    assert_refused(
        folder.path(),
        &["missing.xyz", "-o", "ball.xyz/no/out.ply"],
        4,
        &["ball.xyz/no"],
    );
    // A folder that was created for an output is removed if the run fails.
    assert_refused(folder.path(), &["missing.xyz", "-o", "made/for/out.ply"], 3, &["missing.xyz"]);
    fs::create_dir(folder.path().join("out.ply")).unwrap();
    let run = meniscus(folder.path(), &["reconstruct", "ball.xyz", "-o", "out.ply", "--overwrite"]);
    assert_eq!(run.status.code(), Some(4));
    assert_eq!(names(folder.path()), ["ball.xyz", "out.ply"]);
}

#[cfg(unix)]
#[test]
fn a_full_disk_exits_with_4_and_leaves_no_files() {
    let folder = folder_with_ball();
    // A limit on the size of files simulates a full disk.
    let run = in_shell(folder.path(), "ulimit -f 8", "reconstruct ball.xyz -o out.ply --quiet");
    let errors = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(4), "{errors}");
    assert!(errors.contains("out.ply"), "{errors}");
    assert_eq!(names(folder.path()), ["ball.xyz"]);
}

#[test]
#[cfg(target_os = "linux")]
fn commands_without_memory_or_threads_fail_and_leave_no_files() {
    let folder = folder_with_ball();
    meniscus(folder.path(), &["reconstruct", "ball.xyz", "-o", "ball.ply"]);
    for number in [1, 2] {
        let copy = folder.path().join(format!("ball_{number}.xyz"));
        fs::copy(folder.path().join("ball.xyz"), copy).unwrap();
    }
    let commands = [
        "reconstruct ball.xyz -o out.ply --backend cpu --cell 0.25",
        "reconstruct ball.xyz -o out.glb --backend cpu --simplify 0.2",
        "reconstruct ball_{}.xyz -o out/{}.ply --backend cpu --threads 6",
        "reconstruct ball_{}.xyz -o out/{}.usdc --backend cpu --preview",
        "pack ball.xyz -o out.mnf",
        "info ball.ply",
        "check ball.ply",
        "compare ball.ply ball.ply",
        "render ball.ply -o out.png",
    ];
    let inputs = ["ball.ply", "ball.xyz", "ball_1.xyz", "ball_2.xyz"];
    let mut results = [0; 2];
    // `ulimit -d` also limits the stacks of threads, so with a small limit no thread can start.
    for kib in [1, 2, 4, 6, 8, 12, 16, 20, 24, 30, 40, 60, 1000].map(|mib| 1000 * mib) {
        for command in commands {
            let limited = in_shell(folder.path(), &format!("ulimit -d {kib}"), command);
            let errors = String::from_utf8_lossy(&limited.stderr);
            let code = limited.status.code();
            assert!(matches!(code, Some(0..=4)), "{kib} KiB, {command}: {code:?}, {errors}");
            assert!(!errors.contains("panicked"), "{kib} KiB, {command}: {errors}");
            assert!(code == Some(0) || !errors.is_empty(), "{kib} KiB, {command}");
            results[usize::from(code != Some(0))] += 1;
            for out in ["out.ply", "out.glb", "out.mnf", "out.png"] {
                let made = fs::remove_file(folder.path().join(out)).is_ok();
                assert!(!made || code == Some(0), "{kib} KiB, {command}: {out}");
            }
            // Delete the frames that were finished before memory ran out.
            let _ = fs::remove_dir_all(folder.path().join("out"));
            // If there was too little memory even to remove a temporary file, the next run removes
            // it.
            if !errors.contains("aborted") && code != Some(0) {
                let names = names(folder.path());
                let others = names.iter().filter(|name| !name.ends_with(".tmp"));
                assert_eq!(others.collect::<Vec<_>>(), inputs, "{kib} KiB, {command}");
            }
        }
    }
    assert_eq!(names(folder.path()), inputs);
    assert!(results.iter().all(|&count| count > 20), "{results:?}");
}

#[test]
#[cfg(target_os = "linux")]
fn devices_are_not_used_if_threads_of_drivers_would_overflow_their_stacks() {
    let folder = folder_with_ball();
    let reconstruct = "reconstruct ball.xyz -o out.ply --overwrite --backend";
    // With a limit near 16 KiB, some runs would end before `main`, because the stack also holds the
    // environment.
    for kib in [128, 255] {
        let limit = format!("ulimit -s {kib}");
        let run = in_shell(folder.path(), &limit, &format!("{reconstruct} vulkan"));
        let errors = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(5), "{errors}");
        assert!(errors.contains(&format!("{kib} KiB")) && errors.contains("ulimit -s"), "{errors}");
        assert_eq!(names(folder.path()), ["ball.xyz"]);
    }
    let run = in_shell(folder.path(), "ulimit -s 128", &format!("{reconstruct} cpu"));
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
}

#[test]
#[cfg(target_os = "linux")]
fn the_default_memory_budget_respects_ulimit() {
    let folder = folder_with_ball();
    let run =
        in_shell(folder.path(), "ulimit -v 400000", "reconstruct ball.xyz -o out.ply --dry-run");
    let plan = String::from_utf8_lossy(&run.stdout);
    let budget: Option<f64> =
        plan.split(" of the ").find_map(|rest| rest.split_once(" MiB limit")?.0.parse().ok());
    assert!(budget.is_some_and(|mib| mib < 0.75 * 400_000.0 / 1024.0), "{plan}");
}

#[test]
fn invalid_input_exits_with_3_and_is_named() {
    let folder = TempDir::new().unwrap();
    let put = |name: &str, bytes: &[u8]| fs::write(folder.path().join(name), bytes).unwrap();
    let ball = fill(10.0, 2.0, 0.2, 3, |p| p.length() < 5.0);
    let with = |index: usize, value: [f64; 3]| {
        let mut particles = ball.clone();
        particles[index] = value;
        raw(&particles)
    };
    put("empty.ply", b"");
    put("none.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n");
    put("one.xyz", &raw(&ball[..1]));
    put("same.xyz", &raw(&vec![[1.0, 2.0, 3.0]; 1_000_000]));
    put("cut.xyz", &raw(&ball)[..100]);
    put("nan.xyz", &with(1234, [0.0, f64::NAN, 0.0]));
    put("inf.xyz", &with(77, [f64::INFINITY, 0.0, 0.0]));
    put("far.xyz", &with(5, [0.0, 0.0, 1e30]));
    put("noise.bgeo", &[7; 500]);
    let missing = if cfg!(windows) { "os error 2" } else { "No such file" };
    for (file, more, message) in [
        ("missing.ply", &[][..], &["missing.ply", missing][..]),
        ("empty.ply", &[], &["empty.ply", "empty"]),
        ("none.ply", &[], &["none.ply", "no particles"]),
        ("one.xyz", &[], &["one.xyz", "spacing", "--spacing"]),
        ("same.xyz", &[], &["same.xyz", "spacing", "--spacing"]),
        ("same.xyz", &["--cell-size", "1", "--indicator", "counting"], &["same.xyz", "mu0"]),
        ("cut.xyz", &[], &["cut.xyz"]),
        ("nan.xyz", &["--spacing", "0.5"], &["nan.xyz", "particle 1234", "--skip-invalid"]),
        ("nan.xyz", &[], &["nan.xyz", "particle 1234"]),
        ("inf.xyz", &[], &["inf.xyz", "particle 77"]),
        ("far.xyz", &["--spacing", "0.5"], &["far.xyz", "particle 5 ", "cells"]),
        ("noise.bgeo", &[], &["noise.bgeo"]),
    ] {
        assert_refused(folder.path(), &[&[file, "-o", "out.ply"], more].concat(), 3, message);
    }
}

#[test]
fn a_lattice_on_cell_corners_is_refused_with_a_suitable_origin() {
    let folder = TempDir::new().unwrap();
    let lattice = fill(10.0, 2.0, 0.0, 1, |p| p.length() < 5.0);
    let on_corners: Vec<[f64; 3]> = lattice.iter().map(|p| p.map(|c| c - 0.25)).collect();
    fs::write(folder.path().join("lattice.xyz"), raw(&on_corners)).unwrap();
    let notes = |more: &[&str], code: i32| {
        let options = [
            "reconstruct",
            "lattice.xyz",
            "-o",
            "out.ply",
            "--spacing",
            "0.5",
            "--cell",
            "1",
            "--overwrite",
        ];
        let run = meniscus(folder.path(), &[&options[..], &["--indicator"], more].concat());
        assert_eq!(run.status.code(), Some(code));
        String::from_utf8(run.stderr).unwrap()
    };
    let refused = notes(&["symmetry", "--origin", "0,0,0"], 2);
    assert!(
        refused.contains("--origin 0.25,0.25,0.25") && refused.contains("on the corners of cells"),
        "{refused}"
    );
    assert_eq!(names(folder.path()), ["lattice.xyz"]);
    assert!(!notes(&["symmetry", "--origin", "0.25,0.25,0.25"], 0).contains("warning"));
    let moved = notes(&["symmetry"], 0);
    assert!(
        moved.contains("lattice, so the grid's origin was moved to") && !moved.contains("warning"),
        "{moved}"
    );
    assert!(!notes(&["counting"], 0).contains("warning"));
    assert!(!notes(&["cloud"], 0).contains("warning"));
}

#[test]
fn skip_invalid_omits_and_counts_invalid_particles() {
    let folder = TempDir::new().unwrap();
    let ball = fill(10.0, 2.0, 0.2, 3, |p| p.length() < 5.0);
    fs::write(folder.path().join("good.xyz"), raw(&ball)).unwrap();
    let mut bad = ball;
    for (i, bad_position) in
        [[f64::NAN; 3], [0.0, f64::NEG_INFINITY, 0.0], [1e30, 0.0, 0.0]].into_iter().enumerate()
    {
        bad.insert(100 * i, bad_position);
    }
    fs::write(folder.path().join("bad.xyz"), raw(&bad)).unwrap();
    let run = |input: &str, output: &str| {
        meniscus(
            folder.path(),
            &["reconstruct", input, "-o", output, "--spacing", "0.5", "--skip-invalid"],
        )
    };
    assert!(run("good.xyz", "good.ply").status.success());
    let skipped = run("bad.xyz", "bad.ply");
    let notes = String::from_utf8_lossy(&skipped.stderr);
    assert!(skipped.status.success(), "{notes}");
    assert!(
        notes.contains("2 particles skipped") && notes.contains("1 particle skipped"),
        "{notes}"
    );
    let bytes = |name| fs::read(folder.path().join(name)).unwrap();
    assert!(bytes("good.ply") == bytes("bad.ply"));
}

#[test]
fn a_cell_size_too_small_for_the_memory_is_refused_with_one_that_fits() {
    let folder = TempDir::new().unwrap();
    // Use spray that is so sparse that every particle has its own bin.
    let mut random = Random::new(1);
    let spray: Vec<[f64; 3]> = (0..60_000).map(|_| [(); 3].map(|()| 1e5 * random.unit())).collect();
    fs::write(folder.path().join("spray.xyz"), raw(&spray)).unwrap();
    let run = |cell: &str| {
        let options =
            ["reconstruct", "spray.xyz", "-o", "out.ply", "--memory", "16MiB", "--spacing", "1"];
        meniscus(folder.path(), &[&options[..], &["--cell-size", cell]].concat())
    };
    let refused = run("0.5");
    let errors = String::from_utf8(refused.stderr).unwrap();
    assert_eq!(refused.status.code(), Some(2), "{errors}");
    assert_eq!(names(folder.path()), ["spray.xyz"]);
    let sizes: Vec<&str> = errors
        .split("cell size of ")
        .skip(1)
        .map(|s| s.trim_start_matches("at least ").split([' ', ',']).next().unwrap())
        .collect();
    let [requested, fitting] = sizes[..] else { panic!("{errors}") };
    assert_eq!(requested, "0.5");
    let fitted = run(fitting);
    assert!(fitted.status.success(), "{fitting}: {}", String::from_utf8_lossy(&fitted.stderr));
}

#[test]
fn a_dry_run_prints_estimates_and_writes_nothing() {
    let folder = folder_with_ball();
    let run = meniscus(folder.path(), &["reconstruct", "ball.xyz", "-o", "out.ply", "--dry-run"]);
    assert!(run.status.success());
    let messages = String::from_utf8_lossy(&run.stdout).into_owned();
    assert!(messages.contains("memory"), "{messages}");
    assert_eq!(names(folder.path()), ["ball.xyz"]);
    // A dry run computes a small frame completely, so the printed number of triangles is exact.
    let figure = |name: &str| -> u64 {
        let line = messages.lines().find_map(|line| line.strip_prefix(&format!("{name}: about ")));
        line.unwrap().split(' ').next().unwrap().parse().unwrap()
    };
    assert!((1..600).contains(&figure("time")), "{messages}");
    assert!(
        meniscus(folder.path(), &["reconstruct", "ball.xyz", "-o", "out.ply"]).status.success()
    );
    let mesh = read_mesh(&folder.path().join("out.ply")).unwrap();
    assert_eq!(figure("triangles"), mesh.triangles.len() as u64, "{messages}");
}

#[test]
fn each_run_appends_one_json_record_to_the_statistics() {
    let folder = folder_with_ball();
    for output in ["a.ply", "b.ply"] {
        let run = meniscus(
            folder.path(),
            &["reconstruct", "ball.xyz", "-o", output, "--stats", "stats.jsonl"],
        );
        assert!(run.status.success());
    }
    let text = fs::read_to_string(folder.path().join("stats.jsonl")).unwrap();
    let records: Vec<serde_json::Value> =
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(records.len(), 2);
    let mesh = read_mesh(&folder.path().join("b.ply")).unwrap();
    assert_eq!(records[1]["triangles"], mesh.triangles.len());
    assert!(records[1]["seconds"]["mesh"].as_f64().unwrap() > 0.0);
}

#[test]
fn info_distinguishes_particles_from_meshes() {
    let folder = folder_with_ball();
    for mesh in ["ball.ply", "ball.bgeo.sc"] {
        assert!(meniscus(folder.path(), &["reconstruct", "ball.xyz", "-o", mesh]).status.success());
    }
    let run = meniscus(folder.path(), &["info", "--json", "ball.xyz", "ball.ply", "ball.bgeo.sc"]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let infos: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(infos[0]["kind"], "particles");
    assert_eq!(infos[1]["kind"], "mesh");
    assert_eq!(infos[2]["kind"], "geometry");
    let triangles = infos[1]["triangles"].as_u64().unwrap();
    assert_eq!(infos[2]["primitives"]["kinds"], serde_json::json!([["polygon", triangles]]));
    assert_eq!(infos[2]["primitives"]["points"], infos[1]["vertices"]);
    let text = meniscus(folder.path(), &["info", "ball.bgeo.sc"]).stdout;
    let text = String::from_utf8(text).unwrap();
    assert!(text.contains(&format!("{triangles} polygons")) && text.contains("Add SOP"), "{text}");
    let spacing = infos[0]["spacing"].as_f64().unwrap();
    assert!((spacing / 0.5 - 1.0).abs() < 0.05, "{spacing}");
    assert_eq!(meniscus(folder.path(), &["info", "missing.ply"]).status.code(), Some(3));
    // A bad file does not suppress the output for the other files.
    let run =
        meniscus(folder.path(), &["info", "missing.ply", "ball.xyz", "absent.ply", "ball.ply"]);
    assert_eq!(run.status.code(), Some(3));
    let text = String::from_utf8_lossy(&run.stdout);
    assert!(text.contains("ball.xyz") && text.contains("ball.ply"), "{text}");
    let errors = String::from_utf8_lossy(&run.stderr);
    assert!(errors.contains("missing.ply") && errors.contains("absent.ply"), "{errors}");
}

#[test]
fn check_exits_0_only_for_a_closed_oriented_manifold() {
    let folder = folder_with_ball();
    assert!(
        meniscus(folder.path(), &["reconstruct", "ball.xyz", "-o", "ball.obj"]).status.success()
    );
    let good = meniscus(folder.path(), &["check", "--json", "ball.obj"]);
    assert_eq!(good.status.code(), Some(0));
    let checked: serde_json::Value = serde_json::from_slice(&good.stdout).unwrap();
    assert_eq!(checked[0]["measures"]["genus"], 0);
    // A mesh without one of its faces has a hole.
    let text = fs::read_to_string(folder.path().join("ball.obj")).unwrap();
    let last_face = text.trim_end().rfind("\nf ").unwrap();
    fs::write(folder.path().join("hole.obj"), &text[..=last_face]).unwrap();
    assert_eq!(meniscus(folder.path(), &["check", "ball.obj", "hole.obj"]).status.code(), Some(1));
    assert_eq!(meniscus(folder.path(), &["check", "missing.obj"]).status.code(), Some(3));
}

#[test]
fn check_continues_after_a_damaged_mesh_and_then_fails() {
    let folder = folder_with_ball();
    for name in ["mesh/a_1.ply", "mesh/a_2.ply", "mesh/a_3.usdc"] {
        assert!(meniscus(folder.path(), &["reconstruct", "ball.xyz", "-o", name]).status.success());
    }
    let damaged = folder.path().join("mesh/a_1.ply");
    let bytes = fs::read(&damaged).unwrap();
    fs::write(&damaged, &bytes[..bytes.len() / 2]).unwrap();
    // In a folder, `check` leaves out formats that it cannot read.
    for meshes in ["mesh", "mesh/a_{}.ply"] {
        let run = meniscus(folder.path(), &["check", "--json", meshes]);
        let errors = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(3), "{errors}");
        assert!(errors.contains("a_1.ply") && !errors.contains("a_3.usdc"), "{errors}");
        let checked: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
        assert_eq!(checked.as_array().unwrap().len(), 1);
        assert_eq!(checked[0]["closed_oriented_manifold"], true);
    }
}

#[test]
fn a_wall_that_the_fluid_almost_reaches_and_coarse_cells_are_reported() {
    let folder = TempDir::new().unwrap();
    let pool: Vec<_> = fill(20.0, 1.0, 0.3, 5, |p| p.y < 5.0);
    fs::write(folder.path().join("pool.xyz"), raw(&pool)).unwrap();
    let errors = |arguments: &[&str]| {
        let all = [&["reconstruct", "pool.xyz", "-o", "a.ply", "--overwrite"], arguments].concat();
        let run = meniscus(folder.path(), &all);
        assert!(run.status.success());
        String::from_utf8(run.stderr).unwrap()
    };
    let before_wall = "just short of the wall at y =";
    let end = -20.0;
    for (gap, is_reported) in [(0.0, false), (0.2, false), (0.5, true), (0.8, true), (3.0, false)] {
        let domain = format!("-,{},-,-,-,-", end - gap);
        let errors = errors(&["--spacing", "1", "--domain", &domain]);
        assert_eq!(errors.contains(before_wall), is_reported, "{gap}: {errors}");
    }
    // Two layers are too shallow for the detection of walls, but they suffice to show that the
    // fluid ends just short of the domain's wall.
    for (jitter, gap, is_reported) in
        [(0.0, 0.0, false), (0.0, 0.5, true), (0.3, 0.0, false), (0.3, 0.8, true)]
    {
        let film = fill(20.0, 1.0, jitter, 5, |p| p.y < -18.0);
        fs::write(folder.path().join("pool.xyz"), raw(&film)).unwrap();
        let errors = errors(&["--spacing", "1", "--domain", &format!("-,{},-,-,-,-", end - gap)]);
        assert_eq!(errors.contains(before_wall), is_reported, "{jitter}, {gap}: {errors}");
    }
    fs::write(folder.path().join("pool.xyz"), raw(&pool)).unwrap();
    for (cell, is_reported) in [("2", false), ("3", true)] {
        let errors = errors(&["--spacing", "1", "--cell", cell]);
        assert_eq!(errors.contains("spacings wide"), is_reported, "{cell}: {errors}");
    }
}

#[test]
fn compare_gives_zero_for_equal_meshes_and_the_bias_of_a_larger_one() {
    let folder = folder_with_ball();
    for (output, iso) in [("half.ply", "auto"), ("large.ply", "0.005")] {
        assert!(
            meniscus(
                folder.path(),
                &["reconstruct", "ball.xyz", "-o", output, "--indicator", "counting", "--iso", iso]
            )
            .status
            .success()
        );
    }
    let compare = |a: &str, b: &str| -> serde_json::Value {
        let run = meniscus(folder.path(), &["compare", "--json", a, b]);
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        serde_json::from_slice(&run.stdout).unwrap()
    };
    assert!(compare("half.ply", "half.ply")["hausdorff"].as_f64().unwrap() < 1e-12);
    assert!(compare("half.ply", "large.ply")["bias"].as_f64().unwrap() > 0.2);
    assert!(compare("large.ply", "half.ply")["bias"].as_f64().unwrap() < -0.2);
}

#[test]
fn a_closed_standard_output_is_not_an_error() {
    let folder = folder_with_ball();
    let mut child = command(folder.path(), &["info", "ball.xyz"])
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
}

#[test]
fn statistics_replace_no_input_or_output_and_a_failed_run_leaves_none() {
    let folder = folder_with_ball();
    let before = fs::read(folder.path().join("ball.xyz")).unwrap();
    for stats in ["ball.xyz", "out.ply", "./out.ply"] {
        assert_refused(
            folder.path(),
            &["ball.xyz", "-o", "out.ply", "--stats", stats],
            2,
            &["choose another output"],
        );
    }
    assert_refused(
        folder.path(),
        &["missing.xyz", "-o", "out.ply", "--stats", "s"],
        3,
        &["missing.xyz"],
    );
    assert_eq!(fs::read(folder.path().join("ball.xyz")).unwrap(), before);
}

#[test]
#[cfg(unix)]
fn interrupts_and_crashes_leave_no_files() {
    use std::os::unix::process::ExitStatusExt;
    const SEGMENTATION_FAULT: i32 = 11;
    let folder = TempDir::new().unwrap();
    let pipe = folder.path().join("pipe.xyz");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    // Nothing is written to the pipe, so the program waits for particles.
    let outputs = ["out.ply", "made/here/out.ply"];
    for (signal, output) in outputs.iter().flat_map(|output| [("TERM", output), ("SEGV", output)]) {
        // Forbid core files, which a crash may write into the folder.
        let reconstruct = format!("reconstruct pipe.xyz -o {output}");
        let mut child = shell_command(folder.path(), "ulimit -c 0", &reconstruct)
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        let place = folder.path().join(output);
        let begun = |_: &_| {
            let files = fs::read_dir(place.parent().unwrap()).into_iter().flatten();
            files.flatten().any(|file| file.file_name().to_string_lossy().starts_with('.'))
        };
        wait_until(&mut child, "its temporary file", begun);
        // This call returns when the program has opened the pipe for reading.
        let _writer = fs::File::options().write(true).open(&pipe).unwrap();
        let id = child.id().to_string();
        assert!(Command::new("kill").args(["-s", signal, &id]).status().unwrap().success());
        let run = child.wait_with_output().unwrap();
        if signal == "TERM" {
            assert_eq!(run.status.code(), Some(130));
        } else {
            assert_eq!(run.status.signal(), Some(SEGMENTATION_FAULT));
        }
        assert!(!run.stderr.is_empty(), "{signal}: no message");
        assert_eq!(names(folder.path()), ["pipe.xyz"], "{signal}, {output}");
    }
}

#[test]
fn the_first_command_of_the_readme_makes_a_watertight_mesh() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let readme = fs::read_to_string(root.join("README.md")).unwrap();
    let line =
        readme.lines().find_map(|line| line.strip_prefix("cargo run --release -- ")).unwrap();
    let folder = TempDir::new().unwrap();
    let arguments: Vec<String> = line
        .split(' ')
        .map(|word| {
            if word.starts_with("tests/") {
                root.join(word).display().to_string()
            } else {
                word.into()
            }
        })
        .collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let run = meniscus(folder.path(), &arguments);
    assert!(run.status.success(), "{line}: {}", String::from_utf8_lossy(&run.stderr));
    let [mesh] = &names(folder.path())[..] else { panic!("expected one mesh") };
    let report = check(&read_mesh(&folder.path().join(mesh)).unwrap());
    assert!(report.is_closed_oriented_manifold(), "{report}");
}

#[test]
fn coordinates_beyond_f32_are_written_as_f64_or_refused() {
    let folder = TempDir::new().unwrap();
    let ball = fill(10.0, 2.0, 0.2, 3, |p| p.length() < 5.0);
    for (scale, name) in [("1e39", "huge.csv"), ("1e-60", "tiny.csv"), ("1", "far.csv")] {
        let factor: f64 = scale.parse().unwrap();
        let shift = if name == "far.csv" { 1e6 } else { 0.0 };
        let lines: Vec<String> =
            ball.iter().map(|p| p.map(|c| (c * factor + shift).to_string()).join(",")).collect();
        fs::write(folder.path().join(name), lines.join("\n")).unwrap();
        let spacing = (0.5 * factor).to_string();
        let run = meniscus(
            folder.path(),
            &["reconstruct", name, "-o", "out.ply", "--overwrite", "--spacing", &spacing],
        );
        assert!(run.status.success(), "{name}: {}", String::from_utf8_lossy(&run.stderr));
        let mesh = read_mesh(&folder.path().join("out.ply")).unwrap();
        let report = check(&mesh);
        assert!(report.is_closed_oriented_manifold(), "{name}: {report}");
        assert!(report.duplicate_positions.is_none(), "{name}: {report}");
        if name != "far.csv" {
            assert_refused(
                folder.path(),
                &[name, "-o", "out.stl", "--spacing", &spacing],
                2,
                &[".stl", "32-bit floats"],
            );
        }
    }
}

/// Runs the program on a Vulkan device. The program caches its pipelines in the folder.
fn on_vulkan(folder: &Path, arguments: &[&str], environment: &[(&str, &str)]) -> Output {
    let mut command = command(folder, arguments);
    command
        .env("XDG_CACHE_HOME", folder.join("cache"))
        .envs(environment.iter().copied())
        .output()
        .unwrap()
}

/// Environment variables with which the Vulkan loader finds no driver.
const NO_DRIVER: [(&str, &str); 2] =
    [("VK_DRIVER_FILES", "/nowhere"), ("VK_ICD_FILENAMES", "/nowhere")];

#[test]
fn the_output_is_independent_of_the_backend_and_the_memory_budget() {
    if let Err(why) = device::shared() {
        return device::skip(why);
    }
    let folder = folder_with_ball();
    let run = |backend: &str, output: &str, more: &[&str]| {
        let arguments =
            ["reconstruct", "ball.xyz", "-o", output, "--backend", backend, "--normals"];
        let arguments = [&arguments[..], &["--cell", "0.8", "--stats", "stats"], more].concat();
        let run = on_vulkan(folder.path(), &arguments, &[]);
        let errors = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.success(), "{arguments:?}: {errors}");
        assert!(!errors.contains("warning"), "{arguments:?}: {errors}");
        let stats = fs::read_to_string(folder.path().join("stats")).unwrap();
        let stats: serde_json::Value = serde_json::from_str(stats.lines().last().unwrap()).unwrap();
        if backend == "vulkan" {
            assert!(
                stats["backend"].as_str().unwrap().starts_with("Vulkan"),
                "{arguments:?}: {stats}"
            );
            // The ball surrounds the origin, so it occupies eight bins and eight blocks.
            let on_device = ["pages_on_device", "regions_on_device"].map(|key| stats[key].as_u64());
            assert_eq!(on_device, [Some(8); 2], "{arguments:?}: the CPU did some of the work");
        }
        fs::read(folder.path().join(output)).unwrap()
    };
    let expected = run("cpu", "cpu.ply", &[]);
    assert!(run("vulkan", "vulkan.ply", &[]) == expected);
    assert!(run("vulkan", "again.ply", &["--device", "0", "--threads", "1"]) == expected);
    assert!(run("vulkan", "tight.ply", &["--memory", "64MiB"]) == expected);
    assert!(run("auto", "auto.ply", &[]) == expected);
}

#[test]
fn a_missing_device_exits_with_5_and_leaves_no_files() {
    let folder = folder_with_ball();
    let before = names(folder.path());
    let reconstruct = ["reconstruct", "ball.xyz", "-o", "out.ply"];
    for (options, environment) in [
        (&["--backend", "vulkan"][..], &NO_DRIVER[..]),
        (&["--device", "nonsense"], &[]),
        (&["--backend", "vulkan", "--device", "99"], &[]),
    ] {
        let run = on_vulkan(folder.path(), &[&reconstruct[..], options].concat(), environment);
        let errors = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(5), "{options:?}: {errors}");
        assert!(errors.contains("Vulkan") && !errors.contains("panicked"), "{options:?}: {errors}");
        assert_eq!(names(folder.path()), before, "{options:?} changed the folder");
    }
    let auto = on_vulkan(folder.path(), &reconstruct, &NO_DRIVER);
    assert!(auto.status.success(), "{}", String::from_utf8_lossy(&auto.stderr));
    assert_refused(
        folder.path(),
        &["ball.xyz", "-o", "new.ply", "--backend", "cpu", "--device", "0"],
        2,
        &["--device"],
    );
}

#[test]
fn devices_lists_the_devices_of_the_vulkan_loader() {
    if let Err(why) = device::shared() {
        return device::skip(why);
    }
    let folder = TempDir::new().unwrap();
    let run = meniscus(folder.path(), &["devices", "--json"]);
    let devices: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert!(devices.as_array().unwrap().iter().any(|device| device["usable"] == true), "{devices}");
    let name = devices[0]["name"].as_str().unwrap();
    let run = meniscus(folder.path(), &["devices"]);
    assert!(String::from_utf8_lossy(&run.stdout).contains(name));
    assert_eq!(on_vulkan(folder.path(), &["devices"], &NO_DRIVER).status.code(), Some(5));
}

#[test]
fn invalid_simplify_component_compress_and_up_options_are_refused() {
    let folder = folder_with_ball();
    let ball = ["ball.xyz", "--spacing", "0.5", "-o"];
    for (arguments, message) in [
        (&["a.ply", "--simplify", "0"][..], "--simplify"),
        (&["a.ply", "--simplify", "4.1"], "at most 4 cells"),
        (&["a.ply", "--simplify", "nan"], "--simplify"),
        (&["a.ply", "--smallest-component", "-1"], "--smallest-component"),
        (&["a.ply", "--compress"], "--compress works only with .glb"),
        (
            &["a.glb", "--up", "z"],
            "y always points up in .glb; if z points up in the particles, set --particles-up to z",
        ),
    ] {
        assert_refused(folder.path(), &[&ball[..], arguments].concat(), 2, &[message]);
    }
    let all = [&ball[..], &["a.ply", "--smallest-component", "1e9"]].concat();
    assert_refused(
        folder.path(),
        &all,
        3,
        &["smallest-component removed its only component; use a smaller --smallest-component"],
    );
}

#[test]
fn a_simplified_ball_is_watertight_and_its_simplification_is_reported() {
    let folder = folder_with_ball();
    let run = |options: &[&str]| {
        let arguments =
            [&["reconstruct", "ball.xyz", "--spacing", "0.5", "--overwrite"], options].concat();
        let output = meniscus(folder.path(), &arguments);
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    run(&["-o", "whole.ply"]);
    let messages = run(&["-o", "less.ply", "--simplify", "0.25", "--smallest-component", "10"]);
    assert!(messages.contains("simplified with a tolerance of 0.25 cells"), "{messages}");
    assert!(messages.contains("0 components smaller than 10 cells left out"), "{messages}");
    let [whole, less] =
        ["whole.ply", "less.ply"].map(|name| read_mesh(&folder.path().join(name)).unwrap());
    assert!(less.triangles.len() * 2 < whole.triangles.len());
    assert!(check(&less).is_closed_oriented_manifold());
    run(&["-o", "less.glb", "--simplify", "0.25", "--normals", "--compress"]);
    assert!(fs::read(folder.path().join("less.glb")).unwrap().starts_with(b"glTF"));
}

/// Reconstructs a mesh, and returns its bytes and the program's messages.
#[track_caller]
fn reconstructed(folder: &Path, input: &str, more: &[&str]) -> (Vec<u8>, String) {
    let options = ["reconstruct", input, "-o", "reconstructed.ply", "--overwrite"];
    let run = meniscus(folder, &[&options[..], more].concat());
    let notes = String::from_utf8(run.stderr).unwrap();
    assert!(run.status.success(), "{more:?}: {notes}");
    (fs::read(folder.join("reconstructed.ply")).unwrap(), notes)
}

#[test]
fn volume_and_component_count_of_real_frames_depend_little_on_cell_size() {
    let folder = TempDir::new().unwrap();
    let frames = [
        "dambreak_small/ParticleData_Fluid_1.bgeo",
        "dambreak_small/ParticleData_Fluid_10.bgeo",
        "dambreak_small/ParticleData_Fluid_20.bgeo",
        "dualsphysics_dambreak/Part_0005.bi4",
    ];
    for frame in frames.map(data) {
        for indicator in ["cloud", "counting"] {
            let found = |cell: &str| {
                let more = ["--cell", cell, "--indicator", indicator];
                let (_, notes) = reconstructed(folder.path(), frame.to_str().unwrap(), &more);
                // A warning is allowed for counting, which loses drops of one particle.
                let lost = indicator == "counting"
                    && notes.contains("are outside the surface; use the indicator cloud");
                assert!(lost || !notes.contains("warning"), "{notes}");
                let measures =
                    measure(&read_mesh(&folder.path().join("reconstructed.ply")).unwrap());
                (measures.volume.unwrap(), measures.components)
            };
            let (volume, pieces) = found("0.6667");
            for cell in ["0.5", "0.4", "0.35", "0.333333", "0.25"] {
                let (fine, fine_pieces) = found(cell);
                let what = format!("{} by {indicator} in cells of {cell}", frame.display());
                // Sheets are thicker in coarse cells.
                assert!((fine / volume - 1.0).abs() < 0.04, "{what}: {fine} of {volume}");
                let within = if indicator == "cloud" { pieces / 8 + 3 } else { 2 };
                assert!(
                    fine_pieces.abs_diff(pieces) <= within,
                    "{what}: {fine_pieces} of {pieces} pieces"
                );
            }
        }
    }
}

#[test]
fn fine_cells_give_the_same_bytes_for_any_threads_budget_and_packing() {
    let folder = TempDir::new().unwrap();
    let frame = data("dambreak_small/ParticleData_Fluid_20.bgeo");
    let frame = frame.to_str().unwrap();
    // In shallow fluid, clouds and counting give different messages.
    for (indicator, note) in
        [("cloud", "because the fluid is too shallow"), ("counting", "computed from the spacing")]
    {
        let fine = ["--cell", "0.333333", "--indicator", indicator];
        let (whole, notes) =
            reconstructed(folder.path(), frame, &[&fine[..], &["--attributes", "none"]].concat());
        assert!(notes.contains(note), "{notes}");
        for more in [["--threads", "1"], ["--memory", "16MiB"]] {
            let more = [&fine[..], &["--attributes", "none"], &more].concat();
            assert!(whole == reconstructed(folder.path(), frame, &more).0, "{more:?}");
        }
        let pack = meniscus(
            folder.path(),
            &[&["pack", frame, "-o", "f.mnf", "--overwrite"], &fine[..]].concat(),
        );
        assert!(pack.status.success());
        assert!(whole == reconstructed(folder.path(), "f.mnf", &[]).0, "{indicator}, packed");
    }
}

#[test]
fn cells_too_fine_for_the_indicator_are_refused_with_a_usable_size() {
    let folder = folder_with_ball();
    let finest = ["ball.xyz", "-o", "out.ply", "--spacing", "0.5", "--cell", "0.09"];
    let message = [
        "ball.xyz",
        "less than 0.1 spacings",
        "use a cell size of 0.0505 or more (--cell 0.1 or more)",
    ];
    assert_refused(folder.path(), &finest, 2, &message);
    let enough = [
        "reconstruct",
        "ball.xyz",
        "-o",
        "out.ply",
        "--spacing",
        "0.5",
        "--cell",
        "0.1",
        "--dry-run",
    ];
    assert_eq!(meniscus(folder.path(), &enough).status.code(), Some(0));
    let fine = [
        "ball.xyz",
        "-o",
        "out.ply",
        "--spacing",
        "0.5",
        "--cell",
        "0.1",
        "--indicator",
        "counting",
    ];
    assert_refused(
        folder.path(),
        &fine,
        2,
        &["ball.xyz", "too few particles", "0.125", "use a cell size of 0.0"],
    );
    assert_refused(folder.path(), &[&fine[..], &["--dry-run"]].concat(), 2, &["too few particles"]);
    let more = ["--indicator", "symmetry", "--cell", "0.4"];
    let symmetry = [&fine[..5], &more[..]].concat();
    assert_refused(folder.path(), &symmetry, 2, &["too small for the symmetry indicator", "0.25"]);
    fs::rename(folder.path().join("ball.xyz"), folder.path().join("ball_1.xyz")).unwrap();
    let sequence = ["ball_{}.xyz", "-o", "out/m_{}.ply", "--spacing", "0.5", "--cell", "0.09"];
    let run = meniscus(folder.path(), &[&["reconstruct"], &sequence[..]].concat());
    let errors = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.code() == Some(2) && errors.contains("less than 0.1 spacings"), "{errors}");
    let pack = ["pack", "ball_1.xyz", "-o", "f.mnf", "--spacing", "0.5", "--cell", "0.09"];
    let run = meniscus(folder.path(), &pack);
    assert_eq!(run.status.code(), Some(2), "{}", String::from_utf8_lossy(&run.stderr));
    assert!(!folder.path().join("f.mnf").exists());
}

#[test]
fn drops_without_a_cell_centre_fail_alone_but_are_empty_in_a_sequence() {
    let folder = folder_with_ball();
    fs::write(folder.path().join("d_1.xyz"), raw(&[[0.0; 3]])).unwrap();
    fs::rename(folder.path().join("ball.xyz"), folder.path().join("d_2.xyz")).unwrap();
    let coarse = ["--spacing", "0.05", "--cell-size", "1"];
    let alone = [&["d_1.xyz", "-o", "out.ply"], &coarse[..]].concat();
    assert_refused(
        folder.path(),
        &alone,
        3,
        &["d_1.xyz", "no cell centre is inside the fluid", "use smaller cells (--cell)"],
    );
    let run = meniscus(
        folder.path(),
        &[&["reconstruct", "d_{}.xyz", "-o", "m_{}.ply"], &coarse[..]].concat(),
    );
    let notes = String::from_utf8_lossy(&run.stderr);
    assert!(
        run.status.success()
            && notes.contains("d_1.xyz: the mesh is empty: no cell centre is inside the fluid"),
        "{notes}"
    );
    let empty = read_mesh(&folder.path().join("m_1.ply")).unwrap();
    assert_eq!((empty.positions.len(), empty.triangles.len()), (0, 0));
}

#[test]
fn a_surface_that_loses_most_of_its_particles_causes_a_warning() {
    let folder = folder_with_ball();
    let notes = |more: &[&str]| {
        reconstructed(folder.path(), "ball.xyz", &[&["--spacing", "0.5"], more].concat()).1
    };
    assert!(!notes(&[]).contains("warning"));
    let lost = notes(&["--indicator", "counting", "--iso", "0.28"]);
    assert!(lost.contains("% of the volume of") && lost.contains("a lower --iso"), "{lost}");
    // Use a ball and spray with three times as many particles.
    let mut random = Random::new(3);
    let ball = fill(10.0, 2.0, 0.2, 3, |p| p.length() < 4.0);
    let spray = (0..3 * ball.len()).map(|_| [(); 3].map(|()| 10.0 + 200.0 * random.unit()));
    fs::write(folder.path().join("ball.xyz"), raw(&spray.chain(ball).collect::<Vec<_>>())).unwrap();
    let lost = notes(&["--indicator", "counting"]);
    assert!(
        lost.contains("% of the volume of") && lost.contains("--indicator cloud, which keeps"),
        "{lost}"
    );
    assert!(!notes(&[]).contains("% of the volume of"));
}

#[test]
fn an_estimated_spacing_gives_the_mesh_of_the_same_given_spacing() {
    let folder = folder_with_ball();
    let info = meniscus(folder.path(), &["info", "ball.xyz", "--json"]);
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    let spacing = info[0]["spacing"].as_f64().unwrap().to_string();
    let (estimated, notes) = reconstructed(folder.path(), "ball.xyz", &["--cell-size", "0.15"]);
    assert!(notes.contains("estimated from the particles"), "{notes}");
    let (given, _) =
        reconstructed(folder.path(), "ball.xyz", &["--cell-size", "0.15", "--spacing", &spacing]);
    assert!(estimated == given);
    let (calmer, _) =
        reconstructed(folder.path(), "ball.xyz", &["--cell-size", "0.15", "--smooth", "2"]);
    assert!(estimated != calmer);
}

#[test]
fn completions_and_manual_pages_cover_commands_and_options() {
    let folder = TempDir::new().unwrap();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let output = meniscus(folder.path(), &["completions", shell]);
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success(), "{shell}");
        for word in ["reconstruct", "smallest-drop", "completions"] {
            assert!(text.contains(word), "completions of {shell} lack {word}");
        }
    }
    assert_eq!(meniscus(folder.path(), &["completions", "teletype"]).status.code(), Some(2));
    assert_eq!(names(folder.path()), [""; 0]);
    let pages = folder.path().to_str().unwrap();
    assert!(meniscus(folder.path(), &["manual", pages]).status.success());
    let page = fs::read_to_string(folder.path().join("meniscus-reconstruct.1")).unwrap();
    assert!(page.contains("smallest") && names(folder.path()).len() > 6);
    assert_eq!(meniscus(folder.path(), &["manual", "there/is/none"]).status.code(), Some(4));
}

#[test]
fn the_short_help_fits_a_screen_and_the_long_help_has_headings() {
    let folder = TempDir::new().unwrap();
    let text =
        |flag| String::from_utf8(meniscus(folder.path(), &["reconstruct", flag]).stdout).unwrap();
    let [summary, help] = ["-h", "--help"].map(text);
    assert!(summary.lines().count() <= 50, "{} lines", summary.lines().count());
    let headings = help.lines().filter(|line| line.ends_with(':') && !line.starts_with(' '));
    let headings: Vec<&str> = headings.collect();
    let expected = [
        "Arguments:",
        "Options:",
        "Input:",
        "Surface:",
        "Output:",
        "Simulations:",
        "Clusters:",
        "Messages:",
        "Machine:",
    ];
    let mut sorted = headings.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, {
        let mut all = expected;
        all.sort_unstable();
        all
    });
    let place = |heading: &str| help.find(heading).unwrap();
    assert!(place("Input:") < place("--spacing") && place("Simulations:") < place("--resume"));
}

#[test]
fn a_mesh_is_refused_as_particles_but_points_with_vertex_cells_are_read() {
    let folder = folder_with_ball();
    let packed = meniscus(folder.path(), &["pack", "ball.xyz", "-o", "ball.mnf", "--quiet"]);
    assert!(packed.status.success());
    for mesh in ["mesh.ply", "mesh.vtk", "mesh.vtp", "mesh.vtkhdf"] {
        // `reconstruct` accepts a packed frame as input, but not a mesh.
        let meshed = meniscus(folder.path(), &["reconstruct", "ball.mnf", "-o", mesh, "--quiet"]);
        assert!(meshed.status.success(), "{mesh}");
        let faces = read_mesh(&folder.path().join(mesh)).unwrap().triangles.len();
        let message =
            format!("{mesh}: the file contains a mesh ({faces} faces or cells), not particles");
        assert_refused(folder.path(), &[mesh, "-o", "out.ply"], 3, &[&message]);
        let packed = meniscus(folder.path(), &["pack", mesh, "-o", "out.mnf"]);
        let errors = String::from_utf8_lossy(&packed.stderr);
        assert!(packed.status.code() == Some(3) && errors.contains(&message), "{errors}");
        assert!(!folder.path().join("out.mnf").exists());
        let info = meniscus(folder.path(), &["info", mesh]);
        assert!(String::from_utf8_lossy(&info.stdout).contains("triangles"), "{mesh}");
    }
    let points = "0 0 0 1 0 0 2 0 0\n";
    let vertices = "VERTICES 3 6\n1 0 1 1 1 2\nLINES 1 4\n3 0 1 2\n";
    let grid = "CELLS 3 6\n1 0 1 1 1 2\nCELL_TYPES 3\n1 1 1\n";
    for (name, kind, cells) in
        [("a.vtk", "POLYDATA", vertices), ("b.vtk", "UNSTRUCTURED_GRID", grid)]
    {
        let file = format!(
            "# vtk DataFile Version 3.0\n\nASCII\nDATASET {kind}\nPOINTS 3 float\n{points}{cells}"
        );
        fs::write(folder.path().join(name), file).unwrap();
        let run = meniscus(
            folder.path(),
            &["reconstruct", name, "-o", "out.ply", "--spacing", "1", "--dry-run"],
        );
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    }
}

#[test]
fn missing_output_folders_are_created_and_impossible_ones_refused() {
    let folder = folder_with_ball();
    for (output, command) in [("a/b/x.ply", "reconstruct"), ("c/d/x.mnf", "pack")] {
        let run = meniscus(folder.path(), &[command, "ball.xyz", "-o", output]);
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        assert!(folder.path().join(output).is_file());
    }
    let run = meniscus(folder.path(), &["render", "a/b/x.ply", "-o", "e/f/x.png", "--size", "8x8"]);
    assert!(run.status.success() && folder.path().join("e/f/x.png").is_file());
    let output = meniscus(folder.path(), &["reconstruct", "ball.xyz", "-o", "ball.xyz/such/x.ply"]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(4), "{errors}");
    assert!(errors.contains("ball.xyz/such/x.ply: cannot create the folder"), "{errors}");
    assert!(!errors.contains(".tmp"), "{errors}");
}

#[test]
fn check_and_info_accept_folders_globs_and_patterns() {
    let folder = folder_with_ball();
    for frame in [2, 10] {
        let output = format!("mesh/m_{frame}.ply");
        let run = meniscus(folder.path(), &["reconstruct", "ball.xyz", "-o", &output]);
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    }
    fs::write(folder.path().join("mesh/notes.md"), "no mesh").unwrap();
    fs::write(folder.path().join("mesh/m.ply.json"), "{}").unwrap();
    for meshes in ["mesh", "mesh/", "mesh/m_*.ply", "mesh/m_{}.ply"] {
        for command in ["check", "info"] {
            let run = meniscus(folder.path(), &[command, meshes]);
            let messages = String::from_utf8(run.stdout).unwrap();
            assert!(
                run.status.success(),
                "{command} {meshes}: {}",
                String::from_utf8_lossy(&run.stderr)
            );
            let place = |name: &str| {
                messages.find(name).unwrap_or_else(|| panic!("{command} {meshes}: {messages}"))
            };
            assert!(place("m_2.ply") < place("m_10.ply"), "{messages}");
        }
    }
    fs::create_dir(folder.path().join("empty")).unwrap();
    for command in ["check", "info"] {
        let run = meniscus(folder.path(), &[command, "empty"]);
        assert_eq!(run.status.code(), Some(3), "{}", String::from_utf8_lossy(&run.stderr));
    }
}

#[test]
fn info_estimates_the_memory_of_a_run_and_lists_readable_formats() {
    let frame = data("dambreak_small/ParticleData_Fluid_20.bgeo");
    let folder = TempDir::new().unwrap();
    let frame = frame.to_str().unwrap();
    let info = String::from_utf8(meniscus(folder.path(), &["info", frame]).stdout).unwrap();
    let (_, memory) = info.split_once("about ").unwrap();
    let (memory, _) = memory.split_once(" by default").unwrap();
    let run = meniscus(
        folder.path(),
        &["reconstruct", frame, "-o", "a.ply", "--dry-run", "--backend", "cpu"],
    );
    let run = String::from_utf8(run.stdout).unwrap();
    assert!(run.contains(&format!("memory: about {memory} of ")), "{memory}: {run}");
    assert!(run.contains("scratch: none") && run.contains("cells of 0.025 into"), "{run}");
    fs::write(folder.path().join("a.toml"), "").unwrap();
    let unknown = meniscus(folder.path(), &["info", "a.toml"]);
    let errors = String::from_utf8_lossy(&unknown.stderr);
    assert_eq!(unknown.status.code(), Some(2), "{errors}");
    assert!([".bgeo", ".mnf", ".stl"].iter().all(|known| errors.contains(known)), "{errors}");
}

#[test]
fn printed_numbers_are_rounded_and_json_has_all_digits() {
    let folder = folder_with_ball();
    let run =
        meniscus(folder.path(), &["reconstruct", "ball.xyz", "-o", "a.ply", "--spacing", "0.5"]);
    let notes = String::from_utf8(run.stderr).unwrap();
    assert!(notes.contains("spacing 0.5 (as given), cell size 0.25,"), "{notes}");
    assert!(
        notes.contains("measured density: 1.0") && notes.contains(" particles per cubed spacing"),
        "{notes}"
    );
    let digits = |text: &str| text.chars().filter(char::is_ascii_digit).count();
    for command in ["info", "check"] {
        let text = String::from_utf8(meniscus(folder.path(), &[command, "a.ply"]).stdout).unwrap();
        let corners = text.lines().find(|line| line.trim().starts_with("box")).unwrap();
        // The box has six numbers. Each has up to six digits, and maybe a zero before its decimal
        // point.
        assert!((12..=42).contains(&digits(corners)), "{corners}");
    }
    let json = meniscus(folder.path(), &["check", "--json", "a.ply"]);
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    assert!(json[0]["measures"]["area"].to_string().len() > 9, "{json}");
}

#[test]
fn every_setting_is_an_option_and_pack_refuses_surface_settings() {
    let folder = TempDir::new().unwrap();
    let help = |command: &str| {
        let run = meniscus(folder.path(), &[command, "--help"]);
        String::from_utf8(run.stdout).unwrap()
    };
    let [reconstruct, pack] = ["reconstruct", "pack"].map(help);
    fs::write(folder.path().join("one.xyz"), "0 0 0\n").unwrap();
    for setting in Settings::ALL {
        let option = format!("--{setting}");
        let is_listed =
            |help: &str| help.split_whitespace().any(|word| word.trim_end_matches(',') == option);
        assert!(is_listed(&reconstruct), "{option}");
        assert_eq!(is_listed(&pack), setting.is_of_samples(), "{option}");
    }
    pack_with_the_default_method(folder.path());
    let (later, never) = ("does not apply to packing", "is not supported when packing");
    for (given, message) in [
        (&["--smooth", "2"][..], later),
        (&["--normals"], later),
        (&["--method", "mueller"], never),
        (&["--up", "z"], later),
    ] {
        let run = meniscus(folder.path(), &[&["pack", "one.xyz", "-o", "one.mnf"], given].concat());
        let messages = String::from_utf8_lossy(&run.stderr).into_owned();
        assert_eq!(run.status.code(), Some(2), "{messages}");
        assert!(messages.contains(&format!("{} {message}", given[0])), "{messages}");
    }
}

/// Packs a particle, and reconstructs the packed frame. The options name the default method
/// explicitly.
fn pack_with_the_default_method(folder: &Path) {
    let given = ["--spacing", "1", "--method", "dif"];
    let pack = meniscus(folder, &[&["pack", "one.xyz", "-o", "given.mnf"], &given[..]].concat());
    assert!(pack.status.success(), "{}", String::from_utf8_lossy(&pack.stderr));
    let draw =
        meniscus(folder, &["reconstruct", "given.mnf", "-o", "given.ply", "--method", "dif"]);
    assert!(draw.status.success(), "{}", String::from_utf8_lossy(&draw.stderr));
    let named =
        meniscus(folder, &["reconstruct", "given.mnf", "-o", "named.ply", "--format", "csv"]);
    assert_eq!(named.status.code(), Some(2));
    let info = meniscus(folder, &["info", "given.mnf", "--format", "csv"]);
    assert!(String::from_utf8_lossy(&info.stdout).contains("packed frame"));
}

#[test]
fn a_given_format_overrides_the_file_extension() {
    let folder = folder_with_ball();
    let path = |name: &str| folder.path().join(name);
    let run = |arguments: &[&str], code: i32| {
        let run = meniscus(folder.path(), arguments);
        let messages = String::from_utf8_lossy(&[run.stdout, run.stderr].concat()).into_owned();
        assert_eq!(run.status.code(), Some(code), "{arguments:?}: {messages}");
        messages
    };
    run(&["reconstruct", "ball.xyz", "-o", "known.ply"], 0);
    let known = fs::read(path("known.ply")).unwrap();
    for name in ["dump", "dump_1.out", "dump_2.csv"] {
        fs::copy(path("ball.xyz"), path(name)).unwrap();
        run(&["reconstruct", name, "-o", "named.ply", "--format", "xyz", "--overwrite"], 0);
        assert!(fs::read(path("named.ply")).unwrap() == known, "{name}");
        assert!(run(&["info", name, "--format", "xyz"], 0).contains("spacing"));
    }
    let messages = run(&["reconstruct", "dump_1.out", "-o", "other.ply"], 2);
    assert!(messages.contains("extension") && messages.contains("--format"), "{messages}");
    // Reading the file in the wrong format gives an error.
    run(&["reconstruct", "dump_1.out", "-o", "other.ply", "--format", "bgeo"], 3);
    fs::copy(path("ball.xyz"), path("dump_3.out")).unwrap();
    run(&["reconstruct", "dump_{}.out", "-o", "out/m_{}.ply", "--format", "xyz"], 0);
    assert!(["m_1.ply", "m_3.ply"].iter().all(|mesh| path("out").join(mesh).is_file()));
    assert!(!path("other.ply").exists());
    let parts = ["reconstruct", "dump", "-o", "parts.ply", "--format", "xyz", "--parts", "2"];
    for step in [&["--plan"][..], &["--part", "0"], &["--part", "1"], &["--merge"]] {
        run(&[&parts[..], step].concat(), 0);
    }
    assert!(fs::read(path("parts.ply")).unwrap() == known);
}

#[test]
fn an_unknown_extension_leads_to_advice_on_the_format_in_every_command() {
    let folder = folder_with_ball();
    fs::rename(folder.path().join("ball.xyz"), folder.path().join("ball.unknown")).unwrap();
    for arguments in [
        &["info", "ball.unknown"][..],
        &["reconstruct", "ball.unknown", "-o", "m.ply"],
        &["pack", "ball.unknown", "-o", "m.mnf"],
    ] {
        let output = meniscus(folder.path(), arguments);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {errors}");
        assert!(errors.contains("ball.unknown") && errors.contains("--format"), "{errors}");
    }
}

#[test]
fn frames_inside_a_file_are_found_with_a_given_format() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let run = |arguments: &[&str], code: i32| {
        let run = meniscus(folder.path(), arguments);
        let messages = String::from_utf8_lossy(&[run.stdout, run.stderr].concat()).into_owned();
        assert_eq!(run.status.code(), Some(code), "{arguments:?}: {messages}");
        messages
    };
    let ball = fill(10.0, 2.0, 0.2, 3, |p| p.length() < 5.0);
    let frame = |by: f64| {
        let rows = ball.iter().map(|[x, y, z]| format!("O {} {y} {z}\n", x + by));
        format!("{}\n\n{}", ball.len(), rows.collect::<String>())
    };
    let frames = [0.0, 5.0].map(frame);
    fs::write(path("sim.xyz"), frames.concat()).unwrap();
    fs::write(path("one.xyz"), &frames[1]).unwrap();
    run(&["reconstruct", "sim.xyz", "-o", "known/"], 0);
    let known = ["sim_0.ply", "sim_1.ply"].map(|mesh| fs::read(path("known").join(mesh)).unwrap());
    // --format also applies to a name without an extension or with the extension of another format.
    for (number, name) in ["sim", "sim.out", "sim.vtk"].iter().enumerate() {
        fs::copy(path("sim.xyz"), path(name)).unwrap();
        let out = format!("out_{number}");
        run(&["reconstruct", name, "-o", &format!("{out}/"), "--format", "xyz"], 0);
        let made = ["sim_0.ply", "sim_1.ply"].map(|m| fs::read(path(&out).join(m)).unwrap());
        assert!(made == known, "{name}");
        let second = format!("{name}#1");
        run(&["reconstruct", &second, "-o", "second.ply", "--format", "xyz", "--overwrite"], 0);
        run(&["reconstruct", "one.xyz", "-o", "one.ply", "--overwrite"], 0);
        assert!(fs::read(path("second.ply")).unwrap() == fs::read(path("one.ply")).unwrap());
        assert!(run(&["info", &second, "--format", "xyz"], 0).contains("XYZ"));
    }
    // --format also applies to the files of a list.
    fs::write(
        path("list.pvd"),
        "<VTKFile type=\"Collection\"><Collection><DataSet timestep=\"0\" file=\"sim#0\"/>\
         <DataSet timestep=\"1\" file=\"sim#1\"/></Collection></VTKFile>",
    )
    .unwrap();
    run(&["reconstruct", "list.pvd", "-o", "listed/", "--format", "xyz"], 0);
    let made = ["list_0.ply", "list_1.ply"].map(|m| fs::read(path("listed").join(m)).unwrap());
    assert!(made == known);
    // A step cannot be selected in a format with a single frame.
    fs::copy(path("one.xyz"), path("points.json")).unwrap();
    let messages = run(&["info", "points.json#0"], 3);
    assert!(messages.contains("single frame"), "{messages}");
}
