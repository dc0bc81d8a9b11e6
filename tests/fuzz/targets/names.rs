//! Fuzzes patterns of frame names, and the names generated from them.

use std::fs::{self, File};
use std::path::Path;

use meniscus::Simulation;
use meniscus::internals::simulation::inputs::Inputs;
use meniscus::internals::simulation::naming::{Naming, simulation};
use meniscus::internals::simulation::pattern::Pattern;

use super::{Target, folder};

pub fn targets() -> Vec<Target> {
    let words = &[
        "{}",
        "{:04}",
        "{:0",
        "{piece}",
        "{time}",
        "}",
        "_0001",
        ".bgeo",
        ".xyz.gz",
        ".vtu",
        ".pvtu",
        "*",
        "?",
        "[0-9]",
        "18446744073709551616",
        "/",
        "..",
        "_p00_",
    ];
    vec![
        Target {
            name: "patterns",
            runs: 50000,
            run: patterns,
            seeds: || vec![b"sim/f_{:04}.bgeo".to_vec(), b"{}".to_vec()],
            words,
        },
        Target {
            name: "frames",
            runs: 1000,
            run: frames,
            seeds: || {
                vec![
                    b"f_{}.xyz\nf_1.xyz\nf_2.xyz\nf_10.xyz.gz".to_vec(),
                    b".\na_01.csv\na_02.csv\nb_1.xyz".to_vec(),
                    b"*.vtu\na_1.vtu\na_2_0.vtu".to_vec(),
                ]
            },
            words,
        },
    ]
}

/// Parses a pattern. A valid pattern must give different numbers different names.
fn patterns(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    if let Ok(Some(pattern)) = Pattern::parse(Path::new(text)) {
        let paths = [0, 7, 1234, i64::MAX].map(|number| pattern.path(number, &number.to_string()));
        assert!((1..4).all(|i| !paths[..i].contains(&paths[i])), "{paths:?}");
        // A name from a pattern must not be a pattern itself. Names with `%` or `<` are exempt,
        // because other programs use them in patterns. `{piece}` is only allowed in inputs.
        let filled = paths[0].to_str().unwrap().replace("{piece}", "0");
        assert!(
            text.contains(['%', '<'])
                || Pattern::parse(Path::new(&filled)).is_ok_and(|again| again.is_none()),
            "a name from the pattern {text:?} is itself a pattern"
        );
    }
    let _ = Naming::of(Path::new(text));
}

/// Lists the frames of the pattern in the first line. The other lines are the names of the files
/// that exist. The numbers of the frames must increase, and each frame must have its own output.
fn frames(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let mut lines = text.split('\n');
    let request = lines.next().unwrap_or_default();
    // Ignore requests that could lead out of the folder.
    if request.contains("..")
        || request.contains("**")
        || request.contains('\0')
        || Path::new(request).is_absolute()
    {
        return;
    }
    let folder = folder::empty("frames");
    for name in lines.take(6) {
        let fits = !name.is_empty()
            && name.len() < 100
            && !name.contains(['/', '\0'])
            && name != "."
            && name != "..";
        if fits {
            drop(File::create(folder.join(name)));
        }
    }
    let inputs = [folder.join(request)];
    let _ = Simulation::detect(&inputs, &folder.join("m_{}.ply"), None);
    let Ok(Some(inputs)) = Inputs::of(&inputs, None) else { return };
    assert!(!inputs.describe().is_empty());
    for inputs in inputs.simulations(None).unwrap_or_default() {
        let Ok(found) = inputs.list() else { continue };
        assert!(found.is_sorted_by(|a, b| a.number < b.number), "frames are out of order");
        assert!(
            found.iter().all(|frame| fs::metadata(&frame.path).is_ok()),
            "the file of a frame is missing"
        );
        for naming in ["m_{}.ply", "m_{:03}.vtp", "made/"] {
            let outputs = Naming::of(&folder.join(naming)).unwrap().unwrap().outputs(&inputs);
            let made: Vec<_> =
                found.iter().map(|frame| outputs.path(frame.number, &frame.digits)).collect();
            assert!((1..made.len()).all(|i| made[i - 1] != made[i]), "frames share an output");
            assert!(!made.contains(&simulation(&outputs)), "a frame has the simulation's name");
        }
    }
}
