//! Tests of simulations with the program: every way to run it gives the same bytes, bad frames do
//! not stop other frames, and no temporary files remain.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use glam::{DQuat, DVec3, EulerRot};
use meniscus::files::{Info, info};
use meniscus::internals::io::output::read_mesh;
use meniscus::internals::particles::AttributeKind;
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::check::check;
use meniscus::internals::surface::mesh::measure::measure;
use serde_json::Value;
use tempfile::TempDir;

use crate::common::files::{data, raw, tree};
use crate::common::scene::Random;
use crate::common::{fill, program};

fn command(folder: &Path, arguments: &[&str]) -> Command {
    program::command(folder, &[&["reconstruct"], arguments].concat())
}

#[track_caller]
fn run(folder: &Path, arguments: &[&str], code: i32) -> String {
    program::run(folder, &[&["reconstruct"], arguments].concat(), code)
}

/// A folder with frames of a falling ball of disordered particles, in `in/f_N.xyz`.
fn falling(frames: std::ops::RangeInclusive<u64>) -> TempDir {
    let folder = TempDir::new().unwrap();
    fs::create_dir(folder.path().join("in")).unwrap();
    for frame in frames {
        fs::write(folder.path().join(format!("in/f_{frame}.xyz")), raw(&ball(frame))).unwrap();
    }
    folder
}

fn ball(frame: u64) -> Vec<[f64; 3]> {
    let fall = DVec3::new(0.0, -0.07 * frame as f64, 0.0);
    let ball = fill(10.0, 2.0, 0.4, frame, |p| p.length() < 5.0);
    ball.into_iter().map(|p| (DVec3::from(p) + fall).to_array()).collect()
}

const ALL: [&str; 3] = ["in/f_{}.xyz", "-o", "out/m_{}.ply"];

fn with<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&ALL[..], more].concat()
}

#[test]
fn outputs_are_independent_of_threads_memory_jobs_and_job_order() {
    let folder = falling(1..=9);
    let bytes = |runs: &[&[&str]]| {
        let out = folder.path().join("out");
        let _ = fs::remove_dir_all(&out);
        runs.iter().for_each(|options| drop(run(folder.path(), &with(options), 0)));
        tree(&out)
    };
    let first = bytes(&[&["--threads", "1"]]);
    assert_eq!(first.len(), 9 + 4, "9 meshes, the records, the state and two listings");
    assert!(first == bytes(&[&["--threads", "3"]]));
    assert!(first == bytes(&[&["--threads", "2", "--memory", "130MiB"]]));
    // The last job writes the listings, which must contain the frames of all jobs.
    assert!(first == bytes(&[&["--frames", "6..9"], &["--frames", "1..2"], &["--frames", "3..5"]]));
    assert!(first == bytes(&[&["--plan"], &["--frames", "4..9"], &["--resume"]]));
}

#[test]
fn resuming_remakes_only_frames_that_are_damaged_unrecorded_or_changed() {
    let folder = falling(1..=8);
    run(folder.path(), &ALL, 0);
    let out = folder.path().join("out");
    let whole = tree(&out);
    let times = || -> Vec<_> {
        (1..=8)
            .map(|i| out.join(format!("m_{i}.ply")).metadata().unwrap().modified().unwrap())
            .collect()
    };
    let before = times();

    fs::remove_file(out.join("m_2.ply")).unwrap();
    fs::write(out.join("m_3.ply"), "ply").unwrap();
    let records = out.join("m.ply.meniscus/frames.jsonl");
    let text = fs::read_to_string(&records).unwrap();
    let mut lines: Vec<&str> = text.lines().collect();
    lines[4] = "{";
    lines.remove(3);
    fs::write(&records, lines.join("\n")).unwrap();
    fs::write(out.join(".meniscus-dead.tmp"), "left behind").unwrap();
    fs::write(out.join("m.ply.meniscus/.meniscus-dead.tmp"), "left behind").unwrap();
    let alive = fs::File::create(out.join(".meniscus-alive.tmp")).unwrap();
    alive.lock_shared().unwrap();
    let errors = run(folder.path(), &with(&["--resume"]), 0);
    assert!(errors.contains("4 of 8 frames are already finished"), "{errors}");
    fs::remove_file(out.join(".meniscus-alive.tmp"))
        .expect("--resume must keep the temporary file of a running process");
    assert!(tree(&out) == whole);
    let remade: Vec<_> = (0..8).filter(|&i| times()[i] != before[i]).map(|i| i + 1).collect();
    assert_eq!(remade, [2, 3, 4, 5]);

    // If an input has changed, --resume makes its frame again.
    fs::write(folder.path().join("in/f_7.xyz"), raw(&ball(11))).unwrap();
    let errors = run(folder.path(), &with(&["--resume"]), 0);
    assert!(errors.contains("7 of 8 frames"), "{errors}");
    let other = tree(&out);
    assert!(other["m_7.ply"] != whole["m_7.ply"] && other["m_6.ply"] == whole["m_6.ply"]);

    // Other settings give an error, unless --overwrite allows making all frames again.
    let errors = run(folder.path(), &with(&["--smooth", "1.3"]), 2);
    assert!(errors.contains("smooth") && errors.contains("--overwrite"), "{errors}");
    let errors = run(folder.path(), &with(&["--smooth", "1.3", "--resume"]), 2);
    assert!(errors.contains("smooth") && tree(&out) == other, "{errors}");
    run(folder.path(), &with(&["--smooth", "1.3", "--overwrite"]), 0);
    let wide = tree(&out);
    run(folder.path(), &with(&["--smooth", "1.3", "--overwrite"]), 0);
    assert!(tree(&out) == wide && wide["m_1.ply"] != other["m_1.ply"]);
}

#[test]
fn bad_frames_are_reported_with_causes_and_all_others_are_converted() {
    let folder = falling(1..=20);
    run(folder.path(), &ALL, 0);
    let whole = tree(&folder.path().join("out"));
    fs::remove_dir_all(folder.path().join("out")).unwrap();

    let input = |frame: u64| folder.path().join(format!("in/f_{frame}.xyz"));
    let bytes = fs::read(input(5)).unwrap();
    fs::write(input(5), &bytes[..bytes.len() - 5]).unwrap();
    fs::remove_file(input(11)).unwrap();
    let mut bytes = fs::read(input(17)).unwrap();
    bytes[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(input(17), bytes).unwrap();

    let errors = run(folder.path(), &with(&["--stats", "stats.jsonl"]), 1);
    assert!(errors.contains("3 frames failed"), "{errors}");
    for cause in [
        "frame 5: in/f_5.xyz: ",
        "frame 11: in/f_11.xyz: missing",
        "frame 17: in/f_17.xyz: particle 0",
    ] {
        assert!(errors.contains(cause), "{cause}: {errors}");
    }
    let out = tree(&folder.path().join("out"));
    let meshes = |files: &BTreeMap<String, Vec<u8>>| -> Vec<String> {
        files.keys().filter(|name| name.starts_with("m_")).cloned().collect()
    };
    assert_eq!(meshes(&out).len(), 17);
    assert!(meshes(&out).iter().all(|name| out[name] == whole[name]));
    let stats = fs::read_to_string(folder.path().join("stats.jsonl")).unwrap();
    let lines: Vec<Value> = stats.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 20);
    let failed = lines.iter().filter(|line| line["error"].is_string());
    let mut failed: Vec<_> = failed.map(|line| line["frame"].as_i64().unwrap()).collect();
    failed.sort_unstable();
    assert_eq!(failed, [5, 11, 17]);
    let missing = lines.iter().find(|line| line["frame"] == 11).unwrap();
    assert_eq!(missing["input"], "in/f_11.xyz");
    assert!(lines.iter().all(|line| line["frame"].is_u64()));

    // If the first frame is bad, the calibration is measured on the other frames.
    fs::write(input(1), "").unwrap();
    let errors = run(folder.path(), &["in", "-o", "other/"], 1);
    assert!(errors.contains("frame 1: in/f_1.xyz: the file is empty"), "{errors}");
    assert_eq!(
        tree(&folder.path().join("other")).keys().filter(|name| name.starts_with("f_")).count(),
        16
    );
}

#[test]
fn a_sequence_without_a_readable_frame_fails_and_leaves_no_output() {
    let folder = falling(1..=12);
    for frame in 1..=12 {
        fs::write(folder.path().join(format!("in/f_{frame}.xyz")), "?").unwrap();
    }
    let errors = run(folder.path(), &with(&["--threads", "2"]), 3);
    assert!(errors.contains("in/f_1.xyz: "), "{errors}");
    assert!(!folder.path().join("out").exists(), "the output folder remains");
}

#[test]
fn statistics_can_be_written_into_the_new_folder_of_the_meshes() {
    let folder = falling(1..=2);
    for (output, stats) in [("a/", "a/s.jsonl"), ("b/c/m_{}.ply", "b/s.jsonl")] {
        let arguments = ["in/f_{}.xyz", "-o", output, "--stats", stats];
        run(folder.path(), &[&arguments[..], &["--dry-run"]].concat(), 0);
        assert!(!folder.path().join(stats).parent().unwrap().exists(), "a dry run made a folder");
        run(folder.path(), &arguments, 0);
        let lines = fs::read_to_string(folder.path().join(stats)).unwrap();
        assert_eq!(lines.lines().count(), 2, "{stats}");
    }
    let elsewhere = ["in/f_{}.xyz", "-o", "d/", "--stats", "none/s.jsonl"];
    run(folder.path(), &elsewhere, 4);
    assert!(!folder.path().join("d").exists());
}

#[test]
fn a_file_in_place_of_the_output_folder_is_refused_first_and_kept() {
    let folder = falling(1..=2);
    fs::write(folder.path().join("taken"), "mine").unwrap();
    for out in ["taken/", "taken/m_{}.ply", "taken/further/m_{}.ply"] {
        let errors = run(folder.path(), &["in", "-o", out], 4);
        assert!(errors.contains("taken: is a file, not a folder"), "{out}: {errors}");
        assert!(!errors.contains("measured"), "{out}: {errors}");
    }
    assert_eq!(fs::read(folder.path().join("taken")).unwrap(), b"mine");
}

