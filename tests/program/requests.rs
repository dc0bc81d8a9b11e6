//! Tests of unusual requests: the program loses and overwrites no files, and rejects invalid
//! requests before it starts.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

use glam::{DVec3, IVec3};
use meniscus::internals::io::output::read_mesh;
use serde_json::Value;
use tempfile::TempDir;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use crate::common::files::{raw, tree};
use crate::common::fill;
use crate::common::program::{command, run, wait_until};
use crate::common::scene::Random;

/// Runs the program, which must exit with code 2 and this message, and leave the folder unchanged.
#[track_caller]
fn refused(folder: &Path, arguments: &[&str], message: &str) {
    let before = tree(folder);
    let errors = run(folder, arguments, 2);
    assert!(errors.contains(message), "{arguments:?} does not print {message:?}: {errors}");
    assert!(tree(folder) == before, "{arguments:?} changed the folder");
}

fn ball(radius: f64) -> Vec<[f64; 3]> {
    fill(2.0 * radius, 1.0, 0.3, 1, |p| p.length() < radius)
}

/// Particles as a .ply file, whose extension could also be that of a mesh.
fn ply(particles: &[[f64; 3]]) -> Vec<u8> {
    let count = particles.len();
    let header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n\
         property float z\nend_header\n"
    );
    [header.into_bytes(), raw(particles)].concat()
}

/// A folder with frames of these names. Each frame is a ball.
fn frames(names: &[&str]) -> TempDir {
    let folder = TempDir::new().unwrap();
    for name in names {
        let ball = ball(4.0);
        let bytes = if name.ends_with(".ply") { ply(&ball) } else { raw(&ball) };
        fs::write(folder.path().join(name), bytes).unwrap();
    }
    folder
}

#[test]
fn statistics_cannot_have_the_path_of_the_preview_picture() {
    let folder = frames(&["f_1.xyz", "f_2.xyz"]);
    refused(
        folder.path(),
        &[
            "reconstruct",
            "f_1.xyz",
            "-o",
            "a.ply",
            "--preview",
            "--stats",
            "a.png",
            "--spacing",
            "1",
        ],
        "a.png",
    );
    refused(
        folder.path(),
        &[
            "reconstruct",
            "f_{}.xyz",
            "-o",
            "m_{}.ply",
            "--preview",
            "--stats",
            "m.png",
            "--spacing",
            "1",
        ],
        "m.png",
    );
}

#[test]
fn a_single_frame_deletes_temporary_files_of_killed_processes() {
    let folder = frames(&["f.xyz"]);
    let left = folder.path().join(".meniscus-left.tmp");
    let mut before: Vec<_> = tree(folder.path()).into_keys().collect();
    for arguments in [
        ["reconstruct", "f.xyz", "-o", "a.ply", "--spacing", "1"],
        ["pack", "f.xyz", "-o", "a.mnf", "--spacing", "1"],
    ] {
        fs::write(&left, "half").unwrap();
        run(folder.path(), &arguments, 0);
        before.push(arguments[3].to_owned());
        before.sort();
        assert_eq!(tree(folder.path()).into_keys().collect::<Vec<_>>(), before);
    }
}

#[test]
fn a_folder_in_place_of_one_output_does_not_stop_other_frames() {
    let folder = frames(&["f_1.xyz", "f_2.xyz", "f_3.xyz"]);
    let all = ["reconstruct", "f_{}.xyz", "-o", "out/m_{}.ply", "--spacing", "1"];
    fs::create_dir_all(folder.path().join("out/m_2.ply")).unwrap();
    let errors = run(folder.path(), &[&all[..], &["--overwrite"]].concat(), 1);
    assert!(errors.contains("m_2.ply"), "{errors}");
    for frame in [1, 3] {
        assert!(folder.path().join(format!("out/m_{frame}.ply")).is_file(), "{errors}");
    }
}

