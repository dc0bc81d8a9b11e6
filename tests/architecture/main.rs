//! Checks that imports go one way. A room is a folder or a Rust file directly in `src`, except
//! `bindings`. The rooms have a fixed order, and a room may only use the rooms before it. Within a
//! room, files may use each other.
//!
//! `cargo test --test architecture -- --nocapture` prints every import. `architecture/imports.rs`
//! defines what counts as an import.
#![allow(clippy::unwrap_used)]

mod imports;
mod links;
mod manifests;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use imports::Import;

/// The rooms, in order. Each room may use the rooms before it.
const ROOMS: [&str; 19] = [
    "grid",
    "system",
    "particles",
    "vulkan",
    "shaders",
    "brick",
    "field",
    "surface",
    "backend",
    "baselines",
    "io",
    "settings",
    "frame",
    "error",
    "reconstruction",
    "simulation",
    "lib",
    "program",
    "main",
];

/// For each pair of files, the names of the imports from the first to the second.
type ImportNames<'a> = BTreeMap<[&'a str; 2], Vec<&'a str>>;

fn names_by_files(imports: &BTreeSet<Import>) -> ImportNames<'_> {
    let mut names_by_files = ImportNames::new();
    imports
        .iter()
        .for_each(|i| names_by_files.entry([&*i.from, &*i.to]).or_default().push(&i.path));
    names_by_files
}

fn source() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// The index of a file's room in [`ROOMS`].
fn room_of(file: &str) -> Option<usize> {
    ROOMS.iter().position(|room| {
        file.strip_prefix(room).is_some_and(|rest| rest.starts_with('/') || rest.starts_with(".rs"))
    })
}

#[test]
fn rooms_import_only_from_earlier_rooms() {
    let imports = imports::imports(&source());
    let room = |file: &str| room_of(file).unwrap_or_else(|| panic!("{file} is in no room"));
    let violations = imports.iter().flat_map(|Import { from, to, via, path }| {
        let later = [to, via].into_iter().filter(|used| room(used) > room(from));
        later.map(move |used| format!("{from} imports {path} from {used}"))
    });
    let violations: BTreeSet<String> = violations.collect();
    assert!(violations.is_empty(), "imports from later rooms: {violations:#?}");
    assert!(imports.len() > 1000, "only {} imports were seen", imports.len());
    for ([from, to], paths) in names_by_files(&imports) {
        println!("{from} -> {to}: {}", paths.join(", "));
    }
}

#[test]
fn no_message_of_the_library_names_an_option_of_the_program() {
    let named = imports::texts(&source()).into_iter().filter(|(file, text)| {
        let option = text
            .match_indices("--")
            .any(|(at, _)| text[at + 2..].starts_with(|c: char| c.is_ascii_lowercase()));
        !file.starts_with("program/") && option
    });
    assert_eq!(named.collect::<Vec<_>>(), []);
}

#[test]
fn the_program_and_the_bindings_use_only_the_public_facade() {
    let program = imports::files(&source().join("program"));
    let bindings = imports::files(&source().join("bindings"));
    assert!(program.len() > 15, "only {} files were seen", program.len());
    assert!(bindings.len() > 5, "only {} files were seen", bindings.len());
    for file in program.into_iter().chain(bindings) {
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(!text.contains("internals"), "{}: uses unstable items", file.display());
        // In the bindings, which are separate crates, `crate::` names only their own modules.
        let own = file.starts_with(source().join("bindings"));
        assert!(own || !text.contains("crate::"), "{}: uses private items", file.display());
    }
}

/// Words with which the first line of a comment must not begin, because such a line cannot stand
/// alone.
const DEPENDENT_OPENINGS: [&str; 18] = [
    "Of", "What", "The same", "As", "Its", "Their", "Those", "These", "They", "It", "That", "So",
    "Whose", "Who", "Which", "There", "Another", "Such",
];

/// Words with which the summary of a public item must not begin, because such a summary says too
/// little.
const VAGUE_OPENINGS: [&str; 6] =
    ["#", "In ", "All of them", "The other.", "How many there are", "How it "];

/// Whether the lines begin with the documentation of a public item.
fn is_public<'a>(lines: impl IntoIterator<Item = &'a str>) -> bool {
    let mut lines = lines.into_iter().map(str::trim_start);
    lines
        .find(|line| !line.starts_with("///") && !line.starts_with("#["))
        .is_some_and(|line| line.starts_with("pub "))
}

#[test]
fn first_lines_of_docs_stand_alone() {
    let (mut seen, mut dependent) = (0, Vec::new());
    for file in imports::files(&source()) {
        let text = std::fs::read_to_string(&file).unwrap();
        let mut before = None;
        for (number, line) in text.lines().enumerate() {
            let line = line.trim_start();
            let kind = ["///", "//!"].into_iter().find(|kind| line.starts_with(kind));
            if let Some(kind) = kind.filter(|_| kind != before) {
                let first = line.trim_start_matches(kind).trim_start();
                let begins = |word: &&str| {
                    first
                        .strip_prefix(*word)
                        .is_some_and(|rest| rest.starts_with(|c: char| !c.is_alphanumeric()))
                };
                seen += 1;
                let is_vague = VAGUE_OPENINGS.iter().any(|words| first.starts_with(words));
                if DEPENDENT_OPENINGS.iter().any(begins)
                    || is_vague && is_public(text.lines().skip(number))
                {
                    dependent.push(format!("{}:{}: {first}", file.display(), number + 1));
                }
            }
            before = kind;
        }
    }
    assert!(seen > 2000, "only {seen} first lines were seen");
    assert!(dependent.is_empty(), "{dependent:#?}");
}

/// Some functions of the standard library return different last bits on different systems. Code
/// must use `libm` instead, except for pictures, whose last bits may differ.
#[test]
fn meshes_depend_on_no_function_that_systems_round_differently() {
    const NAMES: [&str; 22] = [
        "cbrt", "exp", "exp2", "exp_m1", "ln", "ln_1p", "log", "log2", "log10", "powf", "sin",
        "cos", "tan", "sin_cos", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "hypot",
    ];
    let mut calls = Vec::new();
    for path in imports::files(&source()) {
        let file = path.strip_prefix(source()).unwrap().to_string_lossy().replace('\\', "/");
        let is_exempt = ["bindings/", "surface/picture/"].iter().any(|room| file.starts_with(room))
            || file.ends_with("tests.rs");
        let text = std::fs::read_to_string(&path).unwrap();
        // Ignore tests, which may compare results with the standard library.
        let code = text.split("\nmod tests").next().unwrap();
        for (line, number) in code.lines().zip(1..).filter(|_| !is_exempt) {
            let is_comment = line.trim_start().starts_with("//");
            if !is_comment && NAMES.iter().any(|name| line.contains(&format!(".{name}("))) {
                calls.push(format!("{file}:{number}: {}", line.trim()));
            }
        }
    }
    assert!(calls.is_empty(), "use libm: {calls:#?}");
}