#[test]
fn a_pattern_folder_glob_and_file_list_give_the_same_outputs() {
    let folder = falling(8..=11);
    fs::write(folder.path().join("in/notes.md"), "no frame").unwrap();
    fs::write(folder.path().join("in/scene.json"), "{}").unwrap();
    let inputs: [&[&str]; 4] = [
        &["in/f_{}.xyz"],
        &["in"],
        &["in/f_*.xyz"],
        &["in/f_10.xyz", "in/f_9.xyz", "in/f_11.xyz", "in/f_8.xyz"],
    ];
    let outputs: Vec<_> = inputs
        .iter()
        .enumerate()
        .map(|(i, inputs)| {
            let out = format!("out{i}/m_{{:03}}.ply");
            run(folder.path(), &[inputs, &["-o", &out][..]].concat(), 0);
            tree(&folder.path().join(format!("out{i}")))
        })
        .collect();
    assert!(outputs.iter().all(|out| *out == outputs[0]));
    assert!(outputs[0].contains_key("m_008.ply") && outputs[0].contains_key("m_011.ply"));
    let manifest: Value = serde_json::from_slice(&outputs[0]["m.ply.json"]).unwrap();
    let files: Vec<_> = manifest["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["file"].as_str().unwrap())
        .collect();
    assert_eq!(files, ["m_008.ply", "m_009.ply", "m_010.ply", "m_011.ply"]);

    run(folder.path(), &["in", "-o", "some/", "--start", "9", "--step", "2", "--fps", "25"], 0);
    let some = tree(&folder.path().join("some"));
    let manifest: Value = serde_json::from_slice(&some["f.ply.json"]).unwrap();
    let times: Vec<_> = manifest["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["time"].as_f64().unwrap())
        .collect();
    assert_eq!(times, [9.0 / 25.0, 11.0 / 25.0]);
}

#[test]
fn progress_bars_appear_only_on_request_and_lines_otherwise() {
    let folder = falling(1..=3);
    let lines = run(folder.path(), &ALL, 0);
    assert_eq!(lines.matches("vertices").count(), 3, "{lines}");
    assert!(!lines.contains('\x1b'), "{lines}");
    let bars = run(folder.path(), &with(&["--overwrite", "--progress", "always"]), 0);
    assert!(
        bars.contains('\x1b') && bars.contains("of 3 frames") && bars.contains(" left"),
        "{bars}"
    );
    assert_eq!(
        run(folder.path(), &with(&["--overwrite", "--progress", "always", "--quiet"]), 0),
        ""
    );
}

#[test]
fn invalid_sequence_requests_are_refused_and_leave_no_files() {
    let folder = falling(1..=3);
    fs::copy(folder.path().join("in/f_1.xyz"), folder.path().join("in/g_1.xyz")).unwrap();
    fs::create_dir(folder.path().join("none")).unwrap();
    let before = tree(folder.path());
    for (arguments, code, message) in [
        (vec!["in/f_{}.xyz", "-o", "one.ply"], 2, "{}"),
        (vec!["in/f_1.xyz", "in/f_2.xyz", "-o", "one.ply"], 2, "{}"),
        (
            vec!["in", "-o", "out_{}.ply"],
            2,
            "several simulations: f_{}.xyz (3 frames), g_{}.xyz (1 frame); name one",
        ),
        (vec!["in/*.xyz", "-o", "out_{}.ply"], 2, "into a folder; --together"),
        (vec!["in", "-o", "out/", "--watch"], 2, "several simulations"),
        (vec!["in", "-o", "out/", "--plan"], 2, "several simulations"),
        (
            vec!["in/f_{}.xyz", "-o", "out_{}.ply", "--compress"],
            2,
            "--compress works only with .glb",
        ),
        (vec!["in/f_{}.xyz", "-o", "out_{}.ply", "--simplify", "9"], 2, "--simplify"),
        (
            vec!["in/f_{}.xyz", "-o", "out_{}.ply", "--simplify", "1", "--memory", "20MiB"],
            2,
            "--simplify",
        ),
        (vec!["in/f_{}.xyz", "-o", "out_{}.glb", "--up", "z"], 2, "--particles-up"),
        (vec!["in/f_{}.xyz", "-o", "out_{}.fbx"], 2, "unknown extension"),
        (vec!["in/f_{}.xyz", "-o", "out_{}.stl", "--normals"], 2, "normals"),
        (vec!["in/f_{}.xyz", "-o", "out_{}_{}.ply"], 2, "one {}"),
        (vec!["in/f_{}.xyz", "-o", "out_{:4}.ply"], 2, "{:04}"),
        (vec!["in/f_{}.xyz", "-o", "in/f_{}.xyz"], 2, "unknown extension"),
        (vec!["in/f_{}.xyz", "-o", "out_{}.ply", "--frames", "7..9"], 2, "--frames"),
        (vec!["in/f_{}.xyz", "-o", "out_{}.ply", "--frames", "9..7"], 2, "--frames"),
        (vec!["in/f_{}.xyz", "-o", "out_{}.ply", "--step", "0"], 2, "--step"),
        (vec!["in/f_{}.xyz", "-o", "out_{}.ply", "--fps", "0"], 2, "--fps"),
        (vec!["in/f_{}.xyz", "-o", "out_{}.ply", "--watch", "--dry-run"], 2, "--dry-run"),
        (vec!["in/f_1.xyz", "-o", "out.ply", "--resume"], 2, "--resume"),
        (vec!["none", "-o", "out_{}.ply"], 3, "no frames"),
        (vec!["in/h_{}.xyz", "-o", "out_{}.ply"], 3, "no file matches"),
        (vec!["none", "-o", "one.ply"], 3, "no frames"),
        (vec!["in/h_*.xyz", "-o", "one.ply"], 3, "no frames"),
        (vec!["in/h_{}.xyz", "-o", "one.ply"], 3, "no file matches"),
        (vec!["missing/*.xyz", "-o", "one.ply"], 3, "no frames"),
        (vec!["missing/f_{}.xyz", "-o", "one.ply"], 3, "missing: the folder does not exist"),
        (vec!["missing/f_{}.xyz", "--together", "-o", "one.ply"], 3, "folder does not exist"),
        (vec!["in/f_1.xyz", "in/f_9.xyz", "-o", "one.ply"], 3, "in/f_9.xyz: "),
    ] {
        let errors = run(folder.path(), &arguments, code);
        assert!(errors.contains(message), "{arguments:?}: {errors}");
        assert!(tree(folder.path()) == before, "{arguments:?} changed the folder");
    }
    fs::create_dir(folder.path().join("out")).unwrap();
    fs::write(folder.path().join("out/m_2.ply"), "precious").unwrap();
    let before = tree(folder.path());
    let errors = run(folder.path(), &ALL, 2);
    assert!(errors.contains("m_2.ply") && errors.contains("--overwrite"), "{errors}");
    assert!(tree(folder.path()) == before);
}

#[test]
fn a_dry_run_of_a_sequence_prints_estimates_and_writes_nothing() {
    let folder = falling(1..=4);
    fs::remove_file(folder.path().join("in/f_3.xyz")).unwrap();
    let before = tree(folder.path());
    let output = command(folder.path(), &with(&["--dry-run"])).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success());
    for word in [
        "3 of 3 frames",
        "missing frames: 3",
        "particles per cubed spacing",
        ", memory: ",
        "disk: about",
        "time: about",
    ] {
        assert!(text.contains(word), "{word}: {text}");
    }
    assert!(tree(folder.path()) == before);
}

#[test]
fn a_selection_without_frames_is_an_error_for_every_kind_of_input() {
    let folder = falling(1..=3);
    let before = tree(folder.path());
    let inputs: [&[&str]; 4] =
        [&["in/f_{}.xyz"], &["in"], &["in/f_*.xyz"], &["in/f_1.xyz", "in/f_3.xyz"]];
    for input in inputs {
        for range in [&["--start", "100"], &["--end", "0"], &["--frames", "7..9"]] {
            let arguments = [input, &["-o", "out_{}.ply"], range].concat();
            let errors = run(folder.path(), &arguments, 2);
            let message = "in/f_{}.xyz: no frame matches the selection (--start";
            assert!(errors.contains(message), "{arguments:?}: {errors}");
        }
    }
    assert!(tree(folder.path()) == before);
    // Add another simulation to the folder. It has a selected frame, so it is converted.
    let ball = folder.path().join("in/f_1.xyz");
    fs::copy(ball, folder.path().join("in/g_9.xyz")).unwrap();
    let errors = run(folder.path(), &["in", "-o", "out/", "--start", "5"], 1);
    assert!(errors.contains("in/f_{}.xyz: no frame matches the selection"), "{errors}");
    assert!(folder.path().join("out/g_9.ply").exists(), "{errors}");
}

#[test]
fn kernel_methods_match_single_frames_and_a_new_method_needs_overwrite() {
    let folder = falling(1..=3);
    let made = |more: &[&str]| {
        let notes = run(folder.path(), &with(more), 0);
        (tree(&folder.path().join("out")), notes)
    };
    let (first, _) = made(&["--method", "zhu-bridson"]);
    let state: Value = serde_json::from_slice(&first["m.ply.meniscus/state.json"]).unwrap();
    let shared = &state["shared"];
    assert!(["mu0", "isovalue", "plateau"].iter().all(|key| shared[key].is_null()), "{shared}");
    let spacing = shared["spacing"].to_string();
    for frame in 1..=3 {
        let input = format!("in/f_{frame}.xyz");
        let single = [
            &input,
            "-o",
            "one.ply",
            "--overwrite",
            "--method",
            "zhu-bridson",
            "--spacing",
            &spacing,
        ];
        run(folder.path(), &single, 0);
        assert!(
            fs::read(folder.path().join("one.ply")).unwrap() == first[&format!("m_{frame}.ply")],
            "{frame}"
        );
    }
    let small = ["--method", "zhu-bridson", "--overwrite", "--threads", "1", "--memory", "16MiB"];
    assert!(made(&small).0 == first, "threads or memory change the output");

    let errors = run(folder.path(), &with(&["--method", "yu-turk"]), 2);
    assert!(errors.contains("changed: method"), "{errors}");
    let errors = run(folder.path(), &with(&["--method", "yu-turk", "--resume"]), 2);
    assert!(errors.contains("changed: method") && errors.contains("--overwrite"), "{errors}");
    assert!(tree(&folder.path().join("out")) == first, "a refused run changed the output");
    let (other, notes) = made(&["--method", "yu-turk", "--overwrite"]);
    assert!(
        (1..=3).all(|i| other[&format!("m_{i}.ply")] != first[&format!("m_{i}.ply")]),
        "{notes}"
    );
    let (again, notes) = made(&["--method", "yu-turk", "--resume"]);
    assert!(notes.contains("3 of 3 frames are already finished") && again == other, "{notes}");
    let (_, notes) = made(&["--resume", "--overwrite"]);
    assert!(notes.contains("starting again; changed: method"), "{notes}");
}

#[test]
fn foreign_files_are_replaced_only_with_overwrite() {
    for (there, output) in [
        ("out/m_2.ply", "out/m_{}.ply"),
        ("out/m.ply.series", "out/m_{}.ply"),
        ("out/m.ply.json", "out/m_{}.ply"),
        ("out/m.pvd", "out/m_{}.vtp"),
        ("out/m.usda", "out/m_{}.usdc"),
        ("out/m.manifest.usda", "out/m_{}.usdc"),
    ] {
        let folder = falling(1..=3);
        fs::create_dir(folder.path().join("out")).unwrap();
        fs::write(folder.path().join(there), "mine").unwrap();
        let before = tree(folder.path());
        for how in [&[][..], &["--resume"], &["--plan"], &["--frames", "2..3", "--resume"]] {
            let errors = run(folder.path(), &[&["in/f_{}.xyz", "-o", output], how].concat(), 2);
            assert!(errors.contains(there) && errors.contains("--overwrite"), "{how:?}: {errors}");
            assert!(tree(folder.path()) == before, "{there} by {how:?}");
        }
        run(folder.path(), &["in/f_{}.xyz", "-o", output, "--overwrite"], 0);
        assert_ne!(fs::read(folder.path().join(there)).unwrap(), b"mine");
        run(folder.path(), &["in/f_{}.xyz", "-o", output, "--resume"], 0);
    }
}

#[test]
fn a_conversion_resumes_after_runs_that_failed_to_calibrate() {
    let folder = falling(1..=3);
    run(folder.path(), &ALL, 0);
    let before = tree(&folder.path().join("out"));
    // Replace the first frame, on which the calibration was measured.
    fs::write(folder.path().join("in/f_1.xyz"), "seven").unwrap();
    run(folder.path(), &with(&["--resume", "--frames", "1..1"]), 1);
    for frame in 2..=3 {
        fs::write(folder.path().join(format!("in/f_{frame}.xyz")), "seven").unwrap();
    }
    run(folder.path(), &with(&["--resume"]), 3);
    let settings = with(&["--overwrite", "--spacing", "1e300"]);
    assert_ne!(command(folder.path(), &settings).status().unwrap().code(), Some(0));
    for frame in 1..=3 {
        let path = folder.path().join(format!("in/f_{frame}.xyz"));
        fs::write(path, raw(&ball(frame))).unwrap();
    }
    run(folder.path(), &with(&["--resume"]), 0);
    let after = tree(&folder.path().join("out"));
    for frame in 1..=3 {
        let mesh = format!("m_{frame}.ply");
        assert!(before[&mesh] == after[&mesh], "{mesh}");
    }
}

#[test]
fn a_job_refuses_a_foreign_mesh_among_the_frames_of_another_job() {
    let folder = falling(1..=4);
    fs::create_dir(folder.path().join("out")).unwrap();
    fs::write(folder.path().join("out/m_4.ply"), "mine").unwrap();
    for frames in ["1..2", "3..4"] {
        let errors = run(folder.path(), &with(&["--resume", "--frames", frames]), 2);
        assert!(errors.contains("m_4.ply"), "{errors}");
    }
    assert_eq!(fs::read(folder.path().join("out/m_4.ply")).unwrap(), b"mine");
}

#[test]
fn resuming_does_not_replace_a_foreign_mesh_that_appeared_later() {
    let folder = falling(1..=3);
    let (mesh, input) = (folder.path().join("out/m_4.ply"), folder.path().join("in/f_4.xyz"));
    run(folder.path(), &ALL, 0);
    fs::write(&input, raw(&ball(4))).unwrap();
    fs::write(&mesh, "mine").unwrap();
    for how in [&["--resume"][..], &["--resume", "--watch=0.5"]] {
        let errors = run(folder.path(), &with(how), 1);
        assert!(errors.contains("m_4.ply") && errors.contains("--overwrite"), "{errors}");
        assert_eq!(fs::read(&mesh).unwrap(), b"mine", "{how:?}");
    }
    run(folder.path(), &with(&["--resume", "--overwrite"]), 0);
    assert_ne!(fs::read(&mesh).unwrap(), b"mine");
    // If a mesh of this conversion was damaged, --resume makes it again.
    fs::write(&mesh, "mine").unwrap();
    run(folder.path(), &with(&["--resume"]), 0);
    assert_ne!(fs::read(&mesh).unwrap(), b"mine");
}

/// The frame numbers in a list of frames.
fn listed_frames(list: &Path) -> Vec<i64> {
    let list: Value = serde_json::from_slice(&fs::read(list).unwrap()).unwrap();
    let frames = list["frames"].as_array().unwrap();
    frames.iter().map(|frame| frame["frame"].as_i64().unwrap()).collect()
}

#[test]
fn finished_meshes_stay_listed_when_their_inputs_are_removed() {
    for output in ["out/m_{}.ply", "out/m.abc"] {
        let folder = falling(1..=5);
        let list = match output {
            "out/m.abc" => folder.path().join("out/m.abc.frames/m.abc.json"),
            _ => folder.path().join("out/m.ply.json"),
        };
        let resumed = |more: &[&str]| {
            run(folder.path(), &[&["in/f_{}.xyz", "-o", output][..], more].concat(), 0)
        };
        resumed(&[]);
        let input = |frame: u64| folder.path().join(format!("in/f_{frame}.xyz"));
        [1, 2, 4].into_iter().for_each(|frame| fs::remove_file(input(frame)).unwrap());
        fs::write(input(6), raw(&ball(6))).unwrap();
        let notes = resumed(&["--resume"]);
        assert_eq!(listed_frames(&list), [1, 2, 3, 4, 5, 6], "{notes}");
        assert!(notes.contains("3 existing meshes without an input"), "{notes}");
        // Also remove the mesh of frame 2, whose input is already missing.
        if output == "out/m_{}.ply" {
            fs::remove_file(folder.path().join("out/m_2.ply")).unwrap();
            let notes = resumed(&["--resume"]);
            assert_eq!(listed_frames(&list), [1, 3, 4, 5, 6], "{notes}");
        }
        // Make another surface. Frames without an input must no longer be listed.
        resumed(&["--overwrite", "--smooth", "1.3", "--end", "5"]);
        assert_eq!(listed_frames(&list), [3, 5]);
    }
}

#[test]
fn resuming_replaces_no_mesh_of_inputs_in_another_folder() {
    let folder = falling(1..=4);
    let place = |name: &str| folder.path().join(name);
    run(folder.path(), &ALL, 0);
    let whole = tree(&place("out"));
    fs::create_dir(place("other")).unwrap();
    (1..=4).for_each(|i| fs::write(place(&format!("other/f_{i}.xyz")), raw(&ball(i + 9))).unwrap());
    let of_other = ["other/f_{}.xyz", "-o", "out/m_{}.ply"];
    let resume = [&of_other[..], &["--resume"]].concat();
    for more in [&[][..], &["--frames", "2..3"], &["--plan"], &["--watch=1"]] {
        let errors = run(folder.path(), &[&resume[..], more].concat(), 2);
        assert!(
            errors.contains("other has a different frame") && errors.contains("--overwrite"),
            "{errors}"
        );
        assert!(tree(&place("out")) == whole, "{more:?}");
    }
    // Moving the folder of the inputs does not count as a change.
    fs::rename(place("in"), place("moved")).unwrap();
    let errors = run(folder.path(), &["moved/f_{}.xyz", "-o", "out/m_{}.ply", "--resume"], 0);
    assert!(errors.contains("4 of 4 frames are already finished"), "{errors}");
    assert!(tree(&place("out")) == whole);
    run(folder.path(), &[&of_other[..], &["--overwrite"]].concat(), 0);
    assert!(tree(&place("out"))["m_2.ply"] != whole["m_2.ply"]);
}

#[test]
fn a_simulation_that_appears_while_another_is_watched_is_reported() {
    let folder = falling(1..=2);
    let arguments = ["in", "-o", "out/", "--spacing", "0.5", "--watch=4"];
    let watching = command(folder.path(), &arguments).stderr(Stdio::piped()).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(2500));
    (1..=2).for_each(|i| {
        fs::write(folder.path().join(format!("in/spray_{i}.xyz")), raw(&ball(i))).unwrap();
    });
    let ended = watching.wait_with_output().unwrap();
    let errors = String::from_utf8(ended.stderr).unwrap();
    assert_eq!(ended.status.code(), Some(1), "{errors}");
    assert!(errors.contains("spray_{}.xyz: these frames appeared"), "{errors}");
    assert!(folder.path().join("out/f_2.ply").exists() && errors.contains("2 frames"), "{errors}");
}