#[test]
fn an_unwritable_standard_error_does_not_stop_the_work() {
    let folder = frames(&["f_1.xyz", "f_2.xyz"]);
    let streams: [fn() -> Stdio; 2] = [
        || {
            let (reader, writer) = std::io::pipe().unwrap();
            drop(reader);
            writer.into()
        },
        || File::options().write(true).open("/dev/full").unwrap().into(),
    ];
    for stream in streams {
        for (arguments, made) in [
            (&["f_1.xyz", "-o", "one.ply", "--verbose"][..], "one.ply"),
            (&["f_{}.xyz", "-o", "m_{}.ply"], "m_2.ply"),
            (&["f_{}.xyz", "-o", "n_{}.vtp", "--progress", "always"], "n.pvd"),
        ] {
            let all = [&["reconstruct"], arguments, &["--spacing", "1", "--overwrite"]].concat();
            let status = command(folder.path(), &all).stderr(stream()).status().unwrap();
            assert_eq!(status.code(), Some(0), "{arguments:?}");
            fs::remove_file(folder.path().join(made)).unwrap();
        }
        let wrong = command(folder.path(), &["reconstruct", "none.xyz", "-o", "a.ply"])
            .stderr(stream())
            .status();
        assert_eq!(wrong.unwrap().code(), Some(3));
    }
}

#[test]
fn output_meshes_in_the_input_folder_are_not_taken_for_frames() {
    let folder = frames(&["f_1.xyz", "f_2.xyz"]);
    let at = |name: &str| folder.path().join(name);
    for extension in ["ply", "vtk", "vtp"] {
        let output = format!("f_{{}}.{extension}");
        run(folder.path(), &["reconstruct", ".", "-o", &output, "--spacing", "1"], 0);
        let made = tree(folder.path());
        assert_eq!(
            made.keys().filter(|name| name.ends_with(&format!("_1.{extension}"))).count(),
            1
        );
        // Neither the outputs of this run nor those of earlier runs are inputs.
        let again = ["reconstruct", ".", "-o", &output, "--spacing", "1", "--resume"];
        assert!(run(folder.path(), &again, 0).contains("2 of 2 frames are already finished"));
    }
    run(folder.path(), &["reconstruct", "*.xyz", "-o", "g_{}.ply", "--spacing", "1"], 0);
    // Watch a simulation, and write the meshes into its folder.
    let watching = frames(&["f_1.xyz"]);
    let arguments =
        ["reconstruct", ".", "-o", "m_{}.vtk", "--spacing", "1", "--watch=30", "--end", "3"];
    let mut child = command(watching.path(), &arguments).stderr(Stdio::piped()).spawn().unwrap();
    for frame in 2..=3 {
        let made = format!("m_{}.vtk", frame - 1);
        wait_until(&mut child, &made, |_| watching.path().join(&made).exists());
        fs::copy(at("f_1.xyz"), watching.path().join(format!("f_{frame}.xyz"))).unwrap();
    }
    let output = child.wait_with_output().unwrap();
    let errors = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{errors}");
    for frame in 1..=3 {
        read_mesh(&watching.path().join(format!("m_{frame}.vtk"))).unwrap();
    }
}

#[test]
fn a_folder_of_meshes_is_refused_as_input() {
    let folder = frames(&["f_1.xyz", "f_2.xyz"]);
    run(folder.path(), &["reconstruct", ".", "-o", "made/", "--spacing", "1"], 0);
    refused(
        folder.path(),
        &["reconstruct", "made", "-o", "again/", "--spacing", "1"],
        "contains meshes, but no particles",
    );
    refused(
        folder.path(),
        &["reconstruct", "made", "-o", "m_{}.ply", "--spacing", "1"],
        "contains meshes",
    );
}

#[test]
fn outputs_named_like_input_frames_are_refused() {
    let folder = frames(&["f_1.ply", "f_2.ply"]);
    refused(
        folder.path(),
        &["reconstruct", ".", "-o", "f_{:04}.ply"],
        "would look like an input frame",
    );
    refused(
        folder.path(),
        &["reconstruct", "*.ply", "-o", "f_{:04}.ply"],
        "would look like an input frame",
    );
    refused(
        folder.path(),
        &["reconstruct", "f_{}.ply", "-o", "f_1{}.ply"],
        "would look like an input frame",
    );
    refused(folder.path(), &["reconstruct", "f_{}.ply", "-o", "f_{}.ply"], "choose another output");
    refused(folder.path(), &["reconstruct", ".", "-o", "./"], "choose another output");
    run(folder.path(), &["reconstruct", ".", "-o", "mesh_{}.ply", "--spacing", "1"], 0);
}

