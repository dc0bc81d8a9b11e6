//! Tests of `--where`, which selects particles by their attributes: the surface equals the surface
//! of the selected particles.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use crate::common::fill;
use crate::common::program::{command, run};

/// The positions and types of a fluid, and of a thick shell around it that is open at the top.
fn tank() -> Vec<([f64; 3], u32)> {
    let all = fill(7.0, 1.0, 0.2, 5, |p| p.y < 5.0);
    let is_wall = |p: [f64; 3]| p[0].abs() > 4.0 || p[2].abs() > 4.0 || p[1] < -4.0;
    all.into_iter()
        .filter(|p| is_wall(*p) || p[1] < 2.0)
        .map(|p| (p, u32::from(is_wall(p))))
        .collect()
}

fn csv(particles: &[([f64; 3], u32)]) -> String {
    let rows = particles.iter().map(|([x, y, z], kind)| format!("{x},{y},{z},{kind},0.1\n"));
    format!("x,y,z,Type,age\n{}", rows.collect::<String>())
}

fn ply(particles: &[([f64; 3], u32)]) -> String {
    let rows = particles.iter().map(|([x, y, z], kind)| format!("{kind} {x} {y} {z}\n"));
    format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty uchar Type\nproperty double x\nproperty double y\n\
         property double z\nend_header\n{}",
        particles.len(),
        rows.collect::<String>()
    )
}

fn vtk(particles: &[([f64; 3], u32)]) -> String {
    let count = particles.len();
    let mut text =
        format!("# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS {count} double\n");
    particles.iter().for_each(|([x, y, z], _)| writeln!(text, "{x} {y} {z}").unwrap());
    write!(text, "POINT_DATA {count}\nSCALARS Type int\nLOOKUP_TABLE default\n").unwrap();
    particles.iter().for_each(|(_, kind)| writeln!(text, "{kind}").unwrap());
    text
}

fn words(particles: &[([f64; 3], u32)]) -> String {
    let word = |kind: &u32| ["fluid", "the wall"][*kind as usize];
    let rows =
        particles.iter().map(|([x, y, z], kind)| format!("{x};{y};{z};\"{}\"\n", word(kind)));
    format!("x;y;z;phase\n{}", rows.collect::<String>())
}

fn xyz(comment: &str, particles: &[([f64; 3], u32)]) -> String {
    let element = |kind: &u32| ["O", "Si"][*kind as usize];
    let rows = particles.iter().map(|([x, y, z], kind)| format!("{} {x} {y} {z}\n", element(kind)));
    format!("{}\n{comment}\n{}", particles.len(), rows.collect::<String>())
}

/// A folder with the tank in several formats, and with files that contain only its fluid.
fn scenes() -> TempDir {
    let folder = TempDir::new().unwrap();
    let write = |name: &str, text: String| fs::write(folder.path().join(name), text).unwrap();
    let tank = tank();
    write("tank.csv", csv(&tank));
    write("words.csv", words(&tank));
    write("plain.xyz", xyz("a tank", &tank));
    write("extended.xyz", xyz("Properties=species:S:1:pos:R:3", &tank));
    write("tank.ply", ply(&tank));
    write("tank.vtk", vtk(&tank));
    let fluid: Vec<_> = tank.into_iter().filter(|(_, kind)| *kind == 0).collect();
    write("fluid.csv", csv(&fluid));
    folder
}

fn reconstruct(folder: &Path, arguments: &[&str], code: i32) -> String {
    let usual = ["reconstruct", "--backend", "cpu", "--spacing", "1"];
    run(folder, &[&usual[..], arguments].concat(), code)
}

#[test]
fn a_condition_selects_the_same_particles_in_every_format() {
    let folder = scenes();
    let folder = folder.path();
    let read = |name: &str| fs::read(folder.join(name)).unwrap();
    reconstruct(folder, &["fluid.csv", "-o", "fluid.obj"], 0);
    for (number, (file, conditions)) in [
        ("tank.csv", &["--where", "Type=0"][..]),
        ("tank.ply", &["--where", "Type!=1"]),
        ("tank.vtk", &["--where", "type<0.5"]),
        ("words.csv", &["--where", "phase=fluid"]),
        ("plain.xyz", &["--where", "element=O"]),
        ("extended.xyz", &["--where", "species!=Si"]),
        ("words.csv", &["--where", "phase!='the wall'"]),
        ("tank.csv", &["--where", "Type=0,7 and age<=0.1", "--where", "y<1e3"]),
        ("tank.csv", &["--where", "x>=-4 and x<=4 and z>=-4 and z<=4 and y>=-4"]),
    ]
    .into_iter()
    .enumerate()
    {
        let mesh = format!("{number}.obj");
        let messages = reconstruct(folder, &[&[file, "-o", &mesh], conditions].concat(), 0);
        assert_eq!(read(&mesh), read("fluid.obj"), "{file} {conditions:?}: {messages}");
        assert!(messages.contains(" particles left out"), "{messages}");
    }
}