#[test]
fn inputs_that_are_missing_or_folders_are_named_among_several() {
    let folder = falling(1..=2);
    for (inputs, named, code) in [
        (["in/f_1.xyz", "f.xyz"], "f.xyz: No such file", 3),
        (["in", "4"], "in: this input is a folder", 2),
        (["in/f_1.xyz", "in"], "in: this input is a folder", 2),
    ] {
        let errors = run(folder.path(), &[&inputs[..], &["-o", "out/"]].concat(), code);
        assert!(errors.contains(named), "{errors}");
    }
}

#[test]
fn a_missing_input_folder_is_an_error_unless_watch_waits_for_it() {
    let folder = falling(1..=2);
    let missing = ["none/f_{}.xyz", "none/"];
    for input in missing {
        let errors = run(folder.path(), &[input, "-o", "out/m_{}.ply"], 3);
        assert!(errors.contains("none") && errors.contains("does not exist"), "{errors}");
        assert!(!folder.path().join("out").exists());
    }
    for (number, input) in ["none/f_{}.xyz", "none"].into_iter().enumerate() {
        let _ = fs::remove_dir_all(folder.path().join("none"));
        let output = format!("out_{number}/m_{{}}.ply");
        let mut watching =
            command(folder.path(), &[input, "-o", &output, "--watch=6", "--spacing", "0.5"]);
        let watching = watching.stderr(Stdio::piped()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(500));
        fs::create_dir(folder.path().join("none")).unwrap();
        fs::copy(folder.path().join("in/f_1.xyz"), folder.path().join("none/f_1.xyz")).unwrap();
        std::thread::sleep(Duration::from_secs(3));
        // Make the input folder disappear for a while, as if a program cleared its folder.
        fs::rename(folder.path().join("none"), folder.path().join("gone")).unwrap();
        std::thread::sleep(Duration::from_millis(700));
        fs::rename(folder.path().join("gone"), folder.path().join("none")).unwrap();
        fs::copy(folder.path().join("in/f_2.xyz"), folder.path().join("none/f_2.xyz")).unwrap();
        let ended = watching.wait_with_output().unwrap();
        assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
        for frame in 1..=2 {
            assert!(
                folder.path().join(format!("out_{number}/m_{frame}.ply")).exists(),
                "{input}: {frame}"
            );
        }
    }
}

#[test]
fn every_frame_uses_the_calibration_of_the_state_not_its_own() {
    let folder = falling(1..=1);
    // Frame 2 is twice as dense, so that it would have a different mu0 and isovalue as a single
    // frame.
    let dense: Vec<_> = ball(2).into_iter().chain(ball(3)).collect();
    fs::write(folder.path().join("in/f_2.xyz"), raw(&dense)).unwrap();
    for indicator in ["counting", "symmetry"] {
        let more = [
            "--indicator",
            indicator,
            "--cell-size",
            "0.6",
            "--spacing",
            "0.5",
            "--origin",
            "0,0,0",
        ];
        run(folder.path(), &with(&[&more[..], &["--overwrite"]].concat()), 0);
        let made = tree(&folder.path().join("out"));
        let state: Value = serde_json::from_slice(&made["m.ply.meniscus/state.json"]).unwrap();
        let shared = &state["shared"];
        assert!(
            shared["frame"] == 1 && shared["mu0"].is_null() == (indicator == "symmetry"),
            "{shared}"
        );
        let [mu0, iso] = ["mu0", "isovalue"].map(|key| shared[key].to_string());
        let single = |known: &[&str]| {
            let alone = ["in/f_2.xyz", "-o", "one.ply", "--overwrite"];
            run(folder.path(), &[&alone[..], &more, known].concat(), 0);
            fs::read(folder.path().join("one.ply")).unwrap()
        };
        let mu0 = if indicator == "symmetry" { vec![] } else { vec!["--mu0", &mu0] };
        assert!(
            single(&[&mu0[..], &["--iso", &iso]].concat()) == made["m_2.ply"],
            "{indicator}: frame 2 does not use {shared}"
        );
        // With its own calibration, or with the shared mu0 and its own isovalue, frame 2 would have
        // a different mesh.
        assert!(single(&[]) != made["m_2.ply"], "{indicator}");
        assert!(single(&mu0) != made["m_2.ply"], "{indicator}");
    }
}

#[test]
fn every_cloud_frame_uses_the_plateau_of_the_state_not_its_own() {
    let folder = falling(1..=3);
    let dense: Vec<_> = [ball(2), ball(3), ball(4)].concat();
    fs::write(folder.path().join("in/f_2.xyz"), raw(&dense)).unwrap();
    let more = ["--cell-size", "0.3", "--spacing", "0.5", "--origin", "0,0,0", "--overwrite"];
    let shared = |more: &[&str]| {
        run(folder.path(), &with(more), 0);
        let made = tree(&folder.path().join("out"));
        let state: Value = serde_json::from_slice(&made["m.ply.meniscus/state.json"]).unwrap();
        (made, state["shared"].clone())
    };
    let (made, thin) = shared(&more);
    assert!(thin["frame"] == 1 && thin["mu0"].is_null() && thin["isovalue"].is_null(), "{thin}");
    let single = |frame: u32| {
        let input = format!("in/f_{frame}.xyz");
        run(folder.path(), &[&[&input, "-o", "one.ply"], &more[..]].concat(), 0);
        fs::read(folder.path().join("one.ply")).unwrap()
    };
    assert!(single(1) == made["m_1.ply"], "frame 1 must use its own plateau");
    assert!(single(2) != made["m_2.ply"], "frame 2 must use the plateau of frame 1");
    // Exchange the frames, so that the calibration uses the dense frame. Its plateau is about three
    // times that of the thin frame, so frame 3 gets a different mesh.
    fs::rename(folder.path().join("in/f_2.xyz"), folder.path().join("in/f_1.xyz")).unwrap();
    fs::write(folder.path().join("in/f_2.xyz"), raw(&ball(1))).unwrap();
    let (by_dense, dense) = shared(&more);
    let plateau = |shared: &Value| shared["plateau"].as_f64().unwrap();
    let ratio = plateau(&dense) / plateau(&thin);
    assert!((2.5..3.5).contains(&ratio), "{dense} and {thin}");
    assert!(by_dense["m_3.ply"] != made["m_3.ply"]);
}

#[test]
fn a_state_of_an_earlier_surface_version_is_refused_even_with_resume() {
    let folder = falling(1..=2);
    run(folder.path(), &ALL, 0);
    let path = folder.path().join("out/m.ply.meniscus/state.json");
    let mut state: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    // In the states of earlier versions, clouds had a mu0 and an isovalue.
    let shared = state["shared"].as_object_mut().unwrap();
    shared.remove("plateau").unwrap();
    shared.insert("mu0".into(), 2.5.into());
    shared.insert("isovalue".into(), 0.1.into());
    fs::write(&path, state.to_string()).unwrap();
    fs::write(folder.path().join("in/f_3.xyz"), raw(&ball(3))).unwrap();
    let before = tree(folder.path());
    for more in [&[][..], &["--resume"], &["--frames", "3..3"], &["--plan"]] {
        let errors = run(folder.path(), &with(more), 2);
        assert!(
            ["state.json", "calibration is missing", "--overwrite"]
                .iter()
                .all(|word| errors.contains(word)),
            "{more:?}: {errors}"
        );
        assert!(tree(folder.path()) == before, "{more:?}");
    }
    // A state with an option that no longer exists counts as a state with other settings, which
    // --overwrite replaces.
    let settings = state["settings"].as_object_mut().unwrap();
    settings.insert("smooth".into(), 2.0.into());
    settings.insert("adaptive".into(), false.into());
    fs::write(&path, state.to_string()).unwrap();
    let errors = run(folder.path(), &ALL, 2);
    assert!(errors.contains("adaptive") && errors.contains("smooth"), "{errors}");
    assert!(run(folder.path(), &with(&["--resume"]), 2).contains("--overwrite"));
    let errors = run(folder.path(), &with(&["--resume", "--overwrite"]), 0);
    assert!(errors.contains("starting again"), "{errors}");
}

#[test]
fn the_plateau_is_measured_on_the_first_frame_with_an_interior() {
    let ball: Vec<_> = ball(1);
    let single = vec![[0.3, 0.2, 0.1]];
    let mut random = Random::new(4);
    let spray: Vec<[f64; 3]> = (0..400).map(|_| [(); 3].map(|()| 60.0 * random.unit())).collect();
    let lattice = fill(4.0, 2.0, 0.0, 1, |p| p.y < 0.0);
    let empty = Vec::new();
    let plateau = |frames: &[&Vec<[f64; 3]>]| {
        let folder = TempDir::new().unwrap();
        for (number, frame) in (1..).zip(frames) {
            let rows = frame.iter().map(|[x, y, z]| format!("{x},{y},{z}\n"));
            let rows = ["x,y,z\n".to_owned()].into_iter().chain(rows);
            fs::write(folder.path().join(format!("f_{number}.csv")), rows.collect::<String>())
                .unwrap();
        }
        // With this wrong spacing, the expected number of particles and the plateau are more than a
        // third too large.
        run(
            folder.path(),
            &["f_{}.csv", "-o", "m_{}.ply", "--spacing", "0.45", "--origin", "0,0,0"],
            0,
        );
        let state = fs::read(folder.path().join("m.ply.meniscus/state.json")).unwrap();
        let state: Value = serde_json::from_slice(&state).unwrap();
        let last = read_mesh(&folder.path().join(format!("m_{}.ply", frames.len()))).unwrap();
        (state["shared"]["plateau"].as_f64().unwrap(), measure(&last).volume.unwrap())
    };
    let (alone, volume) = plateau(&[&ball]);
    for (name, first, within) in [
        ("spray", &spray, 0.0),
        ("one", &single, 0.0),
        ("none", &empty, 0.0),
        ("a lattice", &lattice, 0.015),
    ] {
        let (found, with) = plateau(&[first, &ball]);
        assert!((found / alone - 1.0).abs() <= within, "{name}: {found} and {alone}");
        assert!((with / volume - 1.0).abs() <= 0.5 * within, "{name}: {with} and {volume}");
    }
}