#[cfg(unix)]
#[test]
fn inputs_are_not_overwritten_through_links_or_other_paths() {
    let folder = frames(&["f_1.xyz", "f_2.xyz"]);
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("out")).unwrap();
    let all = |more: &[&'static str]| -> Vec<&'static str> {
        [&["reconstruct", "f_{}.xyz", "-o", "out/m_{}.ply", "--spacing", "1", "--overwrite"], more]
            .concat()
    };
    std::os::unix::fs::symlink(path("f_1.xyz"), path("out/m_2.ply")).unwrap();
    refused(folder.path(), &all(&[]), "f_1.xyz");
    fs::remove_file(path("out/m_2.ply")).unwrap();
    fs::hard_link(path("f_2.xyz"), path("out/m_1.ply")).unwrap();
    refused(folder.path(), &all(&[]), "f_2.xyz");
    fs::remove_file(path("out/m_1.ply")).unwrap();
    fs::hard_link(path("f_2.xyz"), path("linked.json")).unwrap();
    for stats in [
        "f_1.xyz",
        "./f_2.xyz",
        "linked.json",
        "out/m_1.ply",
        "out/../out/m_2.ply",
        "out/m.ply.series",
    ] {
        refused(folder.path(), &all(&["--stats", stats]), stats);
    }
    // The conversion of a single frame must not overwrite inputs either.
    let one = [
        "reconstruct",
        "f_2.xyz",
        "-o",
        "a.ply",
        "--spacing",
        "1",
        "--overwrite",
        "--stats",
        "linked.json",
    ];
    refused(folder.path(), &one, "linked.json");
    fs::hard_link(path("f_2.xyz"), path("b.ply")).unwrap();
    refused(
        folder.path(),
        &["reconstruct", "f_2.xyz", "-o", "b.ply", "--spacing", "1", "--overwrite"],
        "b.ply",
    );
    refused(folder.path(), &["pack", "f_2.xyz", "-o", "f_2.mnf", "--spacing", "0"], "--spacing");
}

#[test]
fn unwritable_statistics_are_refused_before_the_work() {
    let folder = frames(&["f_1.xyz"]);
    fs::write(folder.path().join("notes.txt"), "remember\n").unwrap();
    fs::write(folder.path().join("empty"), "").unwrap();
    let inputs = [["f_1.xyz", "a.ply"], ["f_{}.xyz", "a_{}.ply"]];
    for [input, output] in inputs {
        let with = |stats| {
            ["reconstruct", input, "-o", output, "--spacing", "1", "--overwrite", "--stats", stats]
        };
        for (stats, code) in [("none/s.json", 4), ("notes.txt", 2)] {
            let before = tree(folder.path());
            assert!(run(folder.path(), &with(stats), code).contains(stats));
            assert!(tree(folder.path()) == before, "{input}, {stats}");
        }
        // Records are appended to an empty file and to other records.
        run(folder.path(), &with("empty"), 0);
        run(folder.path(), &with("empty"), 0);
    }
    assert_eq!(fs::read_to_string(folder.path().join("empty")).unwrap().lines().count(), 4);
}

#[test]
fn gaps_in_frame_numbers_are_reported_as_ranges() {
    let names = [
        "f_0.xyz",
        "f_1700000000000000000.xyz",
        "f_1700000000016666667.xyz",
        "f_9223372036854775807.xyz",
    ];
    let folder = frames(&names);
    let notes = run(folder.path(), &["reconstruct", ".", "-o", "m_{}.ply", "--spacing", "1"], 0);
    assert!(notes.contains("no files for frames 1 to 1699999999999999999"), "{notes}");
    assert!(notes.len() < 2000, "{notes}");
    let folder = frames(&["f_1.xyz", "f_2.xyz", "f_3.xyz", "f_4.xyz", "f_7.xyz"]);
    let notes = run(folder.path(), &["reconstruct", ".", "-o", "m_{}.ply", "--spacing", "1"], 1);
    assert!(notes.contains("2 frames failed") && notes.contains("frames 5 to 6: "), "{notes}");
    let part = ["reconstruct", ".", "-o", "n_{}.ply", "--spacing", "1", "--frames", "1..5"];
    let notes = run(folder.path(), &part, 1);
    assert!(notes.contains("1 frame failed") && notes.contains("frame 5: "), "{notes}");
}

