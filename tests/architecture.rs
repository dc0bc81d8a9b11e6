//! Imports run one way: every room uses only those before it, and no files import from each other in a circle.
//!
//! `cargo test --test architecture -- --nocapture` prints every import. What is one, `architecture/imports.rs` says.
#![allow(clippy::unwrap_used)]

#[path = "architecture/imports.rs"]
mod imports;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use imports::Import;
use petgraph::algo::tarjan_scc;
use petgraph::graphmap::DiGraphMap;

/// The rooms, each after those that it may use.
const ROOMS: [&str; 15] = [
    "grid",
    "system",
    "particles",
    "vulkan",
    "brick",
    "field",
    "surface",
    "backend",
    "baselines",
    "io",
    "frame",
    "error",
    "reconstruction",
    "simulation",
    "bin",
];

/// From which file to which, and by what names.
type Ties<'a> = BTreeMap<[&'a str; 2], Vec<&'a str>>;

fn ties(imports: &BTreeSet<Import>) -> Ties<'_> {
    let mut ties = Ties::new();
    imports.iter().for_each(|i| ties.entry([&*i.from, &*i.to]).or_default().push(&i.path));
    ties
}

fn source() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// The number of the room that a file is in.
fn room_of(file: &str) -> Option<usize> {
    ROOMS.iter().position(|room| {
        file.strip_prefix(room).is_some_and(|rest| rest.starts_with('/') || rest.starts_with(".rs"))
    })
}

#[test]
fn no_room_imports_from_one_that_comes_after_it() {
    let imports = imports::imports(&source());
    let room = |file: &str| room_of(file).unwrap_or_else(|| panic!("{file} is in no room"));
    let against = imports.iter().flat_map(|Import { from, to, by, path }| {
        let later = [to, by].into_iter().filter(|used| room(used) > room(from));
        later.map(move |used| format!("{from} uses {used}, by the name of {path}"))
    });
    let against: BTreeSet<String> = against.collect();
    assert!(against.is_empty(), "against the order of rooms: {against:#?}");
    assert!(imports.len() > 1000, "only {} imports were seen", imports.len());
    for ([from, to], paths) in ties(&imports) {
        println!("{from} -> {to}: {}", paths.join(", "));
    }
}

#[test]
fn no_files_import_from_each_other_in_a_circle() {
    let imports = imports::imports(&source());
    let ties = ties(&imports);
    let graph: DiGraphMap<&str, ()> = ties.keys().map(|[from, to]| (*from, *to)).collect();
    let mut circles = String::new();
    for circle in tarjan_scc(&graph).into_iter().filter(|files| files.len() > 1) {
        circles += &format!("a circle: {circle:?}\n");
        for ([from, to], paths) in
            ties.iter().filter(|(files, _)| files.iter().all(|file| circle.contains(file)))
        {
            circles += &format!("    {from} -> {to}: {}\n", paths.join(", "));
        }
    }
    assert!(circles.is_empty(), "{circles}");
}

#[test]
fn no_message_of_the_library_names_an_option_of_the_program() {
    let named = imports::texts(&source()).into_iter().filter(|(file, text)| {
        let option = text
            .match_indices("--")
            .any(|(at, _)| text[at + 2..].starts_with(|c: char| c.is_ascii_lowercase()));
        !file.starts_with("bin/") && option
    });
    assert_eq!(named.collect::<Vec<_>>(), []);
}