#[test]
fn watch_reports_that_it_waits_for_a_frame_with_deeper_fluid() {
    let folder = TempDir::new().unwrap();
    let spray = [[0.0; 3], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]];
    fs::write(folder.path().join("f_1.xyz"), raw(&spray)).unwrap();
    let arguments = ["f_{}.xyz", "-o", "m_{}.ply", "--spacing", "0.5", "--watch=3"];
    let notes = run(folder.path(), &arguments, 0);
    assert!(notes.contains("waiting for a frame with deeper fluid"), "{notes}");
    assert!(folder.path().join("m_1.ply").exists(), "{notes}");
}

#[test]
fn after_many_frames_of_spray_the_plateau_follows_from_the_spacing() {
    let folder = TempDir::new().unwrap();
    for frame in 1..=65 {
        let spray: Vec<[f64; 3]> =
            (0..3).map(|i| [3.0 * f64::from(i), f64::from(frame), 0.0]).collect();
        fs::write(folder.path().join(format!("f_{frame}.xyz")), raw(&spray)).unwrap();
    }
    fs::write(folder.path().join("f_66.xyz"), raw(&ball(1))).unwrap();
    let notes = run(folder.path(), &["f_{}.xyz", "-o", "m_{}.ply", "--spacing", "0.5"], 0);
    assert!(notes.contains("warning: the fluid is too shallow for a reliable"), "{notes}");
    assert!(notes.contains("density 1.000 particles per cubed spacing"), "{notes}");
    let mesh = read_mesh(&folder.path().join("m_66.ply")).unwrap();
    let volume = measure(&mesh).volume.unwrap() / (ball(1).len() as f64 * 0.125);
    assert!((volume - 1.0).abs() < 0.02, "{volume}");
}

#[test]
fn the_spacing_is_estimated_from_fluid_despite_leading_frames_of_spray() {
    let mut random = Random::new(4);
    for (spray, frames, radius) in [(2, 3, 6.0), (70, 90, 6.0), (2, 3, 9.0), (70, 90, 9.0)] {
        let folder = TempDir::new().unwrap();
        let fluid = fill(2.0 * radius, 1.0, 0.2, 1, |p| p.length() < radius);
        for frame in 1..=frames {
            let particles = if frame > spray {
                fluid.clone()
            } else {
                (0..400).map(|_| [(); 3].map(|()| 60.0 * random.unit())).collect()
            };
            fs::write(folder.path().join(format!("f_{frame}.xyz")), raw(&particles)).unwrap();
        }
        let notes = run(folder.path(), &["f_{}.xyz", "-o", "m_{}.ply", "--plan"], 0);
        let state = fs::read(folder.path().join("m.ply.meniscus/state.json")).unwrap();
        let state: Value = serde_json::from_slice(&state).unwrap();
        let spacing = state["shared"]["spacing"].as_f64().unwrap();
        assert!(
            (spacing - 1.0).abs() < 0.1,
            "{spray} of {frames}, ball of {radius}: {spacing}: {notes}"
        );
    }
}

#[test]
fn a_state_with_an_invalid_calibration_is_refused_unless_overwritten() {
    let folder = falling(1..=2);
    run(folder.path(), &ALL, 0);
    let out = folder.path().join("out");
    let (whole, path) = (tree(&out), out.join("m.ply.meniscus/state.json"));
    for (key, value) in [
        ("plateau", "null"),
        ("plateau", "0"),
        ("plateau", "65536"),
        ("isovalue", "0.2"),
        ("plateau", "\"two\""),
    ] {
        let mut state: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        state["shared"][key] = value.parse().unwrap();
        fs::write(&path, state.to_string()).unwrap();
        let errors = run(folder.path(), &with(&["--resume"]), 2);
        assert!(
            errors.contains("state.json") && errors.contains("--overwrite"),
            "{key} {value}: {errors}"
        );
        assert!(
            (1..=2).all(|i| fs::read(out.join(format!("m_{i}.ply"))).unwrap()
                == whole[&format!("m_{i}.ply")])
        );
        run(folder.path(), &with(&["--overwrite"]), 0);
        assert!(tree(&out) == whole, "{key} {value}");
    }
}

#[test]
fn a_frame_whose_kernels_reach_no_cell_centre_becomes_an_empty_mesh() {
    let folder = falling(1..=1);
    fs::write(folder.path().join("in/f_2.xyz"), raw(&[[0.0; 3]])).unwrap();
    let coarse = ["--method", "mueller", "--spacing", "0.5", "--cell", "2"];
    let notes = run(folder.path(), &with(&coarse), 0);
    assert!(
        notes.contains("f_2.xyz: the mesh is empty: no cell centre is inside the fluid"),
        "{notes}"
    );
    let [ball, nothing] =
        ["out/m_1.ply", "out/m_2.ply"].map(|name| read_mesh(&folder.path().join(name)).unwrap());
    assert!(ball.triangles.len() > 100 && nothing.triangles.is_empty());
}

#[test]
fn frames_without_particles_or_surface_become_readable_empty_meshes() {
    let folder = TempDir::new().unwrap();
    let header = "x,y,z,vx,vy,vz\n";
    let rows = |particles: &[[f64; 3]]| -> String {
        particles.iter().map(|[x, y, z]| format!("{x},{y},{z},1,2,3\n")).collect()
    };
    fs::write(folder.path().join("f_0.csv"), format!("{header}{}", rows(&ball(0)))).unwrap();
    fs::write(folder.path().join("f_1.csv"), format!("{header}{}", rows(&[[0.0; 3]]))).unwrap();
    fs::write(folder.path().join("f_2.csv"), header).unwrap();
    for extension in ["ply", "obj", "vtk", "vtp", "stl"] {
        let out = format!("m_{{}}.{extension}");
        run(folder.path(), &["f_{}.csv", "-o", &out, "--indicator", "counting"], 0);
        let whole = read_mesh(&folder.path().join(format!("m_0.{extension}"))).unwrap();
        assert!(whole.triangles.len() > 1000);
        for frame in [1, 2] {
            let mesh = read_mesh(&folder.path().join(format!("m_{frame}.{extension}"))).unwrap();
            assert_eq!((mesh.positions.len(), mesh.triangles.len()), (0, 0), "{extension}");
            // Search the file's bytes for the attribute's name, because an empty mesh has no
            // values.
            let bytes = fs::read(folder.path().join(format!("m_{frame}.{extension}"))).unwrap();
            let names = |word: &[u8]| bytes.windows(word.len()).any(|window| window == word);
            assert_eq!(
                names(b"velocity") || names(b"float vx"),
                !whole.attributes.is_empty(),
                "{extension}"
            );
        }
    }
}

#[test]
fn an_empty_frame_of_a_vdb_sequence_has_the_voxels_of_the_other_frames() {
    let folder = TempDir::new().unwrap();
    let rows: String = ball(1).iter().map(|[x, y, z]| format!("{x},{y},{z}\n")).collect();
    fs::write(folder.path().join("f_1.csv"), format!("x,y,z\n{rows}")).unwrap();
    fs::write(folder.path().join("f_2.csv"), "x,y,z\n").unwrap();
    run(folder.path(), &["f_{}.csv", "-o", "m_{}.vdb", "--spacing", "0.5", "--cell", "0.8"], 0);
    let grid = |frame: u64| {
        let Info::Volume(volume) = info(folder.path().join(format!("m_{frame}.vdb"))).unwrap()
        else {
            panic!("not a volume")
        };
        volume.grids[0].clone()
    };
    let (whole, empty) = (grid(1), grid(2));
    assert!(whole.active_voxels > Some(1000) && empty.active_voxels == Some(0));
    assert_eq!(whole.voxel_size, Some([0.4; 3]));
    assert_eq!(empty.voxel_size, whole.voxel_size);
    // A grid without voxels has the position of index 0 as its bounds. This position must lie on
    // the lattice of the other frame's grid.
    let [from, to] = [&empty, &whole].map(|grid| grid.bounds.unwrap()[0]);
    for axis in 0..3 {
        let index = whole.index_bounds.unwrap()[0][axis];
        assert!((from[axis] + 0.4 * f64::from(index) - to[axis]).abs() < 1e-9, "{axis}");
    }
}

#[test]
fn empty_vtk_frames_need_no_attributes_and_get_those_of_other_frames() {
    let folder = TempDir::new().unwrap();
    let text = |rows: &[[f64; 3]]| -> String {
        rows.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect()
    };
    let (points, count) = (text(&ball(0)), ball(0).len());
    let velocities = "1 2 3\n".repeat(count);
    let legacy = |count: usize, data: &str| {
        format!(
            "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS {count} float\n{data}"
        )
    };
    let data = format!("{points}POINT_DATA {count}\nVECTORS velocity float\n{velocities}");
    // Legacy VTK stores no attributes for 0 points.
    let legacy = [legacy(count, &data), legacy(0, "")];
    let xml = |count: usize, points: &str, velocities: &str| {
        let array = |name: &str, text: &str| {
            format!(
                "<DataArray type=\"Float32\" Name=\"{name}\" NumberOfComponents=\"3\" \
                 format=\"ascii\">{text}</DataArray>"
            )
        };
        let cells = ["Verts", "Polys"].map(|kind| {
            format!(
                "<{kind}><DataArray type=\"Int32\" Name=\"offsets\" format=\"ascii\"/></{kind}>"
            )
        });
        format!(
            "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"{count}\"><PointData>{}\
             </PointData><Points>{}</Points>{}</Piece></PolyData></VTKFile>",
            array("velocity", velocities),
            array("Points", points),
            cells.concat()
        )
    };
    let xml = [xml(count, &points, &velocities), xml(0, "", "")];
    for (extension, frames) in [("vtk", legacy), ("vtp", xml)] {
        let input = folder.path().join(extension);
        fs::create_dir(&input).unwrap();
        for (frame, text) in frames.iter().enumerate() {
            fs::write(input.join(format!("f_{frame}.{extension}")), text).unwrap();
        }
        let out = format!("{extension}/m_{{}}.ply");
        let arguments = ["--spacing", "0.5", "--attributes", "velocity"];
        run(folder.path(), &[&[extension, "-o", &out], &arguments[..]].concat(), 0);
        let bytes = fs::read(input.join("m_1.ply")).unwrap();
        let header = String::from_utf8_lossy(&bytes);
        assert!(header.contains("element vertex 0") && header.contains("float vx"), "{header}");
        // Frames with particles must have the attribute that --attributes names.
        let out = format!("{extension}/n_{{}}.ply");
        let unknown = ["-o", &out, "--spacing", "0.5", "--attributes", "heat"];
        let errors = run(folder.path(), &[&[extension], &unknown[..]].concat(), 1);
        assert!(errors.contains("no attribute \"heat\""), "{errors}");
    }
}

#[test]
fn a_frame_that_the_shared_isovalue_nearly_empties_causes_a_warning() {
    let folder = TempDir::new().unwrap();
    // The first frame, on which the calibration is measured, is four times as dense as the second.
    let dense = fill(10.0, 2.0, 0.3, 1, |p| p.length() < 6.0);
    let thin = fill(20.0, 1.26, 0.3, 1, |p| p.length() < 6.0);
    fs::write(folder.path().join("f_1.xyz"), raw(&dense)).unwrap();
    fs::write(folder.path().join("f_2.xyz"), raw(&thin)).unwrap();
    let notes = run(
        folder.path(),
        &["f_{}.xyz", "-o", "m_{}.ply", "--spacing", "0.5", "--indicator", "counting"],
        0,
    );
    let warnings: Vec<&str> = notes.lines().filter(|line| line.contains("warning")).collect();
    let [warning, lost] = warnings[..] else { panic!("{notes}") };
    assert!(warning.contains("f_2.xyz") && warning.contains("measured on frame 1"), "{notes}");
    let all = dense.len() + thin.len();
    assert!(
        lost.contains(&format!("{} of {all} particles are outside the surface", thin.len())),
        "{notes}"
    );
    assert!(folder.path().join("m_2.ply").exists());
}

