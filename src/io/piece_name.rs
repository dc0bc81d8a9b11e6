//! Names of the files of a snapshot: `base.0.hdf5`, `base.1.hdf5` and so on.

use std::path::{Path, PathBuf};

/// A file's name without its piece's number, and that number, where the name is like `base.0.hdf5`.
#[must_use]
pub fn snapshot_piece(path: &Path) -> Option<(PathBuf, u64)> {
    let (rest, extension) = path.file_name()?.to_str()?.rsplit_once('.')?;
    let (base, digits) = rest.rsplit_once('.').filter(|_| matches!(extension, "h5" | "hdf5"))?;
    let number = digits.bytes().all(|byte| byte.is_ascii_digit()).then(|| digits.parse().ok())??;
    Some((path.with_file_name(format!("{base}.{extension}")), number))
}
