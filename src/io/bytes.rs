//! The bytes of an input file: mapped where they are on disk as they are, in memory where they had to be unpacked.

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::ops::{Deref, Range};
use std::path::Path;

use flate2::read::MultiGzDecoder;
use memmap2::Mmap;

use super::{ReadError, ReadFault};

/// Bytes that are unpacked at once on their way into a scratch file.
const CHUNK: u64 = 1 << 18;
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
}

/// Bytes that may give memory back.
pub trait ByteStore: Deref<Target = [u8]> + Sync {
    /// Bytes of memory that cannot be given back.
    fn resident_bytes(&self) -> u64 {
        0
    }

    /// Gives the memory of a range back; reading it again brings it back.
    fn release(&self, range: Range<usize>) {
        let _ = range;
    }
}

impl ByteStore for &[u8] {}

impl ByteStore for Bytes {
    fn resident_bytes(&self) -> u64 {
        match self {
            Self::Mapped(_) => 0,
            Self::Owned(vec) => vec.len() as u64,
        }
    }

    fn release(&self, range: Range<usize>) {
        #[cfg(unix)]
        if let Self::Mapped(map) = self {
            // SAFETY: the map is of a file and never written: pages that are dropped are read again.
            // That the system may refuse is no matter.
            let _ = unsafe {
                map.unchecked_advise_range(memmap2::UncheckedAdvice::DontNeed, range.start, range.len())
            };
        }
        #[cfg(not(unix))]
        let _ = range;
    }
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

/// What unpacking an input may take.
#[derive(Debug, Clone, Copy)]
pub struct Unpacking<'a> {
    /// Bytes of memory; what unpacks to more goes to a scratch file, and is mapped.
    pub in_memory: u64,
    /// The folder for scratch files.
    pub scratch: &'a Path,
}

/// Opens `path`: mapped, or unpacked into memory when it is gzipped, whatever its extension says.
///
/// # Errors
/// [`ReadFault::Io`] where the system refuses, [`ReadFault::Empty`] for no bytes at all, and
/// [`ReadFault::Compression`] for a damaged gzip stream, or one that unpacks beyond all reason.
pub fn open_bytes(path: &Path) -> Result<Bytes, ReadError> {
    open_bytes_within(path, Unpacking { in_memory: u64::MAX - 1, scratch: Path::new(".") })
}

/// The same within bounds.
///
/// # Errors
/// As [`open_bytes`], and [`ReadFault::Scratch`] where the scratch file cannot be written.
pub fn open_bytes_within(path: &Path, unpacking: Unpacking) -> Result<Bytes, ReadError> {
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
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(bytes);
    }
    let limit = (GREATEST_RATIO * bytes.len() as u64).max(ALWAYS_UNPACKED);
    match bytes {
        // Read from the file, its pages never count as this process's.
        Bytes::Mapped(_) => unpack(MultiGzDecoder::new(BufReader::new(file)), limit, unpacking),
        Bytes::Owned(packed) => unpack(MultiGzDecoder::new(&packed[..]), limit, unpacking),
    }
    .map_err(fail)
}

/// Unpacks up to `limit` bytes.
fn unpack(mut packed: impl Read, limit: u64, unpacking: Unpacking) -> Result<Bytes, ReadFault> {
    let damaged = |e: io::Error| ReadFault::Compression(e.to_string());
    let mut unpacked = Vec::new();
    let most = unpacking.in_memory.min(limit) + 1;
    packed.by_ref().take(most).read_to_end(&mut unpacked).map_err(damaged)?;
    let mut total = unpacked.len() as u64;
    let reasonable = |total: u64| {
        let what = || format!("it unpacks to more than {GREATEST_RATIO} times its size");
        if total > limit { Err(ReadFault::Compression(what())) } else { Ok(()) }
    };
    reasonable(total)?;
    if total < most {
        return Ok(Bytes::Owned(unpacked));
    }
    let mut file = tempfile::tempfile_in(unpacking.scratch).map_err(ReadFault::Scratch)?;
    let mut chunk = unpacked;
    while !chunk.is_empty() {
        file.write_all(&chunk).map_err(ReadFault::Scratch)?;
        chunk = Vec::new();
        total += packed.by_ref().take(CHUNK).read_to_end(&mut chunk).map_err(damaged)? as u64;
        reasonable(total)?;
    }
    Bytes::map(&file).map_err(ReadFault::Scratch)
}