#[test]
fn a_lattice_in_the_first_frame_does_not_distort_the_calibration() {
    let data = data("dambreak_small");
    let folder = TempDir::new().unwrap();
    for name in [
        "ParticleData_Fluid_1.bgeo",
        "ParticleData_Fluid_10.bgeo",
        "ParticleData_Fluid_20.bgeo",
        "scene.json",
    ] {
        fs::copy(data.join(name), folder.path().join(name)).unwrap();
    }
    let shared = |simulation: &str| -> Value {
        let text = fs::read(folder.path().join(simulation).join("state.json")).unwrap();
        serde_json::from_slice::<Value>(&text).unwrap()["shared"].clone()
    };
    let number = |value: &Value| value.as_f64().unwrap();
    // As a single frame, the first frame has isovalue 0.0003, and the last frame 0.2093.
    let symmetry =
        ["ParticleData_Fluid_{}.bgeo", "-o", "s_{}.ply", "--cell", "1", "--indicator", "symmetry"];
    run(folder.path(), &symmetry, 0);
    let symmetry = shared("s.ply.meniscus");
    assert_eq!(symmetry["frame"], 1);
    assert!((number(&symmetry["isovalue"]) - 0.2093).abs() < 0.01, "{symmetry}");
    // In the first frame, particles are on a lattice, so all counts and the plateau are 1. With the
    // isovalue of this plateau, the splash would lose a third of its volume.
    let counting =
        ["ParticleData_Fluid_{}.bgeo", "-o", "c_{}.ply", "--cell", "1", "--indicator", "counting"];
    run(folder.path(), &counting, 0);
    let counting = shared("c.ply.meniscus");
    assert_ne!(counting["frame"], 1);
    assert_eq!(number(&counting["mu0"]), 1.0);
    assert!(number(&counting["isovalue"]) < 0.4, "{counting}");

    // Clouds do not depend on the position of the lattice.
    run(folder.path(), &["ParticleData_Fluid_{}.bgeo", "-o", "d_{}.ply", "--cell", "1"], 0);
    let clouds = shared("d.ply.meniscus");
    assert_eq!(clouds["frame"], 1);
    assert_eq!(clouds["origin"], serde_json::json!([0.0, 0.0, 0.0]));

    let volume = 8664.0 * 0.05_f64.powi(3);
    for name in ["s_1", "s_10", "s_20", "c_1", "c_10", "d_1", "d_10", "d_20"] {
        let mesh = read_mesh(&folder.path().join(format!("{name}.ply"))).unwrap();
        assert!(check(&mesh).is_closed_oriented_manifold());
        let share = measure(&mesh).volume.unwrap() / volume;
        assert!((0.8..1.15).contains(&share), "{name}: {share}");
    }
}

/// A pool of particles at rest, either level or on a slope. `jitter` is in spacings.
fn pool(slope: DQuat, jitter: f64, shift: [f64; 3]) -> Vec<[f64; 3]> {
    let mut random = Random::new(9);
    let mut particles = Vec::new();
    for z in 0..24 {
        for y in 0..12 {
            for x in 0..24 {
                let jitter = [0; 3].map(|_| 2.0 * jitter * (random.unit() - 0.5));
                let place = DVec3::new(f64::from(x), f64::from(y), f64::from(z));
                let at = slope * (place + DVec3::from(jitter));
                particles.push((0.1 * (at + DVec3::from(shift))).to_array());
            }
        }
    }
    particles
}

#[test]
fn a_fluid_at_rest_does_not_flicker() {
    let slope = DQuat::from_euler(EulerRot::XYZ, 0.6, 0.1, 0.4);
    let shifts = [
        [0.0; 3],
        [0.0; 3],
        [0.25, 0.0, 0.0],
        [0.25, 0.5, 0.0],
        [0.4, 0.6, 0.8],
        [1.4, 0.6, -0.2],
        [0.5; 3],
    ];
    for (name, slope, jitter) in [
        ("level", DQuat::IDENTITY, 0.0),
        ("in disorder", DQuat::IDENTITY, 0.3),
        ("on a slope", slope, 0.3),
    ] {
        let folder = TempDir::new().unwrap();
        for (frame, shift) in shifts.into_iter().enumerate() {
            let particles = raw(&pool(slope, jitter, shift));
            fs::write(folder.path().join(format!("p_{frame}.xyz")), particles).unwrap();
        }
        run(folder.path(), &["p_{}.xyz", "-o", "m_{}.ply", "--spacing", "0.1"], 0);
        let mesh = |frame: usize| read_mesh(&folder.path().join(format!("m_{frame}.ply"))).unwrap();
        assert_eq!(mesh(0), mesh(1), "particles at rest change the mesh");
        // The height, in spacings, of the surface relative to the particles. The surface includes
        // its rounded rim.
        let level = |frame: usize| {
            let up = slope * DVec3::Y;
            level(&mesh(frame), up) / 0.1 - up.dot(shifts[frame].into())
        };
        let levels: Vec<f64> = (0..shifts.len()).map(level).collect();
        for pair in levels.windows(2) {
            assert!((pair[1] - pair[0]).abs() < 0.03, "{name}: {levels:?}");
        }
    }
}

/// The mean height of a mesh's upper side, in the direction `up`.
fn level(mesh: &Mesh, up: DVec3) -> f64 {
    let (mut area, mut sum) = (0.0, 0.0);
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| DVec3::from(mesh.positions[vertex as usize]));
        let facing = (b - a).cross(c - a).dot(up);
        if facing > 0.0 {
            area += facing;
            sum += facing * (a + b + c).dot(up) / 3.0;
        }
    }
    sum / area
}

#[test]
fn parallel_frames_stay_within_the_memory_budget() {
    let folder = TempDir::new().unwrap();
    let frame = raw(&fill(46.0, 1.0, 0.4, 1, |p| p.length() < 46.0));
    for i in 0..6 {
        fs::write(folder.path().join(format!("f_{i}.xyz")), &frame).unwrap();
    }
    for (memory, output, options) in [
        ("64MiB", "m_{}.ply", &[][..]),
        ("192MiB", "m_{}.ply", &[]),
        ("192MiB", "m_{}.ply", &["--simplify", "0.1"]),
        ("400MiB", "m_{}.glb", &["--simplify", "0.1", "--compress"]),
    ] {
        let stats = format!("{memory}{}.jsonl", options.len());
        let arguments = [
            "f_{}.xyz",
            "-o",
            output,
            "--spacing",
            "1",
            "--memory",
            memory,
            "--threads",
            "2",
            "--overwrite",
        ];
        run(folder.path(), &[&arguments[..], options, &["--stats", &stats]].concat(), 0);
        let text = fs::read_to_string(folder.path().join(stats)).unwrap();
        let last: Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
        // The peak also includes mapped pages of the inputs, up to 4 MB for each of two frames that
        // are converted in parallel.
        let budget: u64 = memory.trim_end_matches("MiB").parse::<u64>().unwrap() << 20;
        let most = budget + 2 * 4_000_000;
        assert!(last["peak_resident_bytes"].as_u64().unwrap() <= most, "{memory}: {last}");
    }
}

#[test]
fn a_killed_run_resumes_to_exactly_the_same_files() {
    let folder = falling(1..=40);
    run(folder.path(), &ALL, 0);
    let out = folder.path().join("out");
    let whole = tree(&out);
    for made in
        ["", "m.ply.meniscus", "m.ply.meniscus/state.json", "m_1.ply", "m_4.ply", "m_12.ply"]
    {
        fs::remove_dir_all(&out).unwrap();
        let child = command(folder.path(), &ALL).stderr(Stdio::null()).spawn().unwrap();
        program::kill_when(child, made, |_| out.join(made).exists());
        run(folder.path(), &with(&["--resume"]), 0);
        assert!(tree(&out) == whole, "killed when {made:?} appeared");
    }
}

#[test]
#[cfg(unix)]
fn an_interrupted_sequence_keeps_finished_frames_and_resumes() {
    let folder = falling(1..=200);
    let mut child = command(folder.path(), &ALL).stderr(Stdio::piped()).spawn().unwrap();
    let out = folder.path().join("out");
    program::wait_until(&mut child, "m_3.ply", |_| out.join("m_3.ply").exists());
    assert!(
        Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success()
    );
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let left = tree(&out);
    assert!(left.keys().all(|name| !name.contains(".tmp")), "{:?}", left.keys());
    assert!(left.keys().filter(|name| name.starts_with("m_")).count() < 200);
    run(folder.path(), &with(&["--resume", "-q"]), 0);
    assert_eq!(tree(&out).keys().filter(|name| name.starts_with("m_")).count(), 200);
}

#[test]
#[cfg(unix)]
fn a_conversion_started_by_nohup_survives_the_end_of_the_session() {
    let folder = falling(1..=40);
    let arguments: Vec<String> = ALL.iter().map(|word| format!("'{word}'")).collect();
    // Like `nohup`, `trap` makes the shell ignore SIGHUP. The program that replaces the shell also
    // ignores SIGHUP.
    let reconstruct = format!("reconstruct {}", arguments.join(" "));
    let mut child = program::shell_command(folder.path(), "trap '' HUP", &reconstruct)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let out = folder.path().join("out");
    program::wait_until(&mut child, "m_3.ply", |_| out.join("m_3.ply").exists());
    assert!(
        Command::new("kill").args(["-HUP", &child.id().to_string()]).status().unwrap().success()
    );
    assert!(child.wait().unwrap().success());
    assert_eq!(tree(&out).keys().filter(|name| name.starts_with("m_")).count(), 40);
}

#[test]
fn watch_converts_a_running_simulation_without_half_written_frames() {
    let folder = falling(1..=2);
    let plain = falling(1..=5);
    run(plain.path(), &ALL, 0);
    let child = command(folder.path(), &with(&["--watch=20", "--end", "5"]))
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let path = |frame: u64| -> PathBuf { folder.path().join(format!("in/f_{frame}.xyz")) };
    for frame in 3..=5 {
        // In frame 4, pause for longer than the time after which a file counts as complete.
        let bytes = raw(&ball(frame));
        let half = bytes.len() / 2 / 12 * 12 + 5;
        fs::write(path(frame), &bytes[..half]).unwrap();
        std::thread::sleep(Duration::from_millis(if frame == 4 { 2000 } else { 300 }));
        fs::write(path(frame), &bytes).unwrap();
    }
    let output = child.wait_with_output().unwrap();
    let errors = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{errors}");
    let meshes = |folder: &TempDir| -> BTreeMap<String, Vec<u8>> {
        tree(&folder.path().join("out"))
            .into_iter()
            .filter(|(name, _)| name.starts_with("m_"))
            .collect()
    };
    assert!(meshes(&folder) == meshes(&plain), "{errors}");
}

/// The listings of a simulation: the bytes of each file, by its name.
fn listings(out: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = tree(out);
    files.retain(|name, _| !name.contains('_') && !name.contains('/'));
    files
}

#[test]
fn listings_contain_all_frames_and_bounds_regardless_of_the_jobs() {
    let folder = falling(8..=12);
    let out = folder.path().join("out");
    for (extension, names) in [
        ("vtp", &["m.pvd", "m.vtp.json", "m.vtp.series"][..]),
        ("usdc", &["m.manifest.usda", "m.usda", "m.usdc.json"]),
        ("stl", &["m.stl.json", "m.stl.series"]),
        ("glb", &["m.glb.json"]),
    ] {
        let _ = fs::remove_dir_all(&out);
        let pattern = format!("out/m_{{}}.{extension}");
        let convert = |more: &[&str]| {
            run(folder.path(), &[&["in/f_{}.xyz", "-o", &pattern, "--fps", "25"], more].concat(), 0)
        };
        convert(&[]);
        let whole = listings(&out);
        assert_eq!(whole.keys().collect::<Vec<_>>(), names);
        let text = String::from_utf8(whole[names[names.len() / 2]].clone()).unwrap();
        let places = [8, 9, 10, 11, 12].map(|i| text.find(&format!("m_{i}.{extension}")).unwrap());
        assert!(places.is_sorted(), "{text}");
        let json: Value = serde_json::from_slice(&whole[&format!("m.{extension}.json")]).unwrap();
        let last = &json["frames"][4];
        assert_eq!((&last["frame"], &last["time"]), (&12.into(), &(12.0 / 25.0).into()));
        let coordinate =
            |corner: usize, axis: usize| last["bounds"][corner][axis].as_f64().unwrap();
        // The last frame is a ball of radius 5 whose centre is 0.84 below the origin.
        for (axis, middle) in [0.0, -0.84, 0.0].into_iter().enumerate() {
            assert!((coordinate(0, axis) + 5.0 - middle).abs() < 0.6, "{last}");
            assert!((coordinate(1, axis) - 5.0 - middle).abs() < 0.6, "{last}");
        }

        names.iter().for_each(|name| fs::remove_file(out.join(name)).unwrap());
        let messages = convert(&["--resume"]);
        assert!(messages.contains("5 of 5 frames are already finished"), "{messages}");
        assert!(listings(&out) == whole, "{extension}: after a run without work");
        fs::remove_dir_all(&out).unwrap();
        convert(&["--frames", "11..12"]);
        assert!(listings(&out) != whole);
        convert(&["--frames", "8..10"]);
        assert!(listings(&out) == whole, "{extension}: from two jobs");
    }
}

