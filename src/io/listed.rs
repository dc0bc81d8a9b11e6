//! Paths of files as lists of files name them.

use std::path::{Component, Path, PathBuf};

use super::names::percent_decoded;

/// The place of a file that a list in `folder` names. Names may be written as on Windows or with
/// codes as in a URL: the first spelling counts by which a file is there.
pub fn resolved(folder: &Path, name: &str) -> PathBuf {
    let slashed = name.replace('\\', "/");
    let decoded = [percent_decoded(name), percent_decoded(&slashed)];
    let spellings = [name, &slashed, &decoded[0], &decoded[1]];
    let path = |spelling: &&str| within(folder, Path::new(spelling));
    // Most names have one spelling, and the system is not asked.
    let differ = spellings.iter().any(|spelling| *spelling != name);
    let found = spellings.iter().map(path).find(|path| !differ || path.exists());
    found.unwrap_or_else(|| path(&spellings[1]))
}

/// The path of a name in a folder, as the system lists it: without `.`, and without `..` where that
/// is the same place.
fn within(folder: &Path, name: &Path) -> PathBuf {
    let mut plain = folder.to_owned();
    for part in name.components() {
        let is_folder = matches!(plain.components().next_back(), Some(Component::Normal(_)));
        match part {
            Component::CurDir => {}
            Component::ParentDir if is_folder => {
                plain.pop();
            }
            part => plain.push(part),
        }
    }
    let (same, whole) = (|path: &Path| path.canonicalize().ok(), folder.join(name));
    let has_parents = name.components().any(|part| part == Component::ParentDir);
    // A link may lead elsewhere.
    if has_parents && same(&whole) != same(&plain) { whole } else { plain }
}
