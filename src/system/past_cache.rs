//! Writing a large file past the system's cache.
//!
//! A program that writes gigabytes and waits until they are on disk gains nothing from the cache:
//! the system finds as much memory, copies everything into it, and drops useful data for it, such
//! as the particles of the next frame.

use std::fs::File;
use std::io::{self, ErrorKind, Write};

use bytemuck::{Pod, Zeroable, cast_slice, cast_slice_mut};

/// Bytes of any file that go through the cache: a small one may be read again at once.
const CACHED: u64 = 64 << 20;
/// Bytes that are written past the cache at once.
const PIECE: usize = 1 << 20;
/// The multiple at which pieces that are written past the cache begin and end, in memory and in the
/// file, in bytes.
const PAGE: usize = 4096;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(4096))]
struct Page([u8; PAGE]);

/// A file that is written in order, and is whole after [`finish`](Self::finish).
pub struct PastCache<'a> {
    file: &'a File,
    way: Way,
}

/// How what comes next is written.
enum Way {
    /// Through the cache, this many bytes at the most.
    Cached(u64),
    /// Past it by pieces, of which the next is filled so far.
    Past { piece: Vec<Page>, filled: usize },
}

impl<'a> PastCache<'a> {
    /// Takes a file that is empty.
    pub fn new(file: &'a File) -> Self {
        Self::after(CACHED, file)
    }

    /// Writes the first `cached` bytes, in whole pages, through the cache.
    fn after(cached: u64, file: &'a File) -> Self {
        Self { file, way: Way::Cached(cached) }
    }

    /// Writes what is left of the last piece.
    ///
    /// # Errors
    /// The system's, such as a full disk.
    pub fn finish(mut self) -> io::Result<()> {
        match &self.way {
            Way::Cached(_) => Ok(()),
            Way::Past { .. } => self.keep_to_cache(0),
        }
    }

    /// Begins with the first piece, or keeps to the cache where the file system knows no other way.
    fn leave_cache(&mut self) {
        self.way = match past_cache(self.file, true) {
            Ok(()) => Way::Past { piece: vec![Page::zeroed(); PIECE / PAGE], filled: 0 },
            Err(_) => Way::Cached(u64::MAX),
        };
    }

    /// Keeps to the cache from byte `from` of the piece on.
    fn keep_to_cache(&mut self, from: usize) -> io::Result<()> {
        let Way::Past { piece, filled } = std::mem::replace(&mut self.way, Way::Cached(u64::MAX))
        else {
            return Ok(());
        };
        past_cache(self.file, false)?;
        self.file.write_all(&cast_slice(&piece)[from..filled])
    }
}

impl Write for PastCache<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Way::Cached(0) = self.way {
            self.leave_cache();
        }
        match &mut self.way {
            Way::Cached(left) => {
                let most = usize::try_from(*left).map_or(bytes.len(), |left| bytes.len().min(left));
                let count = self.file.write(&bytes[..most])?;
                *left -= count as u64;
                Ok(count)
            }
            Way::Past { piece, filled } => {
                let room = &mut cast_slice_mut(piece)[*filled..];
                let count = bytes.len().min(room.len());
                room[..count].copy_from_slice(&bytes[..count]);
                *filled += count;
                if *filled == PIECE {
                    match write_pages(self.file, cast_slice(piece))? {
                        PIECE => *filled = 0,
                        written => self.keep_to_cache(written)?,
                    }
                }
                Ok(count)
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Writes pages, and returns how many bytes of them could be written past the cache.
fn write_pages(mut file: &File, pages: &[u8]) -> io::Result<usize> {
    let mut written = 0;
    while written < pages.len() && written % PAGE == 0 {
        match file.write(&pages[written..]) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(count) => written += count,
            Err(fault) if fault.kind() == ErrorKind::Interrupted => {}
            // Some file systems refuse it no sooner than now.
            Err(fault) if fault.kind() == ErrorKind::InvalidInput => break,
            Err(fault) => return Err(fault),
        }
    }
    Ok(written)
}

/// Lets what is written to a file from now on go past the cache, or through it.
fn past_cache(file: &File, past: bool) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
        let mut flags = fcntl_getfl(file)?;
        flags.set(OFlags::DIRECT, past);
        Ok(fcntl_setfl(file, flags)?)
    }
    #[cfg(not(target_os = "linux"))]
    {
        let _ = file;
        if past { Err(ErrorKind::Unsupported.into()) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;

    /// The content of a new file that has `before`, after `bytes` were written `at_once`.
    fn written(folder: &Path, before: &[u8], bytes: &[u8], at_once: usize) -> Vec<u8> {
        let mut file = tempfile::NamedTempFile::new_in(folder).unwrap();
        file.write_all(before).unwrap();
        let mut out = PastCache::after(2 * PAGE as u64, file.as_file());
        bytes.chunks(at_once).for_each(|chunk| out.write_all(chunk).unwrap());
        out.finish().unwrap();
        fs::read(file.path()).unwrap()
    }

    /// A folder on a disk, and one in memory, where many systems have one.
    fn folders() -> impl Iterator<Item = tempfile::TempDir> {
        let in_memory = Path::new("/dev/shm");
        let in_memory = in_memory.is_dir().then(|| tempfile::tempdir_in(in_memory).unwrap());
        [tempfile::tempdir().unwrap()].into_iter().chain(in_memory)
    }

    fn bytes(count: usize) -> Vec<u8> {
        (0..count as u32)
            .flat_map(|i| i.wrapping_mul(0x9e37_79b9).to_le_bytes())
            .take(count)
            .collect()
    }

    #[test]
    fn files_of_all_sizes_hold_what_was_written_in_order() {
        let cached = 2 * PAGE;
        for folder in folders() {
            for size in [
                0,
                1,
                cached - 1,
                cached,
                cached + 1,
                cached + PIECE,
                cached + 3 * PIECE + PAGE + 5,
            ] {
                for at_once in [777, PAGE, PIECE - 1, 5 * PIECE] {
                    let bytes = bytes(size);
                    assert!(
                        written(folder.path(), b"", &bytes, at_once) == bytes,
                        "{size} by {at_once}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_cannot_be_written_past_the_cache_is_written_through_it() {
        // No page of the file begins where one of what is written does.
        for folder in folders() {
            let bytes = bytes(3 * PIECE + 5);
            let all = [&b"odd"[..], &bytes].concat();
            assert!(written(folder.path(), b"odd", &bytes, 100_000) == all);
        }
    }

    #[test]
    fn a_disk_that_is_full_is_an_error() {
        let Ok(full) = fs::OpenOptions::new().write(true).open("/dev/full") else { return };
        let mut out = PastCache::after(0, &full);
        assert!(out.write_all(&bytes(PIECE)).and_then(|()| out.finish()).is_err());
    }
}