#[test]
fn post_processing_gives_a_sequence_the_bytes_of_its_single_frames() {
    let folder = TempDir::new().unwrap();
    for frame in 1..=3 {
        let drop = ball(frame).into_iter().map(|[x, y, z]| [0.3 * x, 0.3 * y + 12.0, 0.3 * z]);
        let particles: Vec<_> = ball(frame).into_iter().chain(drop).collect();
        fs::write(folder.path().join(format!("f_{frame}.xyz")), raw(&particles)).unwrap();
    }
    let shared = [
        "--indicator",
        "counting",
        "--cell-size",
        "1",
        "--iso",
        "0.2",
        "--mu0",
        "1",
        "--origin",
        "0,0,0",
    ];
    let mut sizes = Vec::new();
    for (extension, options) in [
        ("ply", &[][..]),
        ("ply", &["--simplify", "0.25"]),
        ("ply", &["--smallest-component", "150"]),
        ("ply", &["--simplify", "0.25", "--smallest-component", "150", "--up", "z", "--normals"]),
        ("glb", &["--simplify", "0.1", "--compress", "--particles-up", "z"]),
        ("usdc", &["--up", "z"]),
    ] {
        let (many, one) = (format!("m_{{}}.{extension}"), format!("one.{extension}"));
        let more = [&shared[..], options, &["--overwrite"]].concat();
        run(folder.path(), &[&["f_{}.xyz", "-o", &many], &more[..]].concat(), 0);
        for frame in 1..=3 {
            let input = format!("f_{frame}.xyz");
            run(folder.path(), &[&[&input, "-o", &one], &more[..]].concat(), 0);
            let name = format!("m_{frame}.{extension}");
            let [many, one] = [&name, &one].map(|name| fs::read(folder.path().join(name)).unwrap());
            assert!(many == one, "{options:?}: {name}");
            sizes.push(one.len());
        }
        // These settings must stay the same when a simulation is resumed.
        let refused = [&["f_{}.xyz", "-o", &many], &shared[..], &["--simplify", "0.3"]].concat();
        let errors = run(folder.path(), &refused, 2);
        assert!(errors.contains("simplify"), "{errors}");
    }
    assert!(sizes[3] < sizes[0] / 2 && sizes[6] < sizes[0], "{sizes:?}");

    let all = ["f_{}.xyz", "-o", "none_{}.ply", "--smallest-component", "1e9"];
    let messages = run(folder.path(), &all, 0);
    assert!(messages.contains("--smallest-component removed all components"), "{messages}");
    assert_eq!(read_mesh(&folder.path().join("none_2.ply")).unwrap().triangles.len(), 0);
}

#[test]
fn the_up_axis_rotates_positions_normals_and_vectors_and_back() {
    let folder = TempDir::new().unwrap();
    let rows: String = ball(3).iter().map(|[x, y, z]| format!("{x},{y},{z},1,2,3,5\n")).collect();
    let table = format!("x,y,z,vx,vy,vz,mass\n{rows}");
    fs::write(folder.path().join("f.csv"), table).unwrap();
    let mesh = |name: &str, options: &[&str]| {
        let common =
            ["f.csv", "-o", name, "--normals", "--attributes", "velocity,mass", "--spacing", "0.5"];
        run(folder.path(), &[&common[..], options].concat(), 0);
        read_mesh(&folder.path().join(name)).unwrap()
    };
    let y = mesh("y.vtk", &[]);
    let z = mesh("z.vtk", &["--up", "z"]);
    let values = |mesh: &Mesh, name: &str| {
        mesh.attributes.iter().find(|a| a.name == name).unwrap().values.clone()
    };
    assert_eq!(y.positions.len(), z.positions.len());
    assert!(y.positions.iter().zip(&z.positions).all(|(a, b)| [a[0], -a[2], a[1]] == *b));
    let normals = y.normals.iter().flatten().zip(z.normals.iter().flatten());
    assert!(normals.map(|(a, b)| assert_eq!([a[0], -a[2], a[1]], *b)).count() > 1000);
    assert_eq!(values(&y, "velocity")[..3], [1.0, 2.0, 3.0]);
    assert_eq!(values(&z, "velocity")[..3], [1.0, -3.0, 2.0]);
    assert_eq!(values(&y, "mass"), values(&z, "mass"));
    assert_eq!(y.triangles, z.triangles);
    // If z points up in the particles, a mesh with z up is not rotated. A mesh with y up is rotated
    // in the opposite direction.
    assert!(mesh("zz.vtk", &["--particles-up", "z"]) == y);
    let back = mesh("zy.vtk", &["--particles-up", "z", "--up", "y"]);
    assert_eq!(y.positions.len(), back.positions.len());
    assert!(y.positions.iter().zip(&back.positions).all(|(a, b)| [a[0], a[2], -a[1]] == *b));
    assert!(check(&back).is_closed_oriented_manifold() && measure(&back).volume.unwrap() > 0.0);
}

/// A folder with frames that contain their times, in `f_N.vtk`.
fn timed(frames: &[(u64, &str)]) -> TempDir {
    let folder = TempDir::new().unwrap();
    for &(frame, time) in frames {
        let particles = ball(frame);
        let rows: String = particles.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
        let text = format!(
            "# vtk DataFile Version 3.0\nparticles\nASCII\nDATASET POLYDATA\nFIELD FieldData 2\n\
             CYCLE 1 1 int\n{frame}\nTIME 1 1 double\n{time}\nPOINTS {} double\n{rows}",
            particles.len()
        );
        fs::write(folder.path().join(format!("f_{frame}.vtk")), text).unwrap();
    }
    folder
}

#[test]
fn times_in_the_input_files_become_the_times_of_the_listings() {
    let folder = timed(&[(1, "0.125"), (2, "0.5")]);
    run(folder.path(), &["f_{}.vtk", "-o", "m_{}.vtp", "--fps", "7"], 0);
    let pvd = fs::read_to_string(folder.path().join("m.pvd")).unwrap();
    assert!(pvd.contains("timestep=\"0.125\"") && pvd.contains("timestep=\"0.5\""), "{pvd}");
}

#[test]
fn the_rate_of_a_stage_comes_from_the_frames_of_all_jobs() {
    // Frames 1 and 2 alone, at 0 and 0.08 s, imply another rate than all four frames.
    let folder = timed(&[(1, "0"), (2, "0.08"), (3, "0.12"), (4, "0.16")]);
    let stage = |runs: &[&[&str]]| {
        let out = folder.path().join("out");
        let _ = fs::remove_dir_all(&out);
        for options in runs {
            run(folder.path(), &[&["f_{}.vtk", "-o", "out/m_{}.usdc"], *options].concat(), 0);
        }
        fs::read_to_string(out.join("m.usda")).unwrap()
    };
    let whole = stage(&[&[]]);
    for line in ["timeCodesPerSecond = 25\n", "active = [(0, 0), (2, 1), (3, 2), (4, 3)]\n"] {
        assert!(whole.contains(line), "{line} is not in {whole}");
    }
    assert_ne!(stage(&[&["--frames", "1..2"]]), whole);
    assert_eq!(stage(&[&["--frames", "1..2"], &["--frames", "3..4"]]), whole);
    assert_eq!(stage(&[&["--end", "3"], &["--resume"]]), whole);
}

#[test]
fn resuming_keeps_the_frame_rate_and_refuses_another() {
    let folder = falling(1..=3);
    let out = folder.path().join("out");
    // Only .abc files contain times, so only they are made again for a new rate.
    for (output, depends) in [("out/m_{}.usdc", false), ("out/m_{}.abc", true), ("out/m.abc", true)]
    {
        let convert = |more: &[&str], code| {
            run(folder.path(), &[&["in/f_{}.xyz", "-o", output], more].concat(), code)
        };
        let at_once = |fps: &str| {
            let _ = fs::remove_dir_all(&out);
            convert(&["--fps", fps], 0);
            tree(&out)
        };
        let [whole, faster] = ["25", "30"].map(at_once);
        assert!(whole != faster);
        fs::remove_dir_all(&out).unwrap();
        convert(&["--end", "2", "--fps", "25"], 0);
        let begun = tree(&out);
        for refused in [&["--resume", "--fps", "30"][..], &["--frames", "3..3", "--fps", "30"]] {
            let errors = convert(refused, 2);
            assert!(errors.contains("state.json") && errors.contains("the old --fps"), "{errors}");
            assert!(tree(&out) == begun, "{output}: a refused run changed the output");
        }
        convert(&["--resume"], 0);
        assert!(tree(&out) == whole, "{output}: resumed without a rate");
        let messages = convert(&["--resume", "--overwrite", "--fps", "30"], 0);
        let kept = messages.contains("3 of 3 frames are already finished");
        assert_eq!(kept, !depends, "{output}: {messages}");
        assert!(tree(&out) == faster, "{output}: with a new rate");
    }
    // A rate also counts as a changed setting if no rate was given before.
    run(folder.path(), &ALL, 0);
    let errors = run(folder.path(), &with(&["--resume", "--fps", "25"]), 2);
    assert!(errors.contains("fps"), "{errors}");
    run(folder.path(), &with(&["--overwrite", "--fps", "25"]), 0);
    run(folder.path(), &with(&["--overwrite"]), 0);
    let json = fs::read(out.join("m.ply.json")).unwrap();
    let json: Value = serde_json::from_slice(&json).unwrap();
    assert_eq!(json["fps"], Value::Null, "--overwrite must not keep the earlier frame rate");
}

#[cfg(unix)]
#[test]
fn a_usd_stage_with_a_backslash_in_its_path_is_refused() {
    let folder = falling(1..=2);
    let before = tree(folder.path());
    for output in [r"out/a\b_{}.usdc", r"o\ut/m_{}.usdc"] {
        let errors = run(folder.path(), &["in/f_{}.xyz", "-o", output], 2);
        assert!(errors.contains("a USD stage cannot have a backslash"), "{errors}");
        assert!(tree(folder.path()) == before, "{output}");
    }
    run(folder.path(), &["in/f_{}.xyz", "-o", r"out/a\b_{}.ply"], 0);
}

#[test]
fn each_fluid_in_a_folder_becomes_its_own_sequence() {
    let folder = falling(1..=3);
    for frame in 2..=5 {
        fs::write(folder.path().join(format!("in/oil_{frame}.xyz")), raw(&ball(frame + 10)))
            .unwrap();
    }
    run(folder.path(), &["in", "-o", "out/"], 0);
    let out = tree(&folder.path().join("out"));
    let meshes: Vec<_> = out.keys().filter(|name| name.ends_with(".ply")).collect();
    assert_eq!(
        meshes,
        ["f_1.ply", "f_2.ply", "f_3.ply", "oil_2.ply", "oil_3.ply", "oil_4.ply", "oil_5.ply"]
    );
    for (prefix, frames) in [("f", 3), ("oil", 4)] {
        let json: Value = serde_json::from_slice(&out[&format!("{prefix}.ply.json")]).unwrap();
        assert_eq!(json["frames"].as_array().unwrap().len(), frames);
        let pattern = format!("in/{prefix}_{{}}.xyz");
        run(folder.path(), &[&pattern, "-o", &format!("{prefix}/{prefix}_{{}}.ply")], 0);
        let alone = tree(&folder.path().join(prefix));
        assert!(alone.len() > frames, "{:?}", alone.keys());
        assert!(alone.iter().all(|(name, bytes)| out[name] == *bytes), "{prefix}");
    }
    // Bad files of one fluid do not affect the other.
    for frame in 1..=3 {
        fs::write(folder.path().join(format!("in/f_{frame}.xyz")), "no").unwrap();
    }
    run(folder.path(), &["in", "-o", "again/"], 1);
    let again = tree(&folder.path().join("again"));
    assert!(again["oil_4.ply"] == out["oil_4.ply"] && !again.contains_key("f_1.ply"));
    // A fluid in two formats would give two simulations with the same name, which is an error.
    fs::write(folder.path().join("in/oil_2.csv"), "x,y,z\n1,2,3\n").unwrap();
    let errors = run(folder.path(), &["in", "-o", "other/"], 2);
    assert!(errors.contains("oil_{}.csv (1 frame), oil_{}.xyz (4 frames)"), "{errors}");
    assert!(errors.contains("same file names") && !errors.contains("into a folder"), "{errors}");
}

/// The two halves of the ball's particles in frame `frame`.
fn halves(frame: u64) -> [Vec<[f64; 3]>; 2] {
    let all = ball(frame);
    let (low, high) = all.split_at(all.len() / 2);
    [low.to_vec(), high.to_vec()]
}

/// The bytes of the meshes in a folder, sorted by name.
fn meshes_in(folder: &Path) -> Vec<Vec<u8>> {
    let meshes = tree(folder).into_iter().filter(|(name, _)| name.ends_with(".ply"));
    meshes.map(|(_, bytes)| bytes).collect()
}

