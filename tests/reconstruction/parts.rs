//! Tests of meshes in parts: for any number of parts, merging gives the bytes of a single run.

use std::fs;
use std::path::Path;
use std::process::Command;

use glam::{DVec3, IVec3};
use meniscus::internals::backend::field;
use meniscus::internals::brick::Block;
use meniscus::internals::field::blur::Filter;
use meniscus::internals::field::calibration::Calibration;
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::field::recipe::{Detail, Filters, Recipe};
use meniscus::internals::frame::{CountedFrame, Engine, Method, Normals, Sampling, Surfacing};
use meniscus::internals::grid::stretch::{Stretch, WantedBins};
use meniscus::internals::grid::units::{Isovalue, MeanCount, Sigma, Smooth};
use meniscus::internals::grid::{BLOCK, CellBox, Grid, MortonKey};
use meniscus::internals::system::timings::Timings;
use tempfile::TempDir;

use crate::common::files::{data, names, raw};
use crate::common::program::{self, in_shell};
use crate::common::scene::Random;
use crate::common::{dif, fill, sampling, shuffle, splashes, surfacing};

fn command(folder: &Path, arguments: &[&str]) -> Command {
    program::command(folder, &[&["reconstruct"], arguments, &["--backend", "cpu"]].concat())
}

/// Runs `reconstruct`, which must exit with `code`, and returns its standard error.
#[track_caller]
fn run(folder: &Path, arguments: &[&str], code: i32) -> String {
    program::run(folder, &[&["reconstruct"], arguments, &["--backend", "cpu"]].concat(), code)
}

/// Plans a mesh, makes its parts in the given order, and merges them, always with the same options.
#[track_caller]
fn in_parts(
    folder: &Path,
    input: &str,
    output: &str,
    count: usize,
    order: &[usize],
    options: &[&str],
) {
    let number = count.to_string();
    let common = [&[input, "-o", output, "--parts", &number, "-q"], options].concat();
    run(folder, &[&common[..], &["--plan"]].concat(), 0);
    for part in order {
        run(folder, &[&common[..], &["--part", &part.to_string()]].concat(), 0);
    }
    run(folder, &[&common[..], &["--merge"]].concat(), 0);
}

/// A folder with three frames: a real dam break, spray, and a disordered ball with velocities.
fn scenes() -> TempDir {
    let folder = TempDir::new().unwrap();
    let copy = |from: &str, to: &str| fs::copy(data(from), folder.path().join(to)).unwrap();
    copy("dambreak_small/ParticleData_Fluid_20.bgeo", "dam.bgeo");
    copy("dambreak_small/scene.json", "scene.json");
    let mut random = Random::new(5);
    let spray: Vec<[f64; 3]> =
        (0..500).map(|_| std::array::from_fn(|_| 120.0 * random.unit() - 60.0)).collect();
    fs::write(folder.path().join("spray.xyz"), raw(&spray)).unwrap();
    fs::write(folder.path().join("drop.xyz"), raw(&[[0.3, 0.2, 0.1]])).unwrap();
    fs::write(folder.path().join("splash.xyz"), raw(&splashes(3))).unwrap();
    folder
}

/// The messages that a run prints about its mesh, without times and without lines that contain
/// `about`.
fn messages(text: &str, about: &str) -> Vec<String> {
    let timed = |line: &str| line.split(" in ").next().unwrap().to_owned();
    // Runs in parts do not search for walls, so remove these messages.
    let is_hint = |line: &str| {
        ["the particles end at planes", "just short of the wall"].iter().any(|m| line.contains(m))
    };
    text.lines().filter(|line| !line.contains(about) && !is_hint(line)).map(timed).collect()
}

