//! Writes a large file without the system's cache.
//!
//! A program that writes gigabytes and waits until they are on disk does not benefit from the
//! cache: the system would copy all data into the cache, and evict useful data from it, such as the
//! particles of the next frame.

use std::fs::File;
use std::io::{self, ErrorKind, Write};

use bytemuck::{Pod, Zeroable, cast_slice, cast_slice_mut};

/// Number of bytes at the start of each file that are written through the cache, because a small
/// file may soon be read again.
const CACHED: u64 = 64 << 20;
/// Size, in bytes, of each write without the cache.
const PIECE: usize = 1 << 20;
/// Alignment, in bytes, of uncached writes, both in memory and in the file.
const PAGE: usize = 4096;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(4096))]
struct Page([u8; PAGE]);

/// A file that is written from start to end. It is complete after [`finish`](Self::finish).
pub struct PastCache<'a> {
    file: &'a File,
    mode: WriteMode,
}

/// Whether the next bytes are written through the cache.
enum WriteMode {
    /// At most this many more bytes go through the cache.
    Cached(u64),
    /// Pieces are written without the cache. The current piece contains `filled` bytes.
    Uncached { piece: Vec<Page>, filled: usize },
}

impl<'a> PastCache<'a> {
    /// Starts writing a file, which must be empty.
    pub fn new(file: &'a File) -> Self {
        Self::after(CACHED, file)
    }

    /// Starts writing a file whose first `cached` bytes go through the cache. They must be a whole
    /// number of pages.
    fn after(cached: u64, file: &'a File) -> Self {
        Self { file, mode: WriteMode::Cached(cached) }
    }

    /// Writes the bytes of the last piece that are still in memory.
    ///
    /// # Errors
    /// Errors of the system, such as a full disk.
    pub fn finish(mut self) -> io::Result<()> {
        match &self.mode {
            WriteMode::Cached(_) => Ok(()),
            WriteMode::Uncached { .. } => self.return_to_cache(0),
        }
    }

    /// Starts the first uncached piece, or continues with the cache if the file system requires it.
    fn leave_cache(&mut self) {
        self.mode = match bypass_cache(self.file, true) {
            Ok(()) => WriteMode::Uncached { piece: vec![Page::zeroed(); PIECE / PAGE], filled: 0 },
            Err(_) => WriteMode::Cached(u64::MAX),
        };
    }

    /// Writes the rest of the current piece, from its byte `from`, through the cache. All later
    /// bytes also go through the cache.
    fn return_to_cache(&mut self, from: usize) -> io::Result<()> {
        let WriteMode::Uncached { piece, filled } =
            std::mem::replace(&mut self.mode, WriteMode::Cached(u64::MAX))
        else {
            return Ok(());
        };
        bypass_cache(self.file, false)?;
        self.file.write_all(&cast_slice(&piece)[from..filled])
    }
}

impl Write for PastCache<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let WriteMode::Cached(0) = self.mode {
            self.leave_cache();
        }
        match &mut self.mode {
            WriteMode::Cached(left) => {
                let most = usize::try_from(*left).map_or(bytes.len(), |left| bytes.len().min(left));
                let count = self.file.write(&bytes[..most])?;
                *left -= count as u64;
                Ok(count)
            }
            WriteMode::Uncached { piece, filled } => {
                let room = &mut cast_slice_mut(piece)[*filled..];
                let count = bytes.len().min(room.len());
                room[..count].copy_from_slice(&bytes[..count]);
                *filled += count;
                if *filled == PIECE {
                    match write_pages(self.file, cast_slice(piece))? {
                        PIECE => *filled = 0,
                        written => self.return_to_cache(written)?,
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

/// Writes pages without the cache, as far as the file system permits, and returns the number of
/// written bytes.
fn write_pages(mut file: &File, pages: &[u8]) -> io::Result<usize> {
    let mut written = 0;
    while written < pages.len() && written % PAGE == 0 {
        match file.write(&pages[written..]) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(count) => written += count,
            Err(fault) if fault.kind() == ErrorKind::Interrupted => {}
            // Some file systems reject direct I/O, but report this only when data is written.
            Err(fault) if fault.kind() == ErrorKind::InvalidInput => break,
            Err(fault) => return Err(fault),
        }
    }
    Ok(written)
}

/// Makes later writes to a file bypass the cache, or go through the cache again.
fn bypass_cache(file: &File, bypass: bool) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
        let mut flags = fcntl_getfl(file)?;
        flags.set(OFlags::DIRECT, bypass);
        Ok(fcntl_setfl(file, flags)?)
    }
    #[cfg(not(target_os = "linux"))]
    {
        let _ = file;
        if bypass { Err(ErrorKind::Unsupported.into()) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;

    /// Returns the content of a new file that starts with `before`, after `bytes` were written in
    /// chunks of `at_once` bytes.
    fn written(folder: &Path, before: &[u8], bytes: &[u8], at_once: usize) -> Vec<u8> {
        let mut file = tempfile::NamedTempFile::new_in(folder).unwrap();
        file.write_all(before).unwrap();
        let mut out = PastCache::after(2 * PAGE as u64, file.as_file());
        bytes.chunks(at_once).for_each(|chunk| out.write_all(chunk).unwrap());
        out.finish().unwrap();
        fs::read(file.path()).unwrap()
    }

    /// Returns a folder on disk and, if the system has a file system in memory, a folder there.
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
    fn files_of_all_sizes_contain_the_written_bytes_in_order() {
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
    fn unaligned_data_is_written_through_the_cache() {
        // The written data does not begin at a page boundary of the file.
        for folder in folders() {
            let bytes = bytes(3 * PIECE + 5);
            let all = [&b"odd"[..], &bytes].concat();
            assert!(written(folder.path(), b"odd", &bytes, 100_000) == all);
        }
    }

    #[test]
    fn writing_past_the_cache_to_a_full_disk_is_an_error() {
        let Ok(full) = fs::OpenOptions::new().write(true).open("/dev/full") else { return };
        let mut out = PastCache::after(0, &full);
        assert!(out.write_all(&bytes(PIECE)).and_then(|()| out.finish()).is_err());
    }
}