#[test]
fn the_files_of_one_frame_are_merged_into_one_surface() {
    let folder = falling(1..=2);
    run(folder.path(), &["in", "-o", "whole/"], 0);
    let whole = meshes_in(&folder.path().join("whole"));
    let write = |name: String, particles: &[[f64; 3]]| {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, raw(particles)).unwrap();
    };
    let mut list = String::new();
    for frame in 1..=2 {
        for (piece, half) in halves(frame).iter().enumerate() {
            write(format!("ranks/f_{frame}_rank{piece}.xyz"), half);
            write(format!("fluids/{}_{frame}.xyz", ["air", "oil"][piece]), half);
            list += &format!(
                "<DataSet timestep=\"{frame}.5\" part=\"{piece}\" file=\"ranks\\f_{frame}_rank{piece}.xyz\"/>"
            );
        }
    }
    let list = format!("<VTKFile type=\"Collection\"><Collection>{list}</Collection></VTKFile>");
    fs::write(folder.path().join("list.pvd"), list).unwrap();
    for (n, inputs) in [
        &["ranks"][..],
        &["ranks/f_{}_rank{piece}.xyz"],
        &["fluids", "--together"],
        &["fluids/air_{}.xyz", "fluids/oil_{}.xyz", "--together"],
        &["list.pvd"],
    ]
    .iter()
    .enumerate()
    {
        let out = format!("out{n}/");
        run(folder.path(), &[inputs, &["-o", &out][..]].concat(), 0);
        assert!(meshes_in(&folder.path().join(out)) == whole, "{inputs:?}");
    }
    let json: Value =
        serde_json::from_slice(&fs::read(folder.path().join("out4/list.ply.json")).unwrap())
            .unwrap();
    let times: Vec<_> =
        json["frames"].as_array().unwrap().iter().map(|f| f["time"].as_f64().unwrap()).collect();
    assert_eq!(times, [1.5, 2.5]);
    let single = ["fluids/air_1.xyz", "fluids/oil_1.xyz", "--together", "-o", "one.ply"];
    run(folder.path(), &single, 0);
    run(folder.path(), &["in/f_1.xyz", "-o", "whole.ply"], 0);
    let [one, alone] =
        ["one.ply", "whole.ply"].map(|name| fs::read(folder.path().join(name)).unwrap());
    assert!(one == alone);

    // If a frame lacks one of its files, only this frame fails. If the frame is not selected, there
    // is no error.
    fs::remove_file(folder.path().join("ranks/f_2_rank1.xyz")).unwrap();
    fs::remove_file(folder.path().join("fluids/oil_2.xyz")).unwrap();
    for (n, (inputs, lacking)) in [
        (
            &["ranks/f_{}_rank{piece}.xyz"][..],
            "ranks/f_2_rank0.xyz: frame 2 has no file for piece 1",
        ),
        (&["fluids", "--together"], "fluids/air_2.xyz: "),
    ]
    .into_iter()
    .enumerate()
    {
        let out = format!("some{n}/");
        let errors = run(folder.path(), &[inputs, &["-o", &out]].concat(), 1);
        assert!(errors.contains(&format!("frame 2: {lacking}")), "{errors}");
        assert!(meshes_in(&folder.path().join(out)) == whole[..1], "{inputs:?}");
        let first = format!("first{n}/");
        run(folder.path(), &[inputs, &["-o", &first, "--end", "1"]].concat(), 0);
        assert!(meshes_in(&folder.path().join(first)) == whole[..1], "{inputs:?}");
    }
    // In a folder, more than half of the frames must have all of their pieces. Here, only one of
    // two frames is complete.
    run(folder.path(), &["ranks", "-o", "none/"], 2);
    // Inputs without a common frame number do not form a joined simulation.
    fs::rename(folder.path().join("fluids/oil_1.xyz"), folder.path().join("fluids/oil_7.xyz"))
        .unwrap();
    run(folder.path(), &["fluids", "--together", "-o", "none/"], 2);
    assert!(!folder.path().join("none").exists());
    run(folder.path(), &["ranks/f_{}_rank0.xyz", "-o", "rank0/", "--watch=1"], 0);
    run(folder.path(), &["fluids", "--together", "-o", "none/", "--watch=1"], 2);
}

#[test]
fn meshes_in_a_list_are_left_out_and_reported_once() {
    let folder = falling(1..=3);
    run(folder.path(), &["in", "-o", "alone/"], 0);
    let walls = "<VTKFile type='UnstructuredGrid'><UnstructuredGrid>\
        <Piece NumberOfPoints='3' NumberOfCells='1'><Points>\
        <DataArray type='Float32' NumberOfComponents='3'>-90 0 0 90 0 0 0 0 90</DataArray></Points>\
        <Cells><DataArray type='UInt8' Name='types'>7</DataArray></Cells></Piece>\
        </UnstructuredGrid></VTKFile>";
    fs::write(folder.path().join("walls.vtu"), walls).unwrap();
    let set = |frame: u64| {
        format!(
            "<DataSet timestep='{frame}' group='0' name='Walls' file='walls.vtu'/>\
             <DataSet timestep='{frame}' group='1' name='Fluid' file='in/f_{frame}.xyz'/>"
        )
    };
    let sets: String = (1..=3).map(set).collect();
    let list = format!("<VTKFile><Collection>{sets}</Collection></VTKFile>");
    fs::write(folder.path().join("list.pvd"), list).unwrap();
    let messages = run(folder.path(), &["list.pvd", "-o", "listed/"], 0);
    let [alone, listed] = ["alone", "listed"].map(|out| meshes_in(&folder.path().join(out)));
    assert!(alone == listed, "{messages}");
    // The first frame with the block reports it, and the last message gives the number of frames.
    assert_eq!(messages.matches("block \"Walls\"").count(), 2, "{messages}");
    assert!(messages.contains("in 3 frames, meniscus left out block \"Walls\""), "{messages}");
}

#[test]
fn negative_frame_numbers_are_accepted_and_times_are_sorted_by_value() {
    let folder = falling(1..=4);
    for (frame, [number, time]) in
        (1..).zip([["-0010", "0.95"], ["-0009", "1.00"], ["0000", "1.05"], ["0001", "1.1e1"]])
    {
        for name in [format!("pre/f_{number}.xyz"), format!("times/f_{time}.xyz")] {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, raw(&ball(frame))).unwrap();
        }
        fs::write(folder.path().join(format!("pre/._f_{number}.xyz")), "no frame").unwrap();
    }
    let listed = |list: &str| -> Vec<(i64, f64, String)> {
        let json: Value =
            serde_json::from_slice(&fs::read(folder.path().join(list)).unwrap()).unwrap();
        let frame = |frame: &Value| {
            let file = frame["file"].as_str().unwrap().to_owned();
            (frame["frame"].as_i64().unwrap(), frame["time"].as_f64().unwrap(), file)
        };
        json["frames"].as_array().unwrap().iter().map(frame).collect()
    };
    run(folder.path(), &["pre/*.xyz", "-o", "pre_$F4.ply", "--start", "-10", "--end", "0"], 0);
    run(folder.path(), &["pre/f_%04d.xyz", "-o", "pre_{:04}.ply", "--resume"], 0);
    let frames: Vec<_> = listed("pre.ply.json").into_iter().map(|(n, _, file)| (n, file)).collect();
    let expected = [(-10, "-010"), (-9, "-009"), (0, "0000"), (1, "0001")];
    assert!(frames.iter().cloned().eq(expected.map(|(n, text)| (n, format!("pre_{text}.ply")))));
    let messages = run(folder.path(), &["times", "-o", "meshes/"], 0);
    assert_eq!(messages.matches("times in seconds").count(), 1, "{messages}");
    let named = ["times/f_{time}.xyz", "-o", "named_{:02}.ply", "--dry-run"];
    let messages = run(folder.path(), &named, 0);
    assert!(!messages.contains("times in seconds"), "{messages}");
    let expected = [(0, 0.95), (1, 1.0), (2, 1.05), (3, 11.0)];
    let times: Vec<_> = listed("meshes/f.ply.json").into_iter().map(|(n, t, _)| (n, t)).collect();
    assert_eq!(times, expected);
    assert!(folder.path().join("meshes/f_1.1e1.ply").exists());
}

#[test]
fn times_that_cannot_be_used_are_reported_once() {
    let folder = TempDir::new().unwrap();
    let write = |frame: u64, comment: &str| {
        let ball = ball(frame);
        let rows: String = ball.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
        let text = format!("{}\n{comment}\n{rows}", ball.len());
        fs::write(folder.path().join(format!("f_{frame}.xyz")), text).unwrap();
    };
    let all = ["f_{}.xyz", "-o", "m_{}.ply", "--overwrite", "--spacing", "0.5", "--cell", "1"];
    let listed = || {
        let json: Value =
            serde_json::from_slice(&fs::read(folder.path().join("m.ply.json")).unwrap()).unwrap();
        json["frames"][2]["time"].as_f64().unwrap()
    };
    (1..=3).for_each(|frame| write(frame, &format!("Time=0.{frame}")));
    let messages = run(folder.path(), &[&all[..], &["--fps", "25"]].concat(), 0);
    assert!(!messages.contains("the times") && listed() == 0.3, "{messages}");
    write(2, "no time");
    let messages = run(folder.path(), &[&all[..], &["--fps", "25"]].concat(), 0);
    assert_eq!(messages.matches("frame 2 has no time").count(), 1, "{messages}");
    assert!(messages.contains("25 frames per second") && listed() == 3.0 / 25.0, "{messages}");
    write(2, "Time=0.1");
    let messages = run(folder.path(), &all, 0);
    assert!(messages.contains("the time of frame 2") && listed() == 3.0, "{messages}");
}

#[test]
fn a_requested_frame_beyond_the_existing_ones_is_reported() {
    let folder = falling(3..=5);
    for (range, messages) in [
        (["--start", "0"], &["before 3"][..]),
        (["--end", "9"], &["after 5"]),
        (["--frames", "1..8"], &["before 3", "after 5"]),
        (["--end", "5"], &[]),
    ] {
        let found = run(folder.path(), &with(&[&range[..], &["--overwrite"]].concat()), 0);
        let expected = messages.len();
        assert_eq!(found.matches("no files for frames").count(), expected, "{range:?}: {found}");
        assert!(messages.iter().all(|message| found.contains(message)), "{range:?}: {found}");
    }
    // The existing frames are 3 and 5, and the next would be 7.
    let step = ["--step", "2", "--end", "6", "--overwrite"];
    let messages = run(folder.path(), &with(&step), 0);
    assert!(!messages.contains("no files for frames"), "{messages}");
}

#[test]
fn frames_that_a_format_cannot_store_exactly_are_reported_once() {
    let folder = TempDir::new().unwrap();
    for frame in 1..=2 {
        let row = |[x, y, z]: &[f64; 3]| format!("{},{y},{z},1,2\n", x + 1e6);
        let rows: String = ball(frame).iter().map(row).collect();
        fs::write(folder.path().join(format!("f_{frame}.csv")), format!("x,y,z,a b,a_b\n{rows}"))
            .unwrap();
    }
    let all = |input, output| {
        let all = [input, "-o", output, "--attributes", "a b,a_b", "--spacing", "0.5"];
        run(folder.path(), &all, 0)
    };
    for [output, single] in [["m_{}.usdc", "m.usdc"], ["w.abc", "w_1.abc"], ["m_{}.glb", "m.glb"]] {
        for messages in [all("f_{}.csv", output), all("f_1.csv", single)] {
            let is_coarse = messages.contains("too coarse");
            assert_eq!(is_coarse, !output.ends_with(".glb"), "{output}: {messages}");
            let renamed = messages.matches("\"a b\" is stored as").count();
            assert!((1..=2).contains(&renamed), "{output}: {messages}");
        }
    }
}

/// The properties of a colour that is called `Cd`, in any number type.
const CD: [&str; 3] = ["Cd_0", "Cd_1", "Cd_2"];

/// Writes a ball whose particles all have the same colour, as floating-point numbers.
fn coloured(path: &Path, frame: u64, colour: f32) {
    coloured_in(path, frame, ("float", ["red", "green", "blue"]), colour);
}

/// Like [`coloured`], with the colour in properties of the number type `scalar`.
fn coloured_in(path: &Path, frame: u64, (scalar, names): (&str, [&str; 3]), colour: f32) {
    let rows: String = ball(frame)
        .iter()
        .map(|[x, y, z]| format!("{x} {y} {z} {colour} {colour} {colour}\n"))
        .collect();
    let property = |scalar: &str, name: &str| format!("property {scalar} {name}\n");
    let properties = ["x", "y", "z"].map(|name| property("float", name)).concat()
        + &names.map(|name| property(scalar, name)).concat();
    let count = ball(frame).len();
    let text =
        format!("ply\nformat ascii 1.0\nelement vertex {count}\n{properties}end_header\n{rows}");
    fs::write(path, text).unwrap();
}

