//! Reading and writing a file by position, from several threads at once.

use std::fs::File;
use std::io;
#[cfg(target_os = "linux")]
use std::num::NonZeroU64;

/// Fills `bytes` from position `at` on.
///
/// # Errors
/// The system's, and [`io::ErrorKind::UnexpectedEof`] past the file's end.
pub fn read_exact_at(file: &File, at: u64, bytes: &mut [u8]) -> io::Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::read_exact_at(file, bytes, at);
    #[cfg(not(unix))]
    return serial::at(file, at, |file| io::Read::read_exact(file, bytes));
}

/// Writes all of `bytes` from position `at` on.
///
/// # Errors
/// The system's, such as a full disk.
pub fn write_all_at(file: &File, at: u64, bytes: &[u8]) -> io::Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::write_all_at(file, bytes, at);
    #[cfg(not(unix))]
    return serial::at(file, at, |file| io::Write::write_all(file, bytes));
}

/// Tells the system that `bytes` from position `at` on are wanted soon, so that it reads them meanwhile.
pub fn will_read(file: &File, at: u64, bytes: u64) {
    // A refusal is no matter.
    #[cfg(target_os = "linux")]
    let _ = rustix::fs::fadvise(file, at, NonZeroU64::new(bytes), rustix::fs::Advice::WillNeed);
    #[cfg(not(target_os = "linux"))]
    let _ = (file, at, bytes);
}

/// Where a file has one position for all threads, they take turns.
#[cfg(not(unix))]
mod serial {
    use std::fs::File;
    use std::io::{self, Seek, SeekFrom};
    use std::sync::{Mutex, PoisonError};

    static TURN: Mutex<()> = Mutex::new(());

    pub fn at(mut file: &File, at: u64, work: impl FnOnce(&mut &File) -> io::Result<()>) -> io::Result<()> {
        let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(at))?;
        work(&mut file)
    }
}