#[test]
fn out_of_range_and_ambiguous_frame_numbers_are_refused_with_advice() {
    let folder = frames(&["f_99999999999999999999999.xyz", "f_1.xyz"]);
    for inputs in [".", "f_{}.xyz", "*.xyz"] {
        refused(
            folder.path(),
            &["reconstruct", inputs, "-o", "m_{}.ply"],
            "must be from -9223372036854775808 to 9223372036854775807",
        );
    }
    let folder = frames(&["f_3.1.xyz", "f_3.15.xyz", "f_3.2.xyz"]);
    refused(folder.path(), &["reconstruct", ".", "-o", "m_{}.ply"], "f_3.{}.xyz");
    refused(folder.path(), &["reconstruct", "f_{}.xyz", "-o", "m_{}.ply"], "f_{time}.xyz");
    run(folder.path(), &["reconstruct", "f_3.{}.xyz", "-o", "m_{}.ply", "--spacing", "1"], 0);
    run(folder.path(), &["reconstruct", "f_{time}.xyz", "-o", "t_{}.ply", "--spacing", "1"], 0);
    let folder = frames(&["f_0.1.xyz", "f_0.2.xyz", "f_0.3.xyz"]);
    run(folder.path(), &["reconstruct", ".", "-o", "m_{}.ply", "--spacing", "1"], 0);
}

#[test]
fn non_finite_and_extreme_option_values_are_refused_with_their_range() {
    let folder = frames(&["f_1.xyz"]);
    let with = |more: &[&'static str]| -> Vec<&'static str> {
        [&["reconstruct", "f_{}.xyz", "-o", "m_{}.ply", "--spacing", "1"], more].concat()
    };
    refused(
        folder.path(),
        &with(&["--origin", "nan,0,0"]),
        "--origin must be three finite numbers, got NaN",
    );
    refused(
        folder.path(),
        &with(&["--origin", "0,-inf,0"]),
        "--origin must be three finite numbers, got -inf",
    );
    for fps in ["5e-324", "1e300", "0", "nan"] {
        refused(folder.path(), &with(&["--fps", fps]), "--fps must be from 1e-9 to 1e9");
    }
    refused(folder.path(), &with(&["--start", "5", "--end", "3"]), "--start 5 is after --end 3");
    let notes =
        run(folder.path(), &["reconstruct", "f_1.xyz", "-o", "tiny.ply", "--spacing", "1e-320"], 3);
    assert!(notes.contains("cells of size 4.99994e-321"), "{notes}");
    let tiny: Vec<[f64; 3]> = ball(4.0).iter().map(|p| p.map(|x| x * 1e-8)).collect();
    fs::write(folder.path().join("tiny.xyz"), raw(&tiny)).unwrap();
    let notes =
        run(folder.path(), &["reconstruct", "tiny.xyz", "-o", "tiny.ply", "--spacing", "1e-8"], 0);
    assert!(notes.contains("spacing 1e-8 (as given), cell size 5e-9"), "{notes}");
}

#[test]
fn resume_remakes_a_mesh_with_a_changed_byte() {
    let folder = frames(&["f_1.xyz", "f_2.xyz"]);
    let all = ["reconstruct", "f_{}.xyz", "-o", "m_{}.ply", "--spacing", "1", "--resume"];
    run(folder.path(), &all, 0);
    let path = folder.path().join("m_2.ply");
    let whole = fs::read(&path).unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    fs::write(&path, flipped).unwrap();
    assert!(run(folder.path(), &all, 0).contains("1 of 2 frames are already finished"));
    assert!(fs::read(&path).unwrap() == whole);
    // A copy of the mesh with the same bytes counts as finished.
    fs::write(&path, &whole).unwrap();
    assert!(run(folder.path(), &all, 0).contains("2 of 2 frames are already finished"));
}

#[test]
fn watch_converts_a_frame_again_when_its_file_grows() {
    let folder = frames(&["f_1.xyz"]);
    let path = folder.path().join("f_1.xyz");
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() / 24 * 12]).unwrap();
    let arguments = ["reconstruct", "f_{}.xyz", "-o", "m_{}.ply", "--spacing", "1", "--watch=6"];
    let mut child = command(folder.path(), &arguments).stderr(Stdio::piped()).spawn().unwrap();
    let made = folder.path().join("m_1.ply");
    wait_until(&mut child, "m_1.ply", |_| made.exists());
    let of_part = fs::read(&made).unwrap();
    fs::write(&path, &whole).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let plain = frames(&["f_1.xyz"]);
    run(plain.path(), &["reconstruct", "f_{}.xyz", "-o", "m_{}.ply", "--spacing", "1"], 0);
    let expected = fs::read(plain.path().join("m_1.ply")).unwrap();
    assert!(of_part != expected && fs::read(&made).unwrap() == expected);
}

