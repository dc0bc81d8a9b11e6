//! Imports run one way: every room uses only those before it, and no files import from each other in a circle.
//!
//! `cargo test --test architecture -- --nocapture` prints every import. What is one, `architecture/imports.rs` says.
#![allow(clippy::unwrap_used)]

#[path = "architecture/imports.rs"]
mod imports;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use imports::Import;
use jiff::Timestamp;
use jiff::civil::Date;
use jiff::tz::TimeZone;
use petgraph::algo::tarjan_scc;
use petgraph::graphmap::DiGraphMap;

/// The rooms, each after those that it may use.
const ROOMS: [&str; 14] = [
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
    "simulation",
    "error",
    "bin",
];

/// Files that import from each other in a circle.
#[derive(Debug)]
struct Circle {
    files: &'static [&'static str],
    /// The reason: how they are tied together.
    why: &'static str,
    /// The day until which it may stay.
    until: &'static str,
}

/// The circles that are still there.
const CIRCLES: [Circle; 1] = [Circle {
    files: &[
        "bin/meniscus/devices.rs",
        "bin/meniscus/info.rs",
        "bin/meniscus/inspect.rs",
        "bin/meniscus/main.rs",
        "bin/meniscus/method.rs",
        "bin/meniscus/pack.rs",
        "bin/meniscus/reconstruct.rs",
        "bin/meniscus/report.rs",
        "bin/meniscus/sequence.rs",
        "bin/meniscus/sequence/conversion.rs",
        "bin/meniscus/sequence/freeze.rs",
        "bin/meniscus/sequence/one_frame.rs",
        "bin/meniscus/sequence/tally.rs",
    ],
    why: "the options of `reconstruct` are completed all over the program, and commands print through main.rs",
    until: "2027-01-31",
}];

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
fn no_files_import_from_each_other_in_a_circle_but_those_that_may_for_a_while() {
    let imports = imports::imports(&source());
    let ties = ties(&imports);
    let graph: DiGraphMap<&str, ()> = ties.keys().map(|[from, to]| (*from, *to)).collect();
    let circles = tarjan_scc(&graph).into_iter().filter(|files| files.len() > 1);
    let circles: BTreeSet<BTreeSet<&str>> = circles.map(|files| files.into_iter().collect()).collect();
    let listed: BTreeSet<BTreeSet<&str>> =
        CIRCLES.iter().map(|circle| circle.files.iter().copied().collect()).collect();
    let mut differences = String::new();
    for gone in listed.difference(&circles) {
        differences += &format!("no longer a circle, to be struck off the list: {gone:?}\n");
    }
    for new in circles.difference(&listed) {
        differences += &format!("a new circle: {new:?}\n");
        for ([from, to], paths) in
            ties.iter().filter(|(files, _)| files.iter().all(|file| new.contains(file)))
        {
            differences += &format!("    {from} -> {to}: {}\n", paths.join(", "));
        }
    }
    assert!(differences.is_empty(), "{differences}");
}

#[test]
fn a_listed_circle_has_a_reason_and_a_day_that_has_not_come() {
    // Where changes are decided on. A version that was released builds and passes for ever.
    let today = std::env::var_os("CI").map(|_| Timestamp::now().to_zoned(TimeZone::UTC).date());
    for circle in &CIRCLES {
        let until: Date = circle.until.parse().unwrap_or_else(|fault| panic!("{circle:?}: {fault}"));
        assert!(today.is_none_or(|today| until >= today), "its time is over: {circle:?}");
        assert!(!circle.why.is_empty(), "without a reason: {circle:?}");
    }
}