#[test]
fn merged_parts_equal_a_single_run_with_any_options() {
    let folder = scenes();
    let folder = folder.path();
    let cases: [(&str, &str, &[usize], &[&str]); 14] = [
        ("dam.bgeo", "ply", &[1, 2, 3, 8, 64], &[]),
        ("dam.bgeo", "glb", &[3], &["--normals", "--compress"]),
        (
            "dam.bgeo",
            "ply",
            &[5],
            &["--cell", "0.3", "--normals", "--attributes", "velocity,density"],
        ),
        ("dam.bgeo", "ply", &[4], &["--simplify", "0.5", "--smallest-drop", "4"]),
        ("dam.bgeo", "obj", &[7], &["--domain", "-0.5,0,-0.3,0.6,0.8,0.4", "--cell", "0.4"]),
        ("dam.bgeo", "vtp", &[6], &["--indicator", "counting", "--detail"]),
        ("dam.bgeo", "stl", &[2], &["--indicator", "symmetry", "--iso", "0.2", "--cell", "1"]),
        ("dam.bgeo", "ply", &[3], &["--indicator", "symmetry", "--domain", "-2,-2,-2,2,2,2"]),
        (
            "dam.bgeo",
            "usdc",
            &[2],
            &["--smooth", "3", "--cell", "0.9", "--origin", "0.01,0.02,0.03"],
        ),
        ("dam.bgeo", "abc", &[3], &["--normals", "--particles-up", "z"]),
        ("dam.bgeo", "ply", &[4], &["--cell", "0.2", "--memory", "24MiB", "--threads", "1"]),
        ("spray.xyz", "ply", &[3, 20], &["--spacing", "1", "--normals"]),
        ("drop.xyz", "ply", &[1, 9], &["--spacing", "1"]),
        (
            "splash.xyz",
            "ply",
            &[8],
            &["--spacing", "0.8", "--domain", "-13,-15,-11,12,9,14", "--normals"],
        ),
    ];
    for (number, (input, format, counts, options)) in cases.into_iter().enumerate() {
        let one = format!("one_{number}.{format}");
        let single = run(folder, &[&[input, "-o", &one], options].concat(), 0);
        let expected = fs::read(folder.join(&one)).unwrap();
        for &count in counts {
            let many = format!("many_{number}_{count}.{format}");
            // Make the parts in reverse order.
            let order: Vec<usize> = (0..count).rev().collect();
            in_parts(folder, input, &many, count, &order, options);
            assert!(
                fs::read(folder.join(&many)).unwrap() == expected,
                "{input} in {count} {options:?}"
            );
            assert_eq!(names(&folder.join(format!("{many}.meniscus-parts"))).len(), 1 + count);
            // The merge must print all messages about the surface that a single run prints.
            let count = count.to_string();
            let merge =
                [&[input, "-o", &many, "--parts", &count, "--merge", "--overwrite"], options]
                    .concat();
            let merged = run(folder, &merge, 0).replace(&many, &one);
            assert_eq!(
                messages(&merged, "meniscus-parts"),
                messages(&single, input),
                "{input} {options:?}"
            );
        }
    }
}

#[test]
fn merged_parts_report_the_warnings_of_a_single_run() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    // This frame causes several warnings: the fluid is denser than the spacing allows, some drops
    // contain no cell centre, and some values are missing.
    let mut random = Random::new(11);
    let mut particles = fill(12.0, 2.0, 0.3, 1, |p| p.length() < 10.0);
    particles.extend((0..40).map(|_| std::array::from_fn(|_| 400.0 * random.unit() - 200.0)));
    shuffle(&mut particles, &mut random);
    let mut text = String::from("x,y,z,heat\n");
    for (number, [x, y, z]) in particles.iter().enumerate() {
        let heat = if number % 7 == 0 { "nan".to_owned() } else { number.to_string() };
        text += &format!("{x},{y},{z},{heat}\n");
    }
    text += "nan,0,0,1\n";
    fs::write(folder.join("mist.csv"), text).unwrap();
    let options = [
        "--spacing",
        "1.5",
        "--cell",
        "0.7",
        "--indicator",
        "counting",
        "--attributes",
        "heat",
        "--skip-invalid",
    ];
    let single = run(folder, &[&["mist.csv", "-o", "one.ply"], &options[..]].concat(), 0);
    for word in [
        "outside the surface",
        "heat is NaN, infinite or too large for a 32-bit float",
        "looks too large",
        "not finite",
    ] {
        assert!(single.contains(word), "no {word:?} in {single}");
    }
    in_parts(folder, "mist.csv", "many.ply", 5, &[0, 1, 2, 3, 4], &options);
    let merge = ["mist.csv", "-o", "many.ply", "--parts", "5", "--merge", "--overwrite"];
    let merged = run(folder, &[&merge, &options[..]].concat(), 0).replace("many.ply", "one.ply");
    assert_eq!(messages(&merged, "meniscus-parts"), messages(&single, "mist.csv"));
    assert!(
        fs::read(folder.join("one.ply")).unwrap() == fs::read(folder.join("many.ply")).unwrap()
    );
}