#[test]
fn a_colour_keeps_its_scale_when_it_fades_to_or_from_black() {
    let folder = TempDir::new().unwrap();
    for colours in [[200.0, 20.0, 4.0, 0.5], [0.0, 0.5, 10.0, 200.0]] {
        for (frame, colour) in (1..).zip(colours) {
            coloured(&folder.path().join(format!("f_{frame}.ply")), frame, colour);
        }
        let all = ["f_{}.ply", "-o", "m_{}.ply", "--attributes", "rgb", "--overwrite"];
        run(folder.path(), &[&all[..], &["--spacing", "0.5", "--cell", "1"]].concat(), 0);
        for (frame, colour) in (1..).zip(colours) {
            let mesh = read_mesh(&folder.path().join(format!("m_{frame}.ply"))).unwrap();
            let values = &mesh.attributes[0].values;
            let is_equal = |value: &f32| (value - colour).abs() <= 0.5;
            assert!(!values.is_empty() && values.iter().all(is_equal), "{colour}: {:?}", values[0]);
        }
    }
    // If one frame has colours from 0 to 255 and all other frames have colours from 0 to 1, only
    // this frame fails.
    coloured(&folder.path().join("f_4.ply"), 4, 200.0);
    for frame in 1..4 {
        coloured(&folder.path().join(format!("f_{frame}.ply")), frame, 0.5);
    }
    let all = ["f_{}.ply", "-o", "m_{}.ply", "--attributes", "rgb", "--overwrite"];
    let errors = run(folder.path(), &[&all[..], &["--spacing", "0.5"]].concat(), 1);
    assert!(errors.contains("frame 4") && !errors.contains("frame 3:"), "{errors}");
}

#[test]
fn an_integer_colour_keeps_the_scale_of_the_calibration_frame() {
    let folder = TempDir::new().unwrap();
    let all = ["f_{}.ply", "-o", "m_{}.ply", "--attributes", "Cd", "--overwrite"];
    let all = [&all[..], &["--spacing", "0.5", "--cell", "1"]].concat();
    let write = |scalar: &str, colours: [f32; 4]| {
        for (frame, colour) in (1..).zip(colours) {
            let path = folder.path().join(format!("f_{frame}.ply"));
            coloured_in(&path, frame, (scalar, CD), colour);
        }
    };
    let made = |frame: usize| {
        let mesh = read_mesh(&folder.path().join(format!("m_{frame}.ply"))).unwrap();
        assert_eq!(mesh.attributes.len(), 1);
        (mesh.attributes[0].name.clone(), mesh.attributes[0].values.clone())
    };
    for (scalar, colours, greatest) in [
        ("int", [200.0, 20.0, 4.0, 1.0], 255.0),
        ("uint", [0.0, 4.0, 10.0, 200.0], 255.0),
        ("ushort", [60_000.0, 200.0, 0.0, 300.0], 65_535.0),
        ("ushort", [0.0, 200.0, 0.0, 60_000.0], 65_535.0),
    ] {
        write(scalar, colours);
        run(folder.path(), &all, 0);
        for (frame, colour) in (1..).zip(colours) {
            let (name, values) = made(frame);
            let byte = colour / greatest * 255.0;
            let is_equal = |value: &f32| (value - byte).abs() <= 0.5;
            assert!(name == "color" && !values.is_empty(), "{scalar}: {name}");
            assert!(values.iter().all(is_equal), "{scalar}: {colour} became {}", values[0]);
        }
    }
    // If one frame has a value above 255, the maximum of these colours, only this frame fails.
    write("int", [200.0, 20.0, 4.0, 300.0]);
    let errors = run(folder.path(), &all, 1);
    assert!(errors.contains("\"Cd\" has the value 300"), "{errors}");
    assert_eq!(made(3).0, "color");
    // If the calibration frame has 32-bit integers above 255, the attribute does not count as a
    // colour in any frame.
    write("int", [300.0, 20.0, 4.0, 200.0]);
    run(folder.path(), &all, 0);
    for (frame, expected) in [(1, 300.0), (4, 200.0)] {
        let (name, values) = made(frame);
        assert!(name == "Cd" && values.iter().all(|value| (value - expected).abs() < 0.01));
    }
}

/// Writes a ball whose particles have the attribute `temp`, in properties of the number type
/// `scalar`. A `#` in `temp` stands for the index of the particle.
fn heated(path: &Path, frame: u64, scalar: &str, temp: &str) {
    let components = temp.split(' ').count();
    let name = |i: usize| if components == 1 { "temp".into() } else { format!("temp_{i}") };
    let temps: String =
        (0..components).map(|i| format!("property {scalar} {}\n", name(i))).collect();
    let position: String = ["x", "y", "z"].map(|axis| format!("property float {axis}\n")).concat();
    let ball = ball(frame);
    let row = |(i, [x, y, z]): (usize, &[f64; 3])| {
        format!("{x} {y} {z} {}\n", temp.replace('#', &i.to_string()))
    };
    let rows: String = ball.iter().enumerate().map(row).collect();
    let count = ball.len();
    let text = format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\n{position}{temps}end_header\n{rows}"
    );
    fs::write(path, text).unwrap();
}

#[test]
fn an_attribute_has_the_same_type_in_all_frames() {
    let folder = TempDir::new().unwrap();
    let write = |frame: u64, scalar: &str, temp: &str| {
        heated(&folder.path().join(format!("f_{frame}.ply")), frame, scalar, temp);
    };
    let all = |output: &'static str| {
        ["f_{}.ply", "-o", output, "--attributes", "temp", "--spacing", "0.5", "--cell", "1"]
    };
    let made = |frame: u64| {
        let mesh = read_mesh(&folder.path().join(format!("m_{frame}.ply"))).unwrap();
        let temp = &mesh.attributes[0];
        (temp.kind, temp.kind.number(temp.values[0]))
    };
    // In one frame, either the first or the second, the values are zeros that are stored as
    // integers.
    for odd in [1, 2] {
        for frame in 1..=3 {
            write(frame, "double", "0.5");
        }
        write(odd, "int", "0");
        let anew = ["--overwrite"];
        run(folder.path(), &[&all("m_{}.ply")[..], &anew].concat(), 0);
        assert_eq!(made(odd), (AttributeKind::Number, 0.0));
        assert_eq!(made(3), (AttributeKind::Number, 0.5));
        run(folder.path(), &[&all("u_{}.usdc")[..], &anew].concat(), 0);
        let stage = fs::read_to_string(folder.path().join("u.usda")).unwrap();
        assert!(stage.contains("float[] primvars:temp") && !stage.contains("int[] primvars:temp"));
    }
    // Integers that one frame stores as floating-point numbers become integers again.
    (1..=3).for_each(|frame| write(frame, "int", "#"));
    write(2, "float", "#");
    run(folder.path(), &[&all("m_{}.ply")[..], &["--overwrite"]].concat(), 0);
    assert_eq!(made(2).0, AttributeKind::Signed);
    // Values and types that cannot be converted give an error.
    write(2, "float", "#.5");
    let errors = run(folder.path(), &[&all("m_{}.ply")[..], &["--overwrite"]].concat(), 1);
    assert!(errors.contains("f_2.ply") && errors.contains("value 0.5"), "{errors}");
    (1..=3).for_each(|frame| write(frame, "float", "7"));
    write(2, "float", "1 2 3");
    let errors = run(folder.path(), &[&all("m_{}.ply")[..], &["--overwrite"]].concat(), 1);
    assert!(errors.contains("f_2.ply") && errors.contains("3 floating-point numbers"), "{errors}");
}

#[test]
fn frames_with_attributes_that_an_obj_cannot_store_fail() {
    let folder = TempDir::new().unwrap();
    let write = |frame: u64, scalar: &str, colour: f32| {
        let path = folder.path().join(format!("f_{frame}.ply"));
        coloured_in(&path, frame, (scalar, CD), colour);
    };
    let convert = |meshes: &str, code: i32| {
        let all = ["f_{}.ply", "-o", meshes, "--attributes", "Cd", "--spacing", "0.5"];
        run(folder.path(), &all, code)
    };
    let refused = ".obj cannot store --attributes other than one colour";
    write(1, "float", 0.5);
    write(2, "float", 0.25);
    write(3, "int", 300.0);
    let errors = convert("a_{}.obj", 1);
    assert!(errors.contains("frame 3: f_3.ply: attribute \"Cd\" is 3 integers"), "{errors}");
    assert!(errors.contains("1 frame failed"), "{errors}");
    assert!(!folder.path().join("a_3.obj").exists());
    let text = fs::read_to_string(folder.path().join("a_2.obj")).unwrap();
    let vertex = text.lines().find(|line| line.starts_with("v ")).unwrap();
    let shares: Vec<f32> = vertex.split(' ').skip(4).map(|word| word.parse().unwrap()).collect();
    assert!(shares.len() == 3 && shares.iter().all(|share| (share - 0.25).abs() < 1e-5));
    // If no frame has a colour, the run fails before it makes a frame.
    (1..=2).for_each(|frame| write(frame, "int", 300.0));
    let errors = convert("b_{}.obj", 2);
    assert!(errors.contains(refused) && !errors.contains("failed:"), "{errors}");
}

#[test]
fn a_frame_that_lacks_the_velocity_of_other_frames_causes_a_warning() {
    let folder = TempDir::new().unwrap();
    for frame in 1..=3 {
        let (names, velocity) = if frame == 2 { ("", "") } else { (",vx,vy,vz", ",1,0,0") };
        let rows: String =
            ball(frame).iter().map(|[x, y, z]| format!("{x},{y},{z}{velocity}\n")).collect();
        let table = format!("x,y,z{names}\n{rows}");
        fs::write(folder.path().join(format!("f_{frame}.csv")), table).unwrap();
    }
    let warnings = |meshes: &str| -> Vec<String> {
        let messages = run(folder.path(), &["f_{}.csv", "-o", meshes], 0);
        let found = messages.lines().filter(|line| line.contains("has no attribute"));
        found.map(str::to_owned).collect()
    };
    let found = warnings("m_{}.ply");
    let [only] = &found[..] else { panic!("{found:?}") };
    assert!(only.starts_with("warning: f_2.csv: "), "{only}");
    assert!(only.contains("\"velocity\", but frame 1 (the calibration frame) has it"), "{only}");
    assert!(read_mesh(&folder.path().join("m_2.ply")).unwrap().attributes.is_empty());
    // This format stores no velocity in any frame.
    assert!(warnings("m_{}.obj").is_empty());
}

#[test]
fn attributes_without_a_velocity_are_reported_once() {
    let folder = TempDir::new().unwrap();
    for frame in 1..=3 {
        let rows: String =
            ball(frame).iter().map(|[x, y, z]| format!("{x},{y},{z},1000,0.1\n")).collect();
        let table = format!("x,y,z,heat,stress\n{rows}");
        fs::write(folder.path().join(format!("f_{frame}.csv")), table).unwrap();
        fs::write(folder.path().join(format!("g_{frame}.xyz")), raw(&ball(frame))).unwrap();
    }
    for (arguments, reports) in [
        (&["f_{}.csv", "-o", "a_{}.ply"][..], 1),
        (&["f_1.csv", "-o", "b.ply"], 1),
        (&["f_1.csv", "-o", "c.ply", "--attributes", "heat"], 0),
        (&["f_{}.csv", "-o", "d_{}.ply", "--attributes", "none"], 0),
        (&["f_1.csv", "-o", "e.obj"], 0),
        (&["g_1.xyz", "-o", "g.ply"], 0),
    ] {
        let messages = run(folder.path(), arguments, 0);
        let found =
            messages.matches("no velocity found among the attributes heat, stress;").count();
        assert_eq!(found, reports, "{arguments:?}: {messages}");
    }
}

#[test]
fn frames_emptied_by_a_condition_and_omitted_attributes_are_reported() {
    let folder = TempDir::new().unwrap();
    for frame in 1..=3 {
        let kind = if frame == 2 { 7 } else { 1 };
        let rows: String =
            ball(frame).iter().map(|[x, y, z]| format!("{x},{y},{z},{kind}\n")).collect();
        let table = format!("x,y,z,Type\n{rows}");
        fs::write(folder.path().join(format!("f_{frame}.csv")), table).unwrap();
    }
    let messages = run(folder.path(), &["f_{}.csv", "-o", "m_{}.ply", "--where", "Type=1"], 0);
    let warnings: Vec<_> =
        messages.lines().filter(|line| line.starts_with("warning: f_")).collect();
    assert!(matches!(warnings[..], [only] if only.contains("f_2.csv")), "{messages}");
    assert!(read_mesh(&folder.path().join("m_2.ply")).unwrap().triangles.is_empty());

    // In each frame, one of the two inputs lacks the attribute.
    for frame in 1..=3 {
        fs::write(folder.path().join(format!("g_{frame}.xyz")), raw(&ball(frame + 3))).unwrap();
    }
    let both = ["f_{}.csv", "g_{}.xyz", "--together", "-o", "j_{}.ply", "--spacing", "0.5"];
    let messages = run(folder.path(), &both, 0);
    assert_eq!(messages.matches(": meniscus left out attribute \"Type\"").count(), 1, "{messages}");
    assert!(messages.contains("in 3 frames, meniscus left out"), "{messages}");
}