#[test]
fn packed_frames_parts_and_sequences_apply_the_condition() {
    let folder = scenes();
    let folder = folder.path();
    let read = |name: &str| fs::read(folder.join(name)).unwrap();
    reconstruct(folder, &["fluid.csv", "-o", "fluid.obj"], 0);
    let chosen = ["--where", "Type=0"];
    run(
        folder,
        &[&["pack", "tank.csv", "-o", "tank.mnf", "--spacing", "1"], &chosen[..]].concat(),
        0,
    );
    run(folder, &["reconstruct", "tank.mnf", "-o", "packed.obj"], 0);
    assert_eq!(read("packed.obj"), read("fluid.obj"));
    run(folder, &[&["reconstruct", "tank.mnf", "-o", "again.obj"], &chosen[..]].concat(), 2);

    reconstruct(folder, &["fluid.csv", "-o", "fluid.ply"], 0);
    let parts = [&["tank.csv", "-o", "parts.ply", "--parts", "2"], &chosen[..]].concat();
    for step in [&["--plan"][..], &["--part", "0"], &["--part", "1"], &["--merge"]] {
        reconstruct(folder, &[&parts[..], step].concat(), 0);
    }
    assert_eq!(read("parts.ply"), read("fluid.ply"));

    for (name, from) in [("tank", "tank.csv"), ("fluid", "fluid.csv")] {
        fs::create_dir(folder.join(name)).unwrap();
        (1..3).for_each(|n| {
            fs::copy(folder.join(from), folder.join(format!("{name}/{n}.csv"))).map(drop).unwrap()
        });
    }
    reconstruct(folder, &[&["tank/{}.csv", "-o", "tanks/{}.obj"], &chosen[..]].concat(), 0);
    reconstruct(folder, &["fluid/{}.csv", "-o", "fluids/{}.obj"], 0);
    assert_eq!(read("tanks/2.obj"), read("fluids/2.obj"));
    // A conversion cannot be resumed with a different condition.
    let other = ["tank/{}.csv", "-o", "tanks/{}.obj", "--resume", "--where", "Type=1"];
    assert!(reconstruct(folder, &other, 2).contains("where"));
}

#[test]
fn inapplicable_conditions_are_refused_with_the_available_values() {
    let folder = scenes();
    let folder = folder.path();
    for (file, condition, code, facts) in [
        ("tank.csv", "Typ=0", 2, &["Typ", "Type", "age"][..]),
        ("tank.csv", "Type=wall", 2, &["wall", "numbers"]),
        ("tank.csv", "Type.y=5", 2, &["Type.y", "single number", "use Type"]),
        ("words.csv", "phase<2", 2, &["phase", "its values are text"]),
        // A condition without a match counts as an error of the input, because other frames may
        // match.
        ("tank.csv", "Type=5", 3, &["Type=5", "0 (", "1 ("]),
        ("words.csv", "Phase=solid", 3, &["Phase=solid", "fluid (", "the wall ("]),
    ] {
        let messages = reconstruct(folder, &[file, "-o", "none.ply", "--where", condition], code);
        assert!(facts.iter().all(|fact| messages.contains(fact)), "{condition}: {messages}");
        assert!(messages.contains(file) && !folder.join("none.ply").exists(), "{messages}");
    }
    let messages = reconstruct(folder, &["tank.csv", "-o", "none.ply", "--where", "Type"], 2);
    assert!(messages.contains("--where") && messages.contains("Type=1"), "{messages}");
}

#[test]
fn a_boundary_around_the_fluid_causes_a_warning_and_info_counts_it() {
    let folder = scenes();
    let folder = folder.path();
    for file in ["tank.csv", "tank.ply", "tank.vtk"] {
        let messages = reconstruct(folder, &[file, "-o", "all.ply", "--overwrite"], 0);
        assert!(messages.contains("--where Type=0"), "{file}: {messages}");
        let messages =
            reconstruct(folder, &[file, "-o", "all.ply", "--overwrite", "--where", "Type=0"], 0);
        assert!(!messages.contains("warning"), "{file}: {messages}");
    }
    let messages = reconstruct(folder, &["words.csv", "-o", "all.ply", "--overwrite"], 0);
    assert!(messages.contains("--where phase=fluid"), "{messages}");
    let walls = tank().iter().filter(|(_, kind)| *kind == 1).count() as u64;
    let values = &info(folder, &[])["values"][0];
    assert_eq!(
        (values["name"].as_str(), values["values"][1][1].as_u64()),
        (Some("Type"), Some(walls))
    );
    assert_eq!(info(folder, &["--where", "Type=0"])["unselected"].as_u64(), Some(walls));
}

fn info(folder: &Path, arguments: &[&str]) -> Value {
    let output = command(folder, &[&["info", "--json", "tank.csv"], arguments].concat()).output();
    let infos: Value = serde_json::from_slice(&output.unwrap().stdout).unwrap();
    infos[0].clone()
}