#[test]
fn attribute_values_beyond_f32_are_reported() {
    let folder = TempDir::new().unwrap();
    let particles = ball(4.0);
    let row = |p: &[f64; 3], value: f64| format!("{},{},{},{value:e}\n", p[0], p[1], p[2]);
    let text = |value: fn(usize) -> f64| -> String {
        let rows = particles.iter().enumerate().map(|(i, p)| row(p, value(i)));
        ["x,y,z,heat\n".to_owned()].into_iter().chain(rows).collect()
    };
    fs::write(folder.path().join("f_1.csv"), text(|_| 1e300)).unwrap();
    fs::write(folder.path().join("f_2.csv"), text(|i| if i == 0 { 1e300 } else { 7.0 })).unwrap();
    let heat = ["--spacing", "1", "--attributes", "heat"];
    let one = [&["reconstruct", "f_1.csv", "-o", "a.ply"], &heat[..]].concat();
    let count = particles.len();
    let notes = run(folder.path(), &one, 0);
    assert!(
        notes.contains(&format!(
            "heat is NaN, infinite or too large for a 32-bit float in all {count} particles"
        )),
        "{notes}"
    );
    let all = [&["reconstruct", "f_{}.csv", "-o", "m_{}.ply"], &heat[..]].concat();
    let notes = run(folder.path(), &all, 0);
    assert!(
        notes.contains(&format!(
            "f_2.csv: heat is NaN, infinite or too large for a 32-bit float in 1 of {count} \
             particles"
        )),
        "{notes}"
    );
    let mesh = read_mesh(&folder.path().join("m_2.ply")).unwrap();
    assert!(mesh.attributes[0].values.iter().all(|value| (value - 7.0).abs() < 1e-4));
    // The message must be the same with so little memory that particles are spilled.
    let spilled = [&all[..], &["--overwrite", "--memory", "16MiB", "--threads", "1"]].concat();
    assert!(run(folder.path(), &spilled, 0).contains(&format!(
        "f_2.csv: heat is NaN, infinite or too large for a 32-bit float in 1 of {count} particles"
    )));
}

