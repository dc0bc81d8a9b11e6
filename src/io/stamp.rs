//! Stamps that tell an input from what it was before.

use std::io;
use std::path::Path;
use std::time::UNIX_EPOCH;

use serde::{Deserialize, Serialize};

use super::frame_files::files_of;

/// Size and time of a file, which tell it from what it was before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// The file's size.
    pub bytes: u64,
    /// Time at which it was written, in nanoseconds.
    pub modified: u64,
}

impl Stamp {
    /// Stamps the file as it is now, with all frames that it may hold, and with all its pieces that are there.
    ///
    /// # Errors
    /// Where the system has none.
    pub fn of(path: &Path) -> io::Result<Self> {
        let mut all = Self { bytes: 0, modified: 0 };
        for file in files_of(path) {
            let metadata = file.metadata()?;
            let since = metadata.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
            all.bytes += metadata.len();
            all.modified = all.modified.max(since.as_nanos() as u64);
        }
        Ok(all)
    }
}
