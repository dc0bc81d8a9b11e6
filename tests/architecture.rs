//! Imports run one way: every room uses only those before it.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};

/// The rooms, each after those that it may use.
const ROOMS: [&str; 30] = [
    "units",
    "particles",
    "grid",
    "memory",
    "scratch",
    "laps",
    "vulkan",
    "brick",
    "spacing",
    "lattice",
    "mesh",
    "stage/indicator",
    "stage/blur",
    "stage/detail",
    "stage/adaptive",
    "stage/dual_mc",
    "stage/attribute",
    "recipe",
    "backend",
    "plateau",
    "rivals",
    "stitch",
    "simplify",
    "programs",
    "resident",
    "estimate",
    "io",
    "frame",
    "sequence",
    "error",
];

fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        if entry.is_dir() {
            files.extend(sources(&entry));
        } else {
            files.push(entry);
        }
    }
    files.sort();
    files
}

fn room_of(path: &str) -> Option<usize> {
    let path = path.replace("::", "/");
    ROOMS.iter().position(|room| {
        path.strip_prefix(room)
            .is_some_and(|rest| !rest.starts_with(|c: char| c.is_alphanumeric() || c == '_'))
    })
}

#[test]
fn no_room_imports_from_one_that_comes_after_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut arrows = 0;
    for file in sources(&src) {
        let place = file.strip_prefix(&src).unwrap().to_str().unwrap().to_owned();
        if place.starts_with("bin/") || place == "lib.rs" || place == "stage/mod.rs" {
            continue;
        }
        let own = room_of(&place).unwrap_or_else(|| panic!("{place} is in no room"));
        for (number, line) in fs::read_to_string(&file).unwrap().lines().enumerate() {
            for (at, _) in line.match_indices("crate::") {
                let target = &line[at + "crate::".len()..];
                let room = room_of(target)
                    .unwrap_or_else(|| panic!("{place}:{}: {target} is in no room", number + 1));
                assert!(room <= own, "{place}:{}: {} uses {}", number + 1, ROOMS[own], ROOMS[room]);
                arrows += usize::from(room != own);
            }
        }
    }
    assert!(arrows > 40, "only {arrows} imports were seen");
}