#[test]
fn a_wrong_spacing_of_the_scene_or_the_option_causes_a_warning() {
    let folder = frames(&["f_1.xyz"]);
    let particles: Vec<[f64; 3]> = fill(16.0, 1.0, 0.3, 1, |p| p.length() < 8.0);
    fs::write(folder.path().join("f_1.xyz"), raw(&particles)).unwrap();
    fs::write(folder.path().join("scene.json"), r#"{"Configuration": {"particleRadius": 10.0}}"#)
        .unwrap();
    for arguments in [["f_1.xyz", "-o", "a.ply"], ["f_{}.xyz", "-o", "m_{}.ply"]] {
        let notes = run(folder.path(), &[&["reconstruct"], &arguments[..]].concat(), 0);
        assert!(
            notes.contains("spacing 20 (from ") && notes.contains("looks too large"),
            "{notes}"
        );
    }
    fs::write(folder.path().join("scene.json"), r#"{"Configuration": {"particleRadius": 0.5}}"#)
        .unwrap();
    let notes = run(folder.path(), &["reconstruct", "f_1.xyz", "-o", "b.ply"], 0);
    assert!(!notes.contains("looks too"), "{notes}");
    // The program uses a wrong --spacing, but prints a warning.
    for arguments in [["f_1.xyz", "-o", "c.ply"], ["f_{}.xyz", "-o", "n_{}.ply"]] {
        for spacing in ["20", "1e9", "1e300"] {
            let given = ["--spacing", spacing, "--overwrite"];
            let notes = run(folder.path(), &[&["reconstruct"], &arguments[..], &given].concat(), 0);
            assert!(notes.contains("looks too large"), "{spacing}: {notes}");
        }
    }
}

#[test]
fn simplified_drops_of_a_few_triangles_keep_a_positive_volume() {
    let folder = TempDir::new().unwrap();
    let step = DVec3::new(7.13, 7.21, 7.37);
    let places = || (0..1728).map(|i| IVec3::new(i % 12, i / 12 % 12, i / 144));
    let mut random = Random::new(1);
    for (particles, cell, tolerance) in
        [(1, "1.6", "1"), (1, "0.7", "2"), (2, "0.5", "2"), (3, "1.6", "2")]
    {
        let mut drops = Vec::new();
        for place in places() {
            for _ in 0..particles {
                let shift = DVec3::new(random.unit(), random.unit(), random.unit());
                drops.push((place.as_dvec3() * step + 0.9 * shift).to_array());
            }
        }
        fs::write(folder.path().join("drops.xyz"), raw(&drops)).unwrap();
        let simplified =
            ["reconstruct", "drops.xyz", "-o", "drops.ply", "--spacing", "1", "--overwrite"];
        run(
            folder.path(),
            &[&simplified[..], &["--cell", cell, "--simplify", tolerance]].concat(),
            0,
        );
        let checked = command(folder.path(), &["check", "drops.ply", "--json"]).output().unwrap();
        let report: Value = serde_json::from_slice(&checked.stdout).unwrap();
        assert_eq!(report[0]["measures"]["flat_components"], 0, "cells of {cell}: {report:#}");
        assert_eq!(checked.status.code(), Some(0), "cells of {cell}");
        // Check that each drop has a positive volume, so that no drop is inside out.
        let mesh = read_mesh(&folder.path().join("drops.ply")).unwrap();
        let mut volumes: BTreeMap<[i32; 3], f64> =
            places().map(|place| (place.to_array(), 0.0)).collect();
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|vertex| DVec3::from(mesh.positions[vertex as usize]));
            let place = ((a - 0.45) / step).round();
            let [a, b, c] = [a, b, c].map(|corner| corner - place * step);
            *volumes.get_mut(&place.as_ivec3().to_array()).unwrap() += a.dot(b.cross(c)) / 6.0;
        }
        volumes.retain(|_, volume| *volume <= 0.001);
        assert!(volumes.is_empty(), "{particles} particles in cells of {cell}: {volumes:?}");
    }
}

#[test]
fn a_compressed_archive_is_read_within_the_memory_budget() {
    let folder = TempDir::new().unwrap();
    let mut random = Random::new(2);
    let count = 1 << 21;
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({count}, 3), }}");
    let header = format!("{header:<117}\n");
    let mut archive = ZipWriter::new(File::create(folder.path().join("f.npz")).unwrap());
    let deflated = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
    for array in ["vel.npy", "pos.npy"] {
        let values: Vec<u8> =
            (0..3 * count).flat_map(|_| ((128.0 * random.unit()) as f32).to_le_bytes()).collect();
        archive.start_file(array, deflated).unwrap();
        archive.write_all(b"\x93NUMPY\x01\x00\x76\x00").unwrap();
        archive.write_all(header.as_bytes()).unwrap();
        archive.write_all(&values).unwrap();
    }
    archive.finish().unwrap();
    let packed = fs::metadata(folder.path().join("f.npz")).unwrap().len();
    assert!(packed > 40 << 20, "{packed} bytes: the archive is too small for this test");
    let arguments =
        ["reconstruct", "f.npz", "-o", "f.ply", "--spacing", "1", "--cell", "1", "--threads", "1"];
    run(
        folder.path(),
        &[&arguments[..], &["--memory", "24MiB", "--stats", "stats.jsonl"]].concat(),
        0,
    );
    let stats: Value =
        serde_json::from_slice(&fs::read(folder.path().join("stats.jsonl")).unwrap()).unwrap();
    assert_eq!(stats["particles"], count);
    if let Some(peak) = stats["peak_resident_bytes"].as_u64() {
        assert!(peak < 32 << 20, "{peak} bytes");
    }
}

