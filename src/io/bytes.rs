//! The bytes of an input file: mapped where they are on disk as they are, in memory where they had to be unpacked.

use std::fs::File;
use std::io::{self, Read};
use std::ops::Deref;
use std::path::Path;

use flate2::read::MultiGzDecoder;
use memmap2::Mmap;

use super::{ReadError, ReadFault};

/// Particles pack to a half or a tenth; only a file made to exhaust the memory packs better than this.
const GREATEST_RATIO: u64 = 128;

/// Bytes that any file may unpack to.
const ALWAYS_UNPACKED: u64 = 64 << 20;

/// A file's bytes, read-only.
#[derive(Debug)]
pub enum Bytes {
    /// Pages come and go with their use.
    Mapped(Mmap),
    /// Unpacked, or not mappable.
    Owned(Vec<u8>),
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map,
            Self::Owned(vec) => vec,
        }
    }
}

impl Bytes {
    /// Maps all of `file`.
    ///
    /// # Errors
    /// Where the system refuses.
    pub fn map(file: &File) -> io::Result<Self> {
        // SAFETY: the map is never written through. Another program that shortens the file meanwhile can end
        // the run by a signal, as it can for every mapping reader.
        unsafe { Mmap::map(file) }.map(Self::Mapped)
    }

    /// Gives the memory of mapped pages back to the system, which reads them anew where they are used again.
    pub fn release(&self) {
        #[cfg(unix)]
        if let Self::Mapped(map) = self {
            // SAFETY: the pages are those of a file, mapped to be shared and only read: they come back as they
            // were, for this thread and for all that read them at this moment.
            // That memory is not given back is no error: nothing but the memory is worse for it.
            let _ = unsafe { map.unchecked_advise(memmap2::UncheckedAdvice::DontNeed) };
        }
    }
}

/// Opens `path`: mapped, or unpacked into memory when it is gzipped, whatever its extension says.
///
/// # Errors
/// [`ReadFault::Io`] where the system refuses, [`ReadFault::Empty`] for no bytes at all, and
/// [`ReadFault::Compression`] for a damaged gzip stream, or one that unpacks beyond all reason.
pub fn open_bytes(path: &Path) -> Result<Bytes, ReadError> {
    let fail = |fault: ReadFault| ReadError::new(path, fault);
    let mut file = File::open(path).map_err(|e| fail(e.into()))?;
    let metadata = file.metadata().map_err(|e| fail(e.into()))?;
    if metadata.is_dir() {
        return Err(fail(io::Error::from(io::ErrorKind::IsADirectory).into()));
    }
    let bytes = if metadata.is_file() && metadata.len() > 0 {
        Bytes::map(&file).map_err(|e| fail(e.into()))?
    } else {
        let mut owned = Vec::new();
        file.read_to_end(&mut owned).map_err(|e| fail(e.into()))?;
        Bytes::Owned(owned)
    };
    if bytes.is_empty() {
        return Err(fail(ReadFault::Empty));
    }
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let limit = (GREATEST_RATIO * bytes.len() as u64).max(ALWAYS_UNPACKED);
        let mut unpacked = Vec::new();
        MultiGzDecoder::new(&*bytes)
            .take(limit + 1)
            .read_to_end(&mut unpacked)
            .map_err(|e| fail(ReadFault::Compression(e.to_string())))?;
        if unpacked.len() as u64 > limit {
            let what = format!("it unpacks to more than {GREATEST_RATIO} times its size");
            return Err(fail(ReadFault::Compression(what)));
        }
        return Ok(Bytes::Owned(unpacked));
    }
    Ok(bytes)
}
