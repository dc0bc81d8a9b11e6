//! Checks that the links of Markdown pages work both in the repository and in rustdoc.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::source;

/// Adds all Markdown files below a folder to `pages`.
fn find_pages(folder: &Path, pages: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            find_pages(&path, pages);
        } else if path.extension().is_some_and(|extension| extension == "md") {
            pages.push(path);
        }
    }
}

/// The labels and targets of the reference definitions in a page: lines such as `[label]: target`.
fn definitions(text: &str) -> impl Iterator<Item = (&str, &str)> {
    text.lines().filter_map(|line| line.strip_prefix('[')?.split_once("]: "))
}

/// The targets of the inline links in a page.
fn inline_targets(text: &str) -> impl Iterator<Item = &str> {
    text.split("](").skip(1).filter_map(|rest| Some(rest.split_once(')')?.0))
}

#[test]
fn links_of_pages_lead_to_files_and_rustdoc_knows_their_labels() {
    let read = |path: &Path| std::fs::read_to_string(path).unwrap();
    let library = read(&source().join("lib.rs"));
    let links = read(&source().join("links.md"));
    let known: BTreeSet<&str> = definitions(&links).map(|(label, _)| label).collect();
    let mut pages = vec![source().join("../README.md")];
    find_pages(&source(), &mut pages);
    pages.retain(|page| !page.ends_with("links.md"));
    let mut seen = 0;
    for page in &pages {
        let text = read(page);
        let name = page.strip_prefix(source()).unwrap_or(page).display().to_string();
        if library.contains(&format!("include_str!(\"{name}\")")) {
            let unknown = definitions(&text).find(|(label, _)| !known.contains(label));
            assert_eq!(unknown, None, "{name}: add the label to src/links.md");
        }
        let targets = definitions(&text).map(|(_, target)| target).chain(inline_targets(&text));
        for target in targets.filter(|target| !target.contains("://")) {
            let file = target.split('#').next().unwrap();
            let exists = file.is_empty() || page.with_file_name(file).exists();
            assert!(exists, "{name}: there is no file {target}");
            seen += 1;
        }
    }
    assert!(seen > 80, "only {seen} links were seen");
}
