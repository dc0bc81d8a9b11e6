//! Fuzzes the state and the records of a conversion, and scene files next to particles.

use std::fs;

use meniscus::files::FrameFile;
use meniscus::internals::io::output::MeshFormat;
use meniscus::internals::io::scene::spacing_from_scene;
use meniscus::internals::settings::StoredSettings;
use meniscus::internals::simulation::records::Records;
use meniscus::internals::simulation::state::StateFolder;

use super::{Target, folder};

pub fn targets() -> Vec<Target> {
    vec![
        Target { name: "records", runs: 1000, run: records, seeds: record_seeds, words: RECORD },
        Target { name: "state", runs: 2000, run: state, seeds: state_seeds, words: RECORD },
        Target {
            name: "scene-json",
            runs: 3000,
            run: |data| scene("scene.json", data),
            seeds: json_seeds,
            words: &["\"Configuration\"", "\"particleRadius\"", "1e308", "-0"],
        },
        Target {
            name: "scene-xml",
            runs: 3000,
            run: |data| scene("case.xml", data),
            seeds: xml_seeds,
            words: &[
                "<case",
                "<dp ",
                "<definition ",
                "value=\"",
                "dp=\"",
                "<!--",
                "<!DOCTYPE",
                "&#0;",
            ],
        },
    ]
}

const RECORD: &[&str] = &[
    "\"frame\":",
    "\"crc\":",
    "\"input\":",
    "\"mesh\":",
    "\"bounds\":null",
    "1e999",
    "-1",
    "18446744073709551615",
    "\n",
    "\"cell_size\":",
    "\"origin\":",
    "\"mean\":",
    "\"iso\":",
    "\"plateau\":",
    "null",
];

/// Merges the record files of several processes. In `data`, the byte 0xff separates the files,
/// because this byte does not occur in text. No valid record of a damaged file may be lost.
fn records(data: &[u8]) {
    let folder = folder::empty("out.ply.meniscus");
    let log = |number: usize| {
        if number == 0 { "frames.jsonl".to_owned() } else { format!("frames.{number}.jsonl") }
    };
    for (number, lines) in data.split(|&byte| byte == 0xff).enumerate().take(4) {
        fs::write(folder.join(log(number)), lines).unwrap();
    }
    let before = Records::read(&folder);
    let store = StateFolder::beside(&folder::path("out.ply"));
    store.log.merge().unwrap();
    assert!(Records::read(&folder) == before, "merging changes the records");
    let here = folder::file("mesh.ply", b"mesh");
    for number in [-1, 0, 1, 2, i64::MAX] {
        let frame = FrameFile::new(number, number.to_string(), here.clone());
        if let Some(record) = before.of(&frame, &here, 5) {
            store.log.append(record).unwrap();
            assert!(Records::read(&folder) == before, "adding a record again changes the records");
            let _ = record.is_whole(&here);
        }
    }
}

/// Reads a state. If the state is valid, writing and reading must not change it.
fn state(data: &[u8]) {
    folder::empty("out.ply.meniscus");
    let store = StateFolder::beside(&folder::path("out.ply"));
    fs::write(store.state_path(), data).unwrap();
    match store.load() {
        Ok(state) => {
            let state = state.expect("the file exists");
            fs::remove_file(store.state_path()).unwrap();
            assert_eq!(store.add(&state).unwrap(), state);
            let again = store.load().unwrap().expect("the file exists");
            assert_eq!(again, state);
            assert_eq!(again.fingerprint(MeshFormat::Ply), state.fingerprint(MeshFormat::Ply));
            let _ = state.differing(&StoredSettings::new());
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// Reads the spacing from a scene file. The spacing must be positive and finite, or unknown.
fn scene(name: &str, data: &[u8]) {
    let folder = folder::empty("scene");
    fs::write(folder.join(name), data).unwrap();
    if let Some((spacing, path)) = spacing_from_scene(&folder.join("a.bgeo")) {
        assert!(spacing.is_finite() && spacing > 0.0, "{spacing}");
        assert_eq!(path, folder.join(name));
    }
}

fn record_seeds() -> Vec<Vec<u8>> {
    let record = |frame: u64, fingerprint: u32| {
        format!(
            "{{\"input\":{{\"bytes\":4,\"modified\":7}},\"fingerprint\":{fingerprint},\"mesh\":{{\"frame\":{frame},\"time\":0.1,\"file\":\"mesh.ply\",\
             \"bytes\":4,\"particles\":1,\"vertices\":0,\"triangles\":0,\"bounds\":[[1e-17,-0.1,0.3],[0.5,0.0,1e300]],\"normals\":true,\
             \"attributes\":[{{\"name\":\"v\",\"components\":3}}]}},\"crc\":77}}\n"
        )
    };
    let logs = [[record(1, 5), record(2, 5)].concat(), record(1, 6), String::new()]
        .map(String::into_bytes);
    let seed = logs.join(&0xff);
    let folder = folder::empty("seed");
    fs::write(folder.join("frames.jsonl"), record(1, 5)).unwrap();
    assert!(Records::read(&folder) != Records::default(), "the seed has no valid record");
    vec![seed]
}

fn state_seeds() -> Vec<Vec<u8>> {
    let frames = folder::empty("seed");
    let particles: Vec<u8> = (0..30_u32)
        .flat_map(|i| [i % 3, i / 3 % 3, i / 9].map(|c| c as f32))
        .flat_map(f32::to_le_bytes)
        .collect();
    fs::write(frames.join("a_1.xyz"), particles).unwrap();
    let of = |kind: meniscus::IndicatorKind| {
        let request = meniscus::Reconstruction::new().threads(1).spacing(1.0).indicator(kind);
        let simulation =
            meniscus::Simulation::new(frames.join("a_{}.xyz"), frames.join("m_{}.ply")).overwrite();
        simulation.reconstruction(request).run(|_| ()).unwrap();
        fs::read(frames.join("m.ply.meniscus/state.json")).unwrap()
    };
    vec![of(meniscus::IndicatorKind::Cloud), of(meniscus::IndicatorKind::Counting)]
}

fn json_seeds() -> Vec<Vec<u8>> {
    vec![br#"{"Configuration": {"particleRadius": 0.025, "a": [1, "\u00e9"]}}"#.to_vec()]
}

fn xml_seeds() -> Vec<Vec<u8>> {
    vec![
        b"<?xml version=\"1.0\"?><case><casedef><constantsdef/><geometry><definition dp=\"0.02\"/></geometry></casedef></case>".to_vec(),
        b"<case><execution><constants><dp value=\"0.02\" units=\"m\"/></constants></execution></case>".to_vec(),
    ]
}