#[test]
fn vertices_that_coincide_in_f32_are_reported_for_stl() {
    let folder = TempDir::new().unwrap();
    let mut merged = 0;
    for far in [0.0, 300.0, 1000.0, 3000.0, 8000.0] {
        let particles: Vec<[f64; 3]> = ball(5.0).iter().map(|p| p.map(|x| x + far)).collect();
        fs::write(folder.path().join("f_1.xyz"), raw(&particles)).unwrap();
        let with = |output: &'static str| {
            run(
                folder.path(),
                &[
                    "reconstruct",
                    "f_1.xyz",
                    "-o",
                    output,
                    "--spacing",
                    "1",
                    "--cell",
                    "0.25",
                    "--overwrite",
                ],
                0,
            )
        };
        with("a.ply");
        let notes = with("a.stl");
        let [whole, joined] = ["a.ply", "a.stl"]
            .map(|name| read_mesh(&folder.path().join(name)).unwrap().positions.len());
        assert_eq!(
            notes.contains("the same position as another vertex"),
            joined < whole,
            "{far}: {joined} of {whole}: {notes}"
        );
        if joined < whole {
            assert!(
                notes.contains(&format!("warning: {} vert", whole - joined)),
                "{far}: {joined} of {whole}: {notes}"
            );
            merged += 1;
        }
        let all = [
            "reconstruct",
            "f_{}.xyz",
            "-o",
            "m_{}.stl",
            "--spacing",
            "1",
            "--cell",
            "0.25",
            "--overwrite",
        ];
        assert_eq!(
            run(folder.path(), &all, 0).contains("the same position as another vertex"),
            joined < whole,
            "{far}"
        );
    }
    assert!(merged > 0, "no position made vertices coincide");
}

#[test]
fn check_reports_components_without_volume() {
    let folder = TempDir::new().unwrap();
    let twins = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 5 5\nv 6 5 5\nv 5 6 5\nv 5 5 6\n\
                 f 1 2 3\nf 1 3 2\nf 4 6 5\nf 4 5 7\nf 4 7 6\nf 5 6 7\n";
    fs::write(folder.path().join("twins.obj"), twins).unwrap();
    let output = command(folder.path(), &["check", "twins.obj"]).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        text.contains("components                2")
            && text.contains("components without volume 1"),
        "{text}"
    );
}

