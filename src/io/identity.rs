//! The identity of files: a file's links, hard links and other spellings of its name share one.

use std::path::{Path, PathBuf};

use file_id::{FileId, get_file_id};

/// A file's identity, by which it is told from all others.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Identity {
    /// A file that is there.
    File(FileId),
    /// A file that is not there yet, in a folder whose name is whole.
    Name(PathBuf),
}

impl Identity {
    /// Looks at what is there.
    #[must_use]
    pub fn of(path: &Path) -> Self {
        if let Ok(id) = get_file_id(path) {
            return Self::File(id);
        }
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = folder.canonicalize().or_else(|_| std::path::absolute(folder));
        Self::Name(folder.unwrap_or_default().join(path.file_name().unwrap_or_default()))
    }
}

/// Whether two names are of one file.
#[must_use]
pub fn is_same_file(one: &Path, other: &Path) -> bool {
    Identity::of(one) == Identity::of(other)
}
