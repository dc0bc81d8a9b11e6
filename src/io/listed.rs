//! Resolves the paths in a list of files.

use std::path::{Component, Path, PathBuf};

use super::names::percent_decoded;

/// The path of a file that a list in `folder` calls `name`. A name may have backslashes, or percent
/// codes as in a URL. Returns the first spelling for which a file exists, or else the name with
/// slashes instead of backslashes.
pub fn resolved(folder: &Path, name: &str) -> PathBuf {
    let slashed = name.replace('\\', "/");
    let decoded = [percent_decoded(name), percent_decoded(&slashed)];
    let spellings = [name, &slashed, &decoded[0], &decoded[1]];
    let path = |spelling: &&str| within(folder, Path::new(spelling));
    // For most names, all spellings are equal, and no system call is needed.
    let differ = spellings.iter().any(|spelling| *spelling != name);
    let found = spellings.iter().map(path).find(|path| !differ || path.exists());
    found.unwrap_or_else(|| path(&spellings[1]))
}

/// The path `name` in `folder`, without `.`, and without `..` if the path without `..` leads to the
/// same file.
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
    let (canonical, joined) = (|path: &Path| path.canonicalize().ok(), folder.join(name));
    let has_parents = name.components().any(|part| part == Component::ParentDir);
    // If a folder is a symbolic link, `..` may lead to another folder. In this case, `..` must
    // stay.
    if has_parents && canonical(&joined) != canonical(&plain) { joined } else { plain }
}
