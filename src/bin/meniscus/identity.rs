//! Which file a name is of: links, hard links and other spellings are of one.

use std::path::{Path, PathBuf};

use file_id::{FileId, get_file_id};
use meniscus::error::Error;

/// What tells a file from others.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Identity {
    /// One that is there.
    File(FileId),
    /// One that is not there yet, in a folder whose name is whole.
    Name(PathBuf),
}

impl Identity {
    /// Looks at what is there.
    pub fn of(path: &Path) -> Self {
        if let Ok(id) = get_file_id(path) {
            return Self::File(id);
        }
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = folder.canonicalize().or_else(|_| std::path::absolute(folder));
        Self::Name(folder.unwrap_or_default().join(path.file_name().unwrap_or_default()))
    }
}

/// Refuses a file that is to be read or written and written again, which is a slip of the hand.
pub fn refuse_same_file(one: &Path, other: &Path) -> Result<(), Error> {
    if Identity::of(one) == Identity::of(other) { Err(two_purposes(other, one)) } else { Ok(()) }
}

/// What such a refusal says.
pub fn two_purposes(path: &Path, other: &Path) -> Error {
    let path = path.display();
    Error::Request(match other.display() {
        other if other.to_string() == path.to_string() => format!("{path}: is given for two purposes"),
        other => format!("{path}: is given for two purposes: it is the same file as {other}"),
    })
}