#[test]
fn remaking_a_part_repeatedly_or_in_parallel_gives_the_same_file() {
    let folder = scenes();
    let folder = folder.path();
    let common = ["dam.bgeo", "-o", "m.ply", "--parts", "2"];
    let with = |more: &[&'static str]| [&common[..], more].concat();
    run(folder, &with(&["--plan"]), 0);
    let path = folder.join("m.ply.meniscus-parts/part_1");
    let start = |threads: &'static str| {
        command(folder, &with(&["--part", "1", "-q", "--threads", threads])).spawn().unwrap()
    };
    let both = ["1", "2"].map(start);
    for mut child in both {
        assert!(child.wait().unwrap().success());
    }
    let once = fs::read(&path).unwrap();
    assert!(run(folder, &with(&["--part", "1"]), 0).contains("made earlier"));
    // A damaged part is made again with the same bytes, and temporary files of a killed process are
    // removed.
    fs::write(&path, &once[..once.len() / 2]).unwrap();
    let left = folder.join("m.ply.meniscus-parts/.meniscus-abc.tmp");
    fs::write(&left, "half").unwrap();
    assert!(!run(folder, &with(&["--part", "1", "--memory", "20MiB"]), 0).contains("already"));
    assert!(fs::read(&path).unwrap() == once && !left.exists());
    assert_eq!(names(&folder.join("m.ply.meniscus-parts")), ["part_1", "plan.json"]);
}