#[test]
fn particles_missing_from_the_surface_are_counted_and_reported() {
    let folder = TempDir::new().unwrap();
    let body =
        fill(22.0, 1.0, 0.2, 1, |p| p.length() < 22.0 && (p - DVec3::splat(5.0)).length() > 11.0);
    let spray = (0..200).map(|i| {
        let [x, y] = [i % 20, i / 20].map(|i| 40.0 + 9.13 * f64::from(i));
        [if i % 2 == 0 { x } else { -x }, y, 0.0]
    });
    let [bubble, spray] = [vec![[5.0; 3]; 1], spray.collect()];
    let all = |name: &str, parts: &[&[[f64; 3]]]| {
        fs::write(folder.path().join(name), raw(&parts.concat())).unwrap()
    };
    all("f_1.xyz", &[&body]);
    all("f_2.xyz", &[&body, &bubble]);
    all("f_3.xyz", &[&body, &spray, &bubble]);
    all("f_4.xyz", &[&[[f64::NAN; 3]; 7], &[[f64::INFINITY; 3]; 5]]);
    let symmetry = ["--spacing", "1", "--indicator", "symmetry", "--overwrite"];
    let with = |arguments: &[&'static str]| {
        run(folder.path(), &[&["reconstruct"], arguments, &symmetry].concat(), 0)
    };
    let count = body.len() + 201;
    let warning = format!("warning: at least 201 of {count} particles are outside the surface");
    let notes = with(&["f_3.xyz", "-o", "a.ply"]);
    assert!(notes.contains(&warning), "{notes}");
    for budget in [&[][..], &["--memory", "16MiB", "--threads", "1"]] {
        let notes = with(&[&["f_3.xyz", "-o", "a.ply"], budget].concat());
        assert!(notes.contains(&warning), "{budget:?}: {notes}");
    }
    for few in ["f_1.xyz", "f_2.xyz"] {
        let notes = with(&[few, "-o", "a.ply"]);
        assert!(!notes.contains("outside the surface"), "{few}: {notes}");
    }
    // The cloud indicator keeps every particle.
    let clouds =
        run(folder.path(), &["reconstruct", "f_3.xyz", "-o", "b.ply", "--spacing", "1"], 0);
    assert!(!clouds.contains("outside the surface"), "{clouds}");
    let kernels = [
        "reconstruct",
        "f_3.xyz",
        "-o",
        "c.ply",
        "--spacing",
        "1",
        "--method",
        "zhu-bridson",
        "--cell",
        "4",
    ];
    let kernels = run(folder.path(), &kernels, 0);
    assert!(kernels.contains("outside the surface"), "{kernels}");
    // A simulation reports the sum over all frames, including frames in which every particle is
    // lost.
    let notes = with(&["f_{}.xyz", "-o", "m_{}.ply", "--stats", "stats.jsonl", "--skip-invalid"]);
    assert!(
        notes.contains(&format!("at least 202 of {} particles", 3 * body.len() + 202)),
        "{notes}"
    );
    assert!(notes.contains("12 particles skipped: a coordinate is not finite"), "{notes}");
    let stats = fs::read_to_string(folder.path().join("stats.jsonl")).unwrap();
    let lost = |line: &str| -> (u64, u64) {
        let line: Value = serde_json::from_str(line).unwrap();
        (line["frame"].as_u64().unwrap(), line["in_no_surface"].as_u64().unwrap())
    };
    let lost: BTreeMap<u64, u64> = stats.lines().map(lost).collect();
    assert_eq!(lost.into_iter().collect::<Vec<_>>(), [(1, 0), (2, 1), (3, 201), (4, 0)]);
}

#[test]
fn two_particle_spacings_cause_a_warning_but_a_thinning_fluid_does_not() {
    let folder = TempDir::new().unwrap();
    let at = |spacing: f64, from: f64| -> Vec<[f64; 3]> {
        let part = fill(12.0, 1.0 / spacing, 0.3, 7, |_| true);
        part.iter().map(|p| [p[0] + from, p[1], p[2]]).collect()
    };
    let of = |parts: &[Vec<[f64; 3]>]| {
        fs::write(folder.path().join("f.xyz"), raw(&parts.concat())).unwrap();
        run(folder.path(), &["reconstruct", "f.xyz", "-o", "f.ply", "--overwrite"], 0)
    };
    for fine in [0.5, 0.4, 0.3] {
        let notes = of(&[at(1.0, 0.0), at(fine, 24.0)]);
        assert!(notes.contains("the particles have two spacings"), "{fine}: {notes}");
        let spacings = notes.split("two spacings, ").nth(1).unwrap();
        let [a, b] = [0, 2]
            .map(|word| spacings.split([' ', ';']).nth(word).unwrap().parse::<f64>().unwrap());
        assert!((a / fine - 1.0).abs() < 0.05 && (b - 1.0).abs() < 0.1, "{fine}: {a} and {b}");
    }
    assert!(!of(&[at(1.0, 0.0)]).contains("two spacings"));
    let thinning: Vec<[f64; 3]> = fill(20.0, 2.0, 0.3, 3, |_| true)
        .into_iter()
        .enumerate()
        .filter(|(i, p)| (*i as f64 * 0.618_034).fract() < (-0.1 * (p[0] + 20.0)).exp())
        .map(|(_, p)| p)
        .collect();
    let notes = of(&[thinning]);
    assert!(!notes.contains("two spacings"), "{notes}");
}
