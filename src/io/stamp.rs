//! Stamps that detect changed inputs.

use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use crc32fast::Hasher;
use file_id::{FileId, get_file_id};
use serde::{Deserialize, Serialize};

use super::ReadError;
use super::frame_files::files_of;
use super::input::file_and_step;

/// A summary of the sizes, times and names of an input's files, and of its frame number.
///
/// A stamp distinguishes an input from other inputs and from its earlier versions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Total size of all files.
    pub bytes: u64,
    /// Modification time of the newest file, in nanoseconds since 1970.
    pub modified: u64,
    /// CRC-32 of each file's name, size and time, and of the number of the frame.
    #[serde(default)]
    pub files: u32,
}

impl Stamp {
    /// The stamp of the input at `path`, which covers its file and the frame's other existing
    /// pieces.
    ///
    /// # Errors
    /// [`ReadError`] with the file that is missing or cannot be accessed.
    pub fn of(path: &Path) -> Result<Self, ReadError> {
        Self::of_all([path])
    }

    /// The stamp of several files that form one frame.
    ///
    /// # Errors
    /// [`ReadError`] with the file that is missing or cannot be accessed.
    pub fn of_all<'a>(paths: impl IntoIterator<Item = &'a Path>) -> Result<Self, ReadError> {
        let (mut bytes, mut newest, mut files) = (0, 0, Hasher::new());
        for path in paths {
            for file in files_of(path) {
                let found = file.metadata().and_then(|of| Ok((of.modified()?, of)));
                let (modified, metadata) =
                    found.map_err(|fault| ReadError::new(&file, fault.into()))?;
                let since = modified.duration_since(UNIX_EPOCH).unwrap_or_default();
                let (size, modified) = (metadata.len(), since.as_nanos() as u64);
                // Ignore the names of folders, because the same folder may have other names on
                // other machines.
                files.update(file.file_name().unwrap_or_default().as_encoded_bytes());
                [size, modified].iter().for_each(|number| files.update(&number.to_le_bytes()));
                (bytes, newest) = (bytes + size, newest.max(modified));
            }
            // Only a frame in a file of several frames has a step.
            if let (_, Some(step)) = file_and_step(path) {
                files.update(&step.to_le_bytes());
            }
        }
        Ok(Self { bytes, modified: newest, files: files.finalize() })
    }
}

/// The identity of a file, which is equal for all paths to this file.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Identity {
    /// An existing file.
    File(FileId),
    /// The path of a file that does not exist yet, with the canonical path of its folder.
    Name(PathBuf),
}

impl Identity {
    /// The identity of the file at `path`.
    pub fn of(path: &Path) -> Self {
        if let Ok(id) = get_file_id(path) {
            return Self::File(id);
        }
        let folder =
            path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = folder.canonicalize().or_else(|_| std::path::absolute(folder));
        Self::Name(folder.unwrap_or_default().join(path.file_name().unwrap_or_default()))
    }
}

/// Whether two paths refer to the same file.
#[must_use]
pub fn is_same_file(one: &Path, other: &Path) -> bool {
    Identity::of(one) == Identity::of(other)
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};
    use std::path::PathBuf;
    use std::time::Duration;

    use super::*;

    /// Writes a file, and sets its modification time to `seconds` after the start of 1970.
    fn write(path: PathBuf, bytes: &[u8], seconds: u64) -> PathBuf {
        fs::write(&path, bytes).unwrap();
        File::options()
            .write(true)
            .open(&path)
            .unwrap()
            .set_modified(UNIX_EPOCH + Duration::from_secs(seconds))
            .unwrap();
        path
    }

    #[test]
    fn a_stamp_depends_on_name_size_and_time_but_not_on_the_folder() {
        let (folder, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let stamp = |folder: &Path, name: &str, bytes: &[u8], seconds: u64| {
            Stamp::of(&write(folder.join(name), bytes, seconds)).unwrap()
        };
        let first = stamp(folder.path(), "a.xyz", b"particles", 7);
        assert_eq!((first.bytes, first.modified), (9, 7_000_000_000));
        assert_eq!(first, stamp(other.path(), "a.xyz", b"particles", 7));
        let others =
            [("b.xyz", "particles", 7), ("a.xyz", "particle", 7), ("a.xyz", "particles", 8)];
        for (name, bytes, seconds) in others {
            assert_ne!(
                first,
                stamp(folder.path(), name, bytes.as_bytes(), seconds),
                "{name} {bytes} {seconds}"
            );
        }
    }

    #[test]
    fn a_stamp_distinguishes_frames_of_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = write(folder.path().join("sim.h5part"), b"frames", 7);
        let of_step =
            |step: u64| Stamp::of(&PathBuf::from(format!("{}#{step}", file.display()))).unwrap();
        assert_eq!(of_step(3), of_step(3));
        assert_ne!(of_step(3), of_step(10));
    }

    #[test]
    fn a_stamp_depends_on_the_time_of_every_piece() {
        let folder = tempfile::tempdir().unwrap();
        let stamp = |of_second: u64| {
            write(folder.path().join("Part_p01_0003.bi4"), b"piece", of_second);
            Stamp::of(&write(folder.path().join("Part_p00_0003.bi4"), b"first", 7)).unwrap()
        };
        let [older, old] = [stamp(3), stamp(5)];
        assert_eq!((older.bytes, older.modified), (old.bytes, old.modified));
        assert_ne!(older, old);
    }
}