#[test]
fn settings_and_inputs_changed_since_the_plan_are_refused_by_name() {
    let folder = scenes();
    let folder = folder.path();
    let common = ["dam.bgeo", "-o", "m.ply", "--parts", "3"];
    let with = |more: &[&'static str]| [&common[..], more].concat();
    for step in [&["--part", "0"][..], &["--merge"]] {
        assert!(run(folder, &with(step), 2).contains("no plan yet; make the plan first (--plan)"));
    }
    run(folder, &with(&["--plan"]), 0);
    let plan = folder.join("m.ply.meniscus-parts/plan.json");
    let kept = fs::read(&plan).unwrap();
    (0..3).for_each(|part| drop(run(folder, &with(&["--part", ["0", "1", "2"][part]]), 0)));
    for step in [&["--part", "0"][..], &["--merge"]] {
        for (options, name) in [
            (&["--normals"][..], "normals"),
            (&["--smooth", "2"], "smooth"),
            (&["--simplify", "1"], "simplify"),
            (&["--domain", "0,0,0,1,1,1"], "domain"),
            (&["--attributes", "none"], "attributes"),
            (&["--spacing", "0.05"], "spacing"),
        ] {
            let errors = run(folder, &[&with(step)[..], options].concat(), 2);
            assert!(errors.contains("different settings") && errors.contains(name), "{errors}");
        }
        let other = [&["dam.bgeo", "-o", "m.ply", "--parts", "4"], step].concat();
        assert!(run(folder, &other, 2).contains("(parts)"));
    }
    // Threads and memory may differ from the plan.
    run(folder, &with(&["--part", "0", "--threads", "1", "--memory", "1GiB"]), 0);
    // A second `--plan` with the same settings keeps the plan. A different plan replaces it only on
    // request.
    assert!(run(folder, &with(&["--plan"]), 0).contains("already exists"));
    assert!(run(folder, &with(&["--plan", "--normals"]), 2).contains("--resume or --overwrite"));
    assert_eq!(fs::read(&plan).unwrap(), kept);
    run(folder, &with(&["--plan", "--resume", "--normals"]), 0);
    assert!(run(folder, &with(&["--merge", "--normals"]), 3).contains("with a different plan"));
    run(folder, &with(&["--plan", "--overwrite"]), 0);
    assert_eq!(fs::read(&plan).unwrap(), kept, "the same settings must give the same plan");

    // Use another file with the same size and time.
    let twin = folder.join("twin.bgeo");
    fs::copy(folder.join("dam.bgeo"), &twin).unwrap();
    let time = folder.join("dam.bgeo").metadata().unwrap().modified().unwrap();
    fs::File::options().write(true).open(&twin).unwrap().set_modified(time).unwrap();
    let of_twin =
        |step: &[&'static str]| [&["twin.bgeo", "-o", "m.ply", "--parts", "3"], step].concat();
    for step in [&["--plan"][..], &["--part", "0"], &["--merge"]] {
        assert!(
            run(folder, &of_twin(step), 3).contains("twin.bgeo: this is not the file for which")
        );
    }
    assert_eq!(fs::read(&plan).unwrap(), kept);
    run(folder, &of_twin(&["--plan", "--resume"]), 0);
    assert!(run(folder, &of_twin(&["--merge"]), 3).contains("with a different plan"));
    run(folder, &with(&["--plan", "--overwrite"]), 0);

    run(folder, &with(&["--merge"]), 0);
    assert!(run(folder, &with(&["--merge"]), 2).contains("--overwrite replaces it"));
    assert!(run(folder, &with(&["--part", "0"]), 2).contains("--overwrite replaces it"));

    // Write the same particles again, so that only the file's time changes.
    let bytes = fs::read(folder.join("dam.bgeo")).unwrap();
    fs::write(folder.join("dam.bgeo"), bytes).unwrap();
    for step in [&["--part", "0", "--overwrite"][..], &["--merge", "--overwrite"]] {
        assert!(run(folder, &with(step), 3).contains("or it has changed since"));
    }
    fs::remove_file(folder.join("dam.bgeo")).unwrap();
    assert!(run(folder, &with(&["--merge", "--overwrite"]), 3).contains("dam.bgeo"));
}

#[test]
fn merging_refuses_missing_damaged_and_foreign_parts() {
    let folder = scenes();
    let folder = folder.path();
    let common = ["splash.xyz", "-o", "m.ply", "--parts", "3", "--spacing", "0.8"];
    let with = |more: &[&'static str]| [&common[..], more].concat();
    run(folder, &with(&["--plan"]), 0);
    (0..3).for_each(|part| drop(run(folder, &with(&["--part", ["0", "1", "2"][part]]), 0)));
    let parts = folder.join("m.ply.meniscus-parts");
    let part = parts.join("part_1");
    let whole = fs::read(&part).unwrap();
    assert!(whole.len() > 20_000);

    let merge = with(&["--merge"]);
    let refused = |message: &str| {
        let found = run(folder, &merge, 3);
        assert!(found.contains(message) && found.contains("meniscus-parts"), "{found}");
        assert!(!folder.join("m.ply").exists());
    };
    for name in ["part_0", "part_2"] {
        fs::rename(parts.join(name), folder.join(name)).unwrap();
    }
    refused("2 of 3 parts are missing: 0, 2; make them first (--part)");
    for name in ["part_0", "part_2"] {
        fs::rename(folder.join(name), parts.join(name)).unwrap();
    }
    // Damage single bytes: near both ends of the file, and at equal distances between them.
    let all = whole.len();
    let places = (0..all).step_by(all / 25).chain(0..4).chain(all - 64..all);
    for at in places.collect::<Vec<_>>() {
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (at % 8);
        fs::write(&part, &bytes).unwrap();
        refused("damaged");
    }
    for length in [0, 1, 63, 64, 65, all / 2, all - 65, all - 64, all - 1] {
        fs::write(&part, &whole[..length]).unwrap();
        refused("damaged");
    }
    fs::write(&part, [&whole[..], &whole[..]].concat()).unwrap();
    refused("damaged");
    fs::write(&part, [&whole[..], b"x"].concat()).unwrap();
    refused("damaged");
    fs::copy(parts.join("part_0"), &part).unwrap();
    refused("with a different plan");
    fs::write(&part, &whole).unwrap();
    run(folder, &merge, 0);

    // Change about 20 digits of the plan, one at a time.
    let plan = parts.join("plan.json");
    let text = fs::read_to_string(&plan).unwrap();
    let digits: Vec<usize> =
        text.char_indices().filter(|(_, c)| c.is_ascii_digit()).map(|(at, _)| at).collect();
    assert!(digits.len() > 100);
    for &at in digits.iter().step_by(digits.len() / 20) {
        let mut other = text.clone().into_bytes();
        other[at] = b'0' + (other[at] - b'0' + 1) % 10;
        fs::write(&plan, other).unwrap();
        let output = command(folder, &with(&["--merge", "--overwrite"])).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{:?} was not detected", &text[at - 30..at + 3]);
        let errors = String::from_utf8(output.stderr).unwrap();
        assert!(errors.contains("plan.json"), "{errors}");
    }
    for damaged in [&text[..text.len() / 2], "", "{}", "[]"] {
        fs::write(&plan, damaged).unwrap();
        assert!(run(folder, &with(&["--part", "0", "--overwrite"]), 2).contains("plan.json"));
    }
    assert!(run(folder, &with(&["--plan", "--resume"]), 2).contains("m.ply: "), "the mesh exists");
    run(folder, &with(&["--plan", "--overwrite"]), 0);
    assert_eq!(fs::read_to_string(&plan).unwrap(), text);
}

#[test]
fn invalid_requests_for_parts_are_refused_and_leave_no_files() {
    let folder = scenes();
    let folder = folder.path();
    fs::create_dir(folder.join("frames")).unwrap();
    fs::copy(folder.join("drop.xyz"), folder.join("frames/a_1.xyz")).unwrap();
    run(folder, &["splash.xyz", "-o", "there.ply", "--spacing", "0.8", "-q"], 0);
    let before = names(folder);
    let ask = |more: &[&'static str]| [&["splash.xyz", "-o", "m.ply"], more].concat();
    for (arguments, message) in [
        (ask(&["--parts", "2"]), "--plan, --part I or --merge"),
        (ask(&["--parts", "2", "--plan", "--merge"]), "cannot be used with"),
        (ask(&["--parts", "2", "--part", "0", "--merge"]), "cannot be used with"),
        (ask(&["--parts", "2", "--part", "0", "--plan"]), "cannot be used with"),
        (ask(&["--part", "0"]), "--parts"),
        (ask(&["--merge"]), "--parts"),
        (ask(&["--plan"]), "--plan is only for simulations"),
        (ask(&["--parts", "0", "--plan"]), "--parts"),
        (ask(&["--parts", "1001", "--plan"]), "must be from 1 to 1000"),
        (ask(&["--parts", "2", "--part", "2"]), "the part number must be from 0 to 1, got 2"),
        (ask(&["--parts", "2", "--plan", "--start", "3"]), "--start is only for simulations"),
        (ask(&["--parts", "2", "--plan", "--watch"]), "--watch"),
        (
            ask(&["--parts", "2", "--plan", "--method", "mueller"]),
            "--parts cannot be used if --method is mueller",
        ),
        (ask(&["--parts", "2", "--plan", "--stats", "s"]), "--stats works only with --merge"),
        (ask(&["--parts", "2", "--part", "0", "--dry-run"]), "--dry-run does not work with"),
        (ask(&["--parts", "2", "--merge", "--resume"]), "--resume does not work with --merge"),
        (vec!["frames", "-o", "m_{}.ply", "--parts", "2", "--plan"], "--parts is for one frame"),
        (vec!["drop.xyz", "-o", "m_{}.ply", "--parts", "2", "--plan"], "--parts is for one frame"),
        (vec!["splash.xyz", "-o", "there.ply", "--parts", "2", "--plan"], "there.ply"),
        (vec!["splash.xyz", "-o", "m.jpg", "--parts", "2", "--plan"], "m.jpg"),
        (vec!["splash.xyz", "-o", "/dev/stdout", "--parts", "2", "--plan"], "/dev/stdout"),
        (vec!["x.mnf", "-o", "m.ply", "--parts", "2", "--plan"], "x.mnf"),
    ] {
        let errors = run(folder, &arguments, 2);
        assert!(errors.contains(message), "{arguments:?}: {errors}");
        assert_eq!(names(folder), before, "{arguments:?} changed the folder");
    }
    // With an invalid input, the exit code must be the code for inputs, and not the code for
    // requests.
    fs::write(folder.join("none.xyz"), "").unwrap();
    run(folder, &["none.xyz", "-o", "m.ply", "--parts", "2", "--plan", "--spacing", "1"], 3);
    assert!(!folder.join("m.ply.meniscus-parts").exists());
}

#[test]
fn parts_without_a_surface_fail_like_a_single_run() {
    let folder = scenes();
    let folder = folder.path();
    let common = ["drop.xyz", "-o", "m.ply", "--spacing", "1", "--cell", "9", "-q"];
    let single = run(folder, &common, 3);
    let with = |more: &[&'static str]| [&common[..], &["--parts", "2"], more].concat();
    run(folder, &with(&["--plan"]), 0);
    for part in ["0", "1"] {
        run(folder, &[&with(&["--part"])[..], &[part]].concat(), 0);
    }
    assert_eq!(run(folder, &with(&["--merge"]), 3), single);
}

#[test]
fn the_library_plans_makes_and_merges_parts() {
    let folder = scenes();
    let [input, output] = ["splash.xyz", "m.ply"].map(|name| folder.path().join(name));
    let request = meniscus::Reconstruction::new().spacing(0.8).threads(2);
    let parts = request.parts(&input, &output, 4);
    let planned = parts.plan().unwrap();
    let all: u64 = planned.parts.iter().map(|part| part.particles).sum();
    assert_eq!(all as usize, planned.census.binned);
    assert!(planned.parts.iter().all(|part| part.kept >= part.particles && part.needs.is_some()));
    let made = [2, 0, 3, 1].map(|part| parts.part(part).unwrap());
    let surface = parts.merge().unwrap();
    assert_eq!(
        made.iter().map(|part| part.triangles).sum::<u64>(),
        surface.report().whole_triangles
    );
    surface.write(&output).unwrap();
    let single = request.run_file(&input).unwrap();
    single.write(folder.path().join("one.ply")).unwrap();
    assert!(fs::read(&output).unwrap() == fs::read(folder.path().join("one.ply")).unwrap());
    let (one, many) = (single.report(), surface.report());
    assert_eq!(
        (one.facts, one.calibration, one.measured),
        (many.facts, many.calibration, many.measured)
    );
    assert_eq!((&one.cells, one.lost, &one.warnings), (&many.cells, many.lost, &many.warnings));
    // A calibration in the request must equal the calibration in the plan.
    let other = request.calibrated(Calibration::Clouds { plateau: 15_000 });
    assert!(matches!(
        other.parts(&input, &output, 4).merge(),
        Err(meniscus::Error::Parts(meniscus::error::PartsError::Settings { differing, .. })) if differing == "calibration"
    ));
    let parts = other.parts(&input, &output, 4).overwrite();
    parts.plan().unwrap();
    (0..4).for_each(|part| drop(parts.part(part).unwrap()));
    let merged = parts.merge().unwrap();
    assert!(merged.report().measured.is_none());
    assert_eq!(merged.to_mesh().unwrap(), other.run_file(&input).unwrap().to_mesh().unwrap());
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_exits_with_4_and_the_part_can_be_made_later() {
    let folder = scenes();
    let folder = folder.path();
    let common = ["dam.bgeo", "-o", "m.ply", "--parts", "2", "-q"];
    run(folder, &[&common[..], &["--plan"]].concat(), 0);
    let arguments = format!("reconstruct {} --part 0", common.join(" "));
    let output = in_shell(folder, "trap '' XFSZ; ulimit -f 100", &arguments);
    assert_eq!(output.status.code(), Some(4), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(names(&folder.join("m.ply.meniscus-parts")), ["plan.json"]);
    for part in ["0", "1"] {
        run(folder, &[&common[..], &["--part", part]].concat(), 0);
    }
    run(folder, &[&common[..], &["--merge"]].concat(), 0);
}

/// Computes the field in `cells` from only those particles that are in the cells `seen`.
fn field_of(
    particles: &[[f64; 3]],
    seen: CellBox,
    sampling: &Sampling,
    recipe: impl Fn(&Engine) -> Recipe,
    cells: CellBox,
) -> Block {
    let cell = |p: &[f64; 3]| DVec3::from(*p).floor().as_ivec3();
    let near: Vec<[f64; 3]> =
        particles.iter().filter(|p| seen.contains(cell(p))).copied().collect();
    let frame = Engine::sample(&near, sampling, &mut Timings::default()).unwrap();
    field(&recipe(&frame), dif(&frame), cells)
}

/// The six boxes that lack one layer of cells on one side of `cells`.
fn narrower(cells: CellBox) -> [CellBox; 6] {
    std::array::from_fn(|side| {
        let mut less = cells;
        if side < 3 {
            less.lo[side] += 1
        } else {
            less.hi[side - 3] -= 1
        }
        less
    })
}

/// The cells in which a block's field is needed.
fn needed(normals: Normals) -> CellBox {
    normals.cells(CellBox::cube(IVec3::ZERO, BLOCK))
}

#[test]
fn the_halo_of_the_cloud_recipe_is_exactly_the_reach_of_a_particle() {
    // With a smoothing of 3 spacings, the filters have the longest reach. With a smoothing of 1.6
    // spacings, the inside test has the longest reach.
    for (spacing, smooth) in [(1.0, 3.0), (2.0, 3.0), (2.0, 1.6), (4.0, 1.6)] {
        let sampling =
            Sampling { method: IndicatorKind::Cloud.into(), spacing: Some(spacing), ..sampling() };
        // The needed cells end in the middle of wide cells, where the reach is longest.
        for (sides, normals) in [(0..3, Normals::None), (3..6, Normals::Gradient)] {
            let surfacing =
                Surfacing { smooth: Smooth::new(smooth).unwrap(), normals, ..surfacing() };
            let cells = needed(normals);
            let seen =
                sampling.deciding_cells(IndicatorKind::Cloud, &surfacing, None).cells(IVec3::ZERO);
            let outermost = if sides.start == 0 { seen.lo } else { seen.hi - 1 };
            let by = |plateau: u16| {
                let surfacing = &surfacing;
                move |frame: &Engine| surfacing.recipe(dif(frame), &Calibration::Clouds { plateau })
            };
            // Use the same arrangement of particles in all wide cells, so that the outermost cells
            // that matter contain particles.
            let lattice: Vec<[f64; 3]> = (seen.grown(20, 20).cubes(1))
                .filter(|cell| (*cell - outermost) % spacing as i32 == IVec3::ZERO)
                .map(|cell| (cell.as_dvec3() + 0.5).to_array())
                .collect();
            let all = seen.grown(100, 100);
            let of = |seen: CellBox, plateau: u16| {
                field_of(&lattice, seen, &sampling, by(plateau), cells)
            };
            // Find the greatest plateau for which all cells are inside.
            let inside = |plateau: u16| of(all, plateau).samples().iter().all(|&x| x == u16::MAX);
            let (mut all_inside, mut not_all) = (1_u16, u16::MAX);
            assert!(inside(all_inside) && !inside(not_all));
            while not_all - all_inside > 1 {
                let middle = all_inside + (not_all - all_inside) / 2;
                *(if inside(middle) { &mut all_inside } else { &mut not_all }) = middle;
            }
            // Filters reach farthest if no cell is inside, and if the fluid is so shallow that the
            // fine surface is also used.
            let plateau = if smooth > 2.0 { all_inside / 2 * 3 } else { all_inside };
            let whole = of(all, plateau);
            assert!(of(seen, plateau) == whole, "{spacing} {smooth}");
            for less in &narrower(seen)[sides] {
                assert!(
                    of(*less, plateau) != whole,
                    "{spacing} {smooth}: {less:?} suffices instead of {seen:?}"
                );
            }
        }
    }
}

#[test]
fn the_halo_of_the_counting_recipe_is_exactly_the_reach_of_a_particle() {
    let one = MeanCount::new(1.0).unwrap();
    for (detail, sigma, normals) in
        [(Detail::Smoothed, 1.5, Normals::None), (Detail::Recovered, 2.5, Normals::Gradient)]
    {
        let kind = IndicatorKind::Counting;
        let method = Method::Indicator { kind, mean: Some(one) };
        let sampling = Sampling { method, spacing: Some(1.0), ..sampling() };
        let sigma = Some(Sigma::new(sigma).unwrap());
        let plain = Surfacing { sigma, detail, normals, ..surfacing() };
        let cells = needed(normals);
        let seen = sampling.deciding_cells(kind, &plain, None).cells(IVec3::ZERO);
        let calibration = |threshold: u16| {
            let iso = Isovalue::new((f64::from(threshold) + 0.5) / 65535.0).unwrap();
            Calibration::Indicator { mean: Some(one), iso }
        };
        let by = |threshold: u16| {
            let plain = &plain;
            move |frame: &Engine| plain.recipe(dif(frame), &calibration(threshold))
        };
        let middle = |cell: IVec3| (cell.as_dvec3() + 0.5).to_array();
        let all = CellBox { lo: IVec3::splat(-1000), hi: IVec3::splat(1000) };
        for (side, less) in narrower(seen).into_iter().enumerate() {
            let (axis, up) = (side % 3, if side < 3 { -1 } else { 1 });
            // Put particles into the outermost cell that matters, and into a cell whose recovered
            // details reach the outermost needed cell.
            let at = |place: i32| {
                let mut cell = IVec3::splat(16);
                cell[axis] = place;
                cell
            };
            let edge = if up < 0 { cells.lo[axis] } else { cells.hi[axis] - 1 };
            let last = if up < 0 { seen.lo[axis] } else { seen.hi[axis] - 1 };
            let frame =
                Engine::sample(&[middle(at(edge))], &sampling, &mut Timings::default()).unwrap();
            let Filters::Paper(filters) = by(1)(&frame).filters else { unreachable!() };
            let halo = filters.recovery.as_ref().map_or(0, Filter::halo);
            let between = at(edge + up * halo);
            assert_eq!(last, edge + up * filters.halo());
            let mut particles = vec![middle(at(last))];
            let mut threshold = 1000;
            if detail == Detail::Recovered {
                particles.push(middle(between));
                // Choose the threshold so that smoothing loses the second cell if it is alone, but
                // not if the first cell is nearby.
                let alone =
                    Engine::sample(&&particles[1..], &sampling, &mut Timings::default()).unwrap();
                let none = Surfacing { detail: Detail::Smoothed, ..plain.clone() };
                let smoothed = none.recipe(dif(&alone), &calibration(1));
                threshold = field(&smoothed, dif(&alone), CellBox { lo: between, hi: between + 1 })
                    .at(between);
            }
            let whole = field_of(&particles, all, &sampling, by(threshold), cells);
            // Add a particle that has a surface, because a frame without a surface gives an error.
            particles.push(middle(at(edge - 16 * up)));
            let whole_with = field_of(&particles, all, &sampling, by(threshold), cells);
            assert!(field_of(&particles, seen, &sampling, by(threshold), cells) == whole_with);
            let narrow = field_of(&particles, less, &sampling, by(threshold), cells);
            assert_ne!(
                narrow.at(at(edge)),
                whole.at(at(edge)),
                "{detail:?}, side {side}: {less:?} suffices"
            );
        }
    }
}

#[test]
fn carried_attributes_extend_the_cells_that_a_block_depends_on() {
    // For the paper's indicators, attributes have the same reach as the field. For clouds, they
    // have a shorter reach.
    for kind in [IndicatorKind::Symmetry, IndicatorKind::Cloud] {
        let sampling = Sampling { method: kind.into(), spacing: Some(1.5), ..sampling() };
        let with = Sampling { carried: vec![0], ..sampling.clone() };
        let [bare, carrying] = [&sampling, &with]
            .map(|s| s.deciding_cells(kind, &surfacing(), None).cells(IVec3::ZERO));
        let halo = surfacing().attribute_smoothing(kind, sampling.spacing, &sampling.grid).halo();
        let attributes = CellBox { lo: IVec3::splat(-halo), hi: IVec3::splat(BLOCK + 1 + halo) };
        assert_eq!(carrying, bare.union(&attributes));
    }
}

#[test]
fn a_part_counts_only_the_wanted_particles() {
    let particles = splashes(7);
    let grid = Grid::new(DVec3::ZERO, 0.25).unwrap();
    let sampling =
        Sampling { grid, method: IndicatorKind::Cloud.into(), spacing: Some(0.8), ..sampling() };
    let surfacing = surfacing();
    let whole = CountedFrame::for_surface(&particles, &sampling, &surfacing, None).unwrap();
    let all: Vec<_> = whole.bins().collect();
    let middle = all[all.len() / 2].0;
    let first = MortonKey::of(middle.coord().div_euclid(IVec3::splat(2)));
    for stretch in
        [Stretch { first, end: MortonKey(first.0 + 1) }, Stretch { first, ..Stretch::ALL }]
    {
        let wanted = WantedBins {
            stretch,
            deciding: sampling.deciding_cells(IndicatorKind::Cloud, &surfacing, None),
        };
        let part = CountedFrame::of_wanted(&particles, &sampling, &surfacing, wanted).unwrap();
        let expected: Vec<_> =
            all.iter().filter(|(bin, _)| wanted.contains(bin.coord())).copied().collect();
        assert!(!expected.is_empty() && expected.len() < all.len());
        assert_eq!(part.bins().collect::<Vec<_>>(), expected);
    }
}
