//! The bytes of an input file. Byte ranges of an uncompressed file are read on demand. Compressed
//! files are unpacked into memory or a scratch file. Pipes, and files whose format must be read as
//! a whole, are copied into memory or a scratch file.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::{Deref, Range};
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError};

use libdeflater::Decompressor;
use memchr::memmem;
use memmap2::Mmap;
use rayon::prelude::*;

use crate::system::control::{Control, Meter, Stage};
use crate::system::reopened::{FileStamp, ReopenedFile, read_exact_at};

use super::compression::{Compression, DICTIONARY};
use super::{ReadError, ReadFault};

/// Number of bytes that are unpacked per step.
const CHUNK: u64 = 1 << 18;
/// Maximum compression ratio. Particles compress to between a half and a tenth of their size. Only
/// a malicious file exceeds this ratio.
const MAX_RATIO: u64 = 128;

/// When a page of a map is read, the system may also map up to this many bytes before the page.
#[cfg(unix)]
const FAULT_AROUND: usize = 64 << 10;

/// Unpacked size, in bytes, that is allowed at any compression ratio.
const ALWAYS_UNPACKED: u64 = 64 << 20;

/// The bytes of a file, read-only.
#[derive(Debug)]
pub enum Bytes {
    /// An uncompressed file. Its byte ranges are read on demand, and the file is never mapped.
    File(ReopenedFile),
    /// Bytes that were unpacked or read into memory or a scratch file.
    Kept(PrivateBytes),
}

/// Bytes that no other program changes.
#[derive(Debug)]
pub enum PrivateBytes {
    /// Bytes in a mapped scratch file.
    Scratch(Arc<Mmap>),
    /// Bytes in memory.
    Owned(Vec<u8>),
}

impl Bytes {
    /// Reads all bytes of the file into memory or a scratch file. Other programs cannot change this
    /// copy while it is decoded, which can take a long time.
    ///
    /// # Errors
    /// [`ReadFault::Changed`] and [`ReadFault::Io`] for a file that has changed or cannot be read,
    /// and [`ReadFault::Scratch`] if the scratch file cannot be written.
    pub fn read_whole(self, unpacking: Unpacking) -> Result<PrivateBytes, ReadFault> {
        let file = match self {
            Self::File(file) => file,
            Self::Kept(kept) => return Ok(kept),
        };
        let len = file.stamp().bytes;
        let read = if len <= unpacking.in_memory {
            let mut whole = vec![0; len as usize];
            let read = |(number, piece): (usize, &mut [u8])| {
                file.read_exact_at((number * WINDOW as usize) as u64, piece)
            };
            whole
                .par_chunks_mut(WINDOW as usize)
                .enumerate()
                .try_for_each(read)
                .map(|()| PrivateBytes::Owned(whole))
        } else {
            let mut copied = UnpackBuffer::new(unpacking);
            let mut piece = vec![0; WINDOW as usize];
            let read = (0..len).step_by(piece.len()).try_for_each(|at| {
                let piece = &mut piece[..(len - at).min(WINDOW) as usize];
                file.read_exact_at(at, piece)?;
                copied.push(piece)
            });
            file.check()?;
            return read.and_then(|()| copied.finish());
        };
        // If another program has changed the file, for example shortened it, `check` returns
        // `Changed`, which takes precedence over the result of the read.
        file.check()?;
        Ok(read?)
    }

    /// Views the bytes without reading all of them.
    pub fn view(&self) -> ByteView<'_> {
        match self {
            Self::File(file) => ByteView::File(file),
            Self::Kept(kept) => kept.view(),
        }
    }
}

impl From<Vec<u8>> for Bytes {
    fn from(bytes: Vec<u8>) -> Self {
        Self::Kept(PrivateBytes::Owned(bytes))
    }
}

impl PrivateBytes {
    /// Maps a file that no other process can access, or that is trusted to keep its size.
    ///
    /// # Errors
    /// I/O errors of the operating system.
    pub fn map(file: &File) -> io::Result<Self> {
        // SAFETY: the mapped memory is only read, never written. If another program shortens the
        // file meanwhile, a signal can end the process. The same is true of every program that maps
        // files.
        unsafe { Mmap::map(file) }.map(|map| Self::Scratch(Arc::new(map)))
    }

    /// Number of bytes in scratch files.
    pub fn scratch_bytes(&self) -> u64 {
        match self {
            Self::Scratch(map) => map.len() as u64,
            Self::Owned(_) => 0,
        }
    }

    /// Number of bytes in memory that cannot be released.
    pub fn resident_bytes(&self) -> u64 {
        match self {
            Self::Scratch(_) => 0,
            Self::Owned(vec) => vec.len() as u64,
        }
    }

    /// Releases the memory of a range of a scratch file. A later access reads the bytes again. Does
    /// nothing for bytes in memory.
    pub fn release(&self, range: Range<usize>) {
        self.slice().release(range);
    }

    /// The bytes and, if they are in a scratch file, the map that can release their memory.
    pub fn slice(&self) -> Slice<'_> {
        match self {
            Self::Scratch(map) => Slice { bytes: map, map: Some(map) },
            Self::Owned(vec) => vec[..].into(),
        }
    }

    /// The bytes as a view.
    pub fn view(&self) -> ByteView<'_> {
        ByteView::Kept(self.slice())
    }
}

impl Deref for PrivateBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Scratch(map) => map,
            Self::Owned(vec) => vec,
        }
    }
}

/// A cache of one result, for the most recent file. The result is valid while the file is
/// unchanged.
#[derive(Debug)]
pub struct LastFile<T>(Mutex<Option<(PathBuf, FileStamp, T)>>);

impl<T> Default for LastFile<T> {
    fn default() -> Self {
        Self(Mutex::new(None))
    }
}

impl<T: Clone> LastFile<T> {
    /// Creates an empty cache.
    pub const fn new() -> Self {
        Self(Mutex::new(None))
    }

    fn last(&self) -> MutexGuard<'_, Option<(PathBuf, FileStamp, T)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The cached result, if it is for this file and the file is unchanged.
    pub fn get(&self, path: &Path, stamp: FileStamp) -> Option<T> {
        let last = self.last();
        let (of, known, result) = last.as_ref()?;
        ((of.as_path(), *known) == (path, stamp)).then(|| result.clone())
    }

    /// Caches `result` for the file at `path`, and drops any other result.
    pub fn keep(&self, path: &Path, stamp: FileStamp, result: T) {
        *self.last() = Some((path.to_owned(), stamp, result));
    }

    /// Removes the cached result.
    pub fn forget(&self) {
        *self.last() = None;
    }
}

/// Bytes in memory, or in a map whose memory can be released.
#[derive(Debug, Clone, Copy)]
pub struct Slice<'a> {
    bytes: &'a [u8],
    map: Option<&'a Mmap>,
}

impl<'a> Slice<'a> {
    /// The bytes, with the lifetime of the data instead of that of this slice.
    pub fn bytes(self) -> &'a [u8] {
        self.bytes
    }

    /// Releases the memory of a range of a map. A later access reads the bytes again. Does nothing
    /// for bytes in memory.
    pub fn release(self, range: Range<usize>) {
        #[cfg(unix)]
        if let Some(map) = self.map {
            let start = range.start.saturating_sub(FAULT_AROUND);
            let length = range.end - start;
            // SAFETY: the map belongs to a file and is never written, so the system reads the
            // dropped pages from the file again when they are accessed. If the call fails, the
            // pages stay in memory.
            let _ = unsafe {
                map.unchecked_advise_range(memmap2::UncheckedAdvice::DontNeed, start, length)
            };
        }
        #[cfg(not(unix))]
        let _ = (self.map, range);
    }
}

impl<'a> From<&'a [u8]> for Slice<'a> {
    fn from(bytes: &'a [u8]) -> Self {
        Self { bytes, map: None }
    }
}

impl Deref for Slice<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.bytes
    }
}

/// Random access to bytes in memory or in a file.
#[derive(Debug, Clone, Copy)]
pub enum ByteView<'a> {
    /// A file whose byte ranges are read on demand.
    File(&'a ReopenedFile),
    /// Bytes in memory or in a map.
    Kept(Slice<'a>),
}

impl<'a> ByteView<'a> {
    /// The number of bytes.
    #[must_use]
    pub fn len(self) -> usize {
        match self {
            Self::File(file) => file.stamp().bytes as usize,
            Self::Kept(slice) => slice.len(),
        }
    }

    /// Whether there are no bytes.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// The bytes of `range`, which are borrowed if they are in memory.
    ///
    /// # Errors
    /// [`ReadFault::Changed`] and [`ReadFault::Io`] for a file that has changed or cannot be read.
    ///
    /// # Panics
    /// If `range` extends beyond the bytes.
    pub fn read(self, range: Range<usize>) -> Result<Cow<'a, [u8]>, ReadFault> {
        match self {
            Self::File(file) => {
                assert!(range.end <= self.len(), "range to byte {} of {}", range.end, self.len());
                let mut bytes = vec![0; range.len()];
                if let Err(lost) = file.read_exact_at(range.start as u64, &mut bytes) {
                    // If another program has changed the file, for example shortened it, `check`
                    // returns `Changed`, which takes precedence over the error of the read.
                    file.check()?;
                    return Err(lost.into());
                }
                Ok(Cow::Owned(bytes))
            }
            Self::Kept(slice) => Ok(Cow::Borrowed(&slice.bytes()[range])),
        }
    }

    /// The bytes of a file that was read or unpacked as a whole, as text formats require.
    ///
    /// # Errors
    /// [`ReadFault::Changed`] if the file was not read as a whole. A reader calls this function
    /// only for content, such as text, that it reads as a whole when it opens the file. If the file
    /// was not read as a whole, it had other content when it was opened, and has changed since.
    pub fn kept(self) -> Result<Slice<'a>, ReadFault> {
        match self {
            Self::File(_) => Err(ReadFault::Changed),
            Self::Kept(slice) => Ok(slice),
        }
    }

    /// Releases the memory of a range of a map. A later access reads the bytes again. Does nothing
    /// for other bytes.
    pub fn release(self, range: Range<usize>) {
        if let Self::Kept(slice) = self {
            slice.release(range);
        }
    }

    /// Checks that the file has not changed since it was opened.
    ///
    /// # Errors
    /// [`ReadFault::Changed`] if the file has changed.
    pub fn check(self) -> Result<(), ReadFault> {
        match self {
            Self::File(file) => Ok(file.check()?),
            Self::Kept(_) => Ok(()),
        }
    }
}

impl<'a> From<&'a [u8]> for ByteView<'a> {
    fn from(bytes: &'a [u8]) -> Self {
        Self::Kept(bytes.into())
    }
}

/// Number of bytes that a [`SequentialReader`] reads before it releases their memory. When a whole
/// file is copied, this is the number of bytes per read.
const WINDOW: u64 = 1 << 20;

/// Reads bytes sequentially, and releases the memory of the bytes before its position.
#[derive(Debug)]
pub struct SequentialReader<'a> {
    bytes: ByteView<'a>,
    at: u64,
    /// Start of the bytes whose memory has not been released.
    unreleased_from: u64,
}

impl<'a> SequentialReader<'a> {
    /// Starts to read at byte `at`.
    pub fn new(bytes: ByteView<'a>, at: usize) -> Self {
        Self { bytes, at: at as u64, unreleased_from: at as u64 }
    }

    /// Releases the memory of the bytes from `unreleased_from` to the position.
    fn release_passed(&mut self) {
        let end = self.at.min(self.bytes.len() as u64);
        if self.unreleased_from < end {
            self.bytes.release(self.unreleased_from as usize..end as usize);
        }
        self.unreleased_from = self.at;
    }
}

impl Read for SequentialReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = (self.bytes.len() as u64).saturating_sub(self.at);
        let read = left.min(buffer.len() as u64) as usize;
        let buffer = &mut buffer[..read];
        match self.bytes {
            ByteView::File(file) => file.read_exact_at(self.at, buffer)?,
            ByteView::Kept(slice) if read > 0 => {
                buffer.copy_from_slice(&slice[self.at as usize..][..read])
            }
            ByteView::Kept(_) => {}
        }
        self.at += read as u64;
        if self.at - self.unreleased_from >= WINDOW {
            self.release_passed();
        }
        Ok(read)
    }
}

impl Seek for SequentialReader<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.release_passed();
        let end = self.bytes.len() as u64;
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::End(by) => end.checked_add_signed(by),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        self.at = at.ok_or(io::ErrorKind::InvalidInput)?;
        self.unreleased_from = self.at;
        Ok(self.at)
    }
}

impl Drop for SequentialReader<'_> {
    fn drop(&mut self) {
        self.release_passed();
    }
}

/// The memory and scratch folder that unpacking or decoding an input may use.
#[derive(Debug, Clone, Copy)]
pub struct Unpacking<'a> {
    /// Maximum size, in bytes, of a result in memory. A larger result goes to a mapped scratch
    /// file.
    pub in_memory: u64,
    /// The folder for scratch files.
    pub scratch: &'a Path,
    /// If present, receives progress and can cancel the work.
    pub control: Option<&'a Control>,
}

impl Unpacking<'static> {
    /// Unpacks everything into memory, without a limit.
    pub fn in_memory() -> Self {
        Self { in_memory: u64::MAX, scratch: Path::new("."), control: None }
    }

    /// Limits for inspecting a file. A large result goes to a scratch file in the system's
    /// temporary folder.
    pub fn for_inspection() -> Self {
        static FOLDER: LazyLock<PathBuf> = LazyLock::new(std::env::temp_dir);
        Self { in_memory: ALWAYS_UNPACKED, scratch: &FOLDER, control: None }
    }
}

impl Unpacking<'_> {
    /// Returns an error if the caller has cancelled the work.
    pub(super) fn check_cancelled(&self) -> Result<(), ReadFault> {
        let Some(control) = self.control else { return Ok(()) };
        Ok(control.cancel.go_on().map_err(io::Error::from)?)
    }
}

/// A reader of a compressed file that reports its progress to the caller.
struct MeteredBytes<'a, R> {
    bytes: R,
    meter: Option<Meter<'a>>,
}

impl<'a, R> MeteredBytes<'a, R> {
    fn new(bytes: R, count: u64, unpacking: Unpacking<'a>) -> Self {
        let meter = |control: &'a Control| control.meter(Stage::Reading, count as usize);
        Self { bytes, meter: unpacking.control.map(meter) }
    }
}

impl<R: Read> Read for MeteredBytes<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.bytes.read(buffer)?;
        if let Some(meter) = &self.meter {
            meter.go_on()?;
            meter.add(read);
        }
        Ok(read)
    }
}

/// A buffer for unpacked or decoded bytes.
#[derive(Debug)]
pub struct UnpackBuffer<'a> {
    unpacking: Unpacking<'a>,
    memory: Vec<u8>,
    /// The scratch file with all bytes, if they exceed the memory limit.
    file: Option<File>,
    len: u64,
}

impl<'a> UnpackBuffer<'a> {
    /// Creates an empty buffer.
    pub fn new(unpacking: Unpacking<'a>) -> Self {
        Self { unpacking, memory: Vec::new(), file: None, len: 0 }
    }

    /// Number of bytes.
    pub fn len(&self) -> u64 {
        self.len
    }

    /// Whether there are no bytes.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Appends `bytes`.
    ///
    /// # Errors
    /// [`ReadFault::Scratch`] if the scratch file cannot be written.
    pub fn push(&mut self, bytes: &[u8]) -> Result<(), ReadFault> {
        self.unpacking.check_cancelled()?;
        self.len += bytes.len() as u64;
        if self.file.is_none() && self.len > self.unpacking.in_memory {
            let mut file =
                tempfile::tempfile_in(self.unpacking.scratch).map_err(ReadFault::Scratch)?;
            file.write_all(&std::mem::take(&mut self.memory)).map_err(ReadFault::Scratch)?;
            self.file = Some(file);
        }
        match &mut self.file {
            Some(file) => file.write_all(bytes).map_err(ReadFault::Scratch)?,
            None => {
                if self.memory.capacity() < self.len as usize {
                    // Double the capacity, but not beyond the memory limit.
                    let room = (2 * self.len).min(self.unpacking.in_memory) as usize;
                    self.memory.reserve_exact(room - self.memory.len());
                }
                self.memory.extend_from_slice(bytes);
            }
        }
        Ok(())
    }

    /// Returns the appended bytes, mapped if they are in a scratch file.
    ///
    /// # Errors
    /// [`ReadFault::Scratch`] if the scratch file cannot be mapped.
    pub fn finish(self) -> Result<PrivateBytes, ReadFault> {
        match self.file {
            Some(file) => PrivateBytes::map(&file).map_err(ReadFault::Scratch),
            None => Ok(PrivateBytes::Owned(self.memory)),
        }
    }
}

/// Opens `path`, so that byte ranges of the file can be read. A file that is compressed by gzip, xz
/// or zstd, whatever its extension, is unpacked with the limits of
/// [`for_inspection`](Unpacking::for_inspection).
///
/// # Errors
/// [`ReadFault::Io`] if the file cannot be opened or read, [`ReadFault::Empty`] for an empty file,
/// and [`ReadFault::Compression`] for a damaged stream or one whose compression ratio is too high.
pub fn open_bytes(path: &Path) -> Result<Bytes, ReadError> {
    open_bytes_within(path, Unpacking::for_inspection())
}

/// Opens `path` like [`open_bytes`], and reads all of it.
pub fn open_whole(path: &Path) -> Result<PrivateBytes, ReadError> {
    let unpacking = Unpacking::in_memory();
    open_bytes_within(path, unpacking)?
        .read_whole(unpacking)
        .map_err(|fault| ReadError::new(path, fault))
}

/// Opens `path` like [`open_bytes_within`], to read one of several frames.
///
/// A compressed file is unpacked into a scratch file, so that later frames need no unpacking. The
/// scratch file is kept until this function opens another compressed file, or the same file after a
/// change. The caller may keep data derived from the bytes as long as the file has the returned
/// stamp.
///
/// # Errors
/// The errors of [`open_bytes_within`].
pub fn open_for_frame(
    path: &Path,
    unpacking: Unpacking,
) -> Result<(Bytes, Option<FileStamp>), ReadError> {
    static UNPACKED: LastFile<Arc<Mmap>> = LastFile::new();
    /// Makes threads that read other frames of the file wait until the file is unpacked.
    static UNPACKING: Mutex<()> = Mutex::new(());
    let compressed = File::open(path)
        .and_then(|file| {
            let stamp = FileStamp::of(&file.metadata()?);
            let mut head = [0; Compression::MAGIC];
            let head = &mut head[..stamp.bytes.min(Compression::MAGIC as u64) as usize];
            read_exact_at(&file, 0, head)?;
            Ok(Compression::of(head).map(|_| stamp))
        })
        // Ignore the error, because `open_bytes_within` opens the file again and reports the error.
        .unwrap_or_default();
    // Without a memory limit, no scratch file is used.
    let compressed = compressed.filter(|_| unpacking.in_memory < u64::MAX);
    let _lock = compressed.map(|_| UNPACKING.lock().unwrap_or_else(PoisonError::into_inner));
    if let Some(stamp) = compressed {
        if let Some(map) = UNPACKED.get(path, stamp) {
            return Ok((Bytes::Kept(PrivateBytes::Scratch(map)), compressed));
        }
        // At most one scratch file is kept, so forget the previous one.
        UNPACKED.forget();
        let unpacked = open_bytes_within(path, Unpacking { in_memory: 0, ..unpacking });
        let unchanged = path.metadata().is_ok_and(|now| FileStamp::of(&now) == stamp);
        match unpacked {
            Ok(Bytes::Kept(PrivateBytes::Scratch(map))) if unchanged => {
                UNPACKED.keep(path, stamp, Arc::clone(&map));
                return Ok((Bytes::Kept(PrivateBytes::Scratch(map)), compressed));
            }
            // If the scratch file cannot be written, the bytes may still fit in memory.
            Err(ReadError { fault: ReadFault::Scratch(_), .. }) => {}
            other => return Ok((other?, None)),
        }
    }
    let bytes = open_bytes_within(path, unpacking)?;
    let stamp = match &bytes {
        Bytes::File(file) => Some(file.stamp()),
        Bytes::Kept(_) => None,
    };
    Ok((bytes, stamp))
}

/// Opens `path` like [`open_bytes`], and unpacks it within the limits of `unpacking`.
///
/// # Errors
/// The errors of [`open_bytes`], and [`ReadFault::Scratch`] if the scratch file cannot be written.
pub fn open_bytes_within(path: &Path, unpacking: Unpacking) -> Result<Bytes, ReadError> {
    let fail = |fault: ReadFault| ReadError::new(path, fault);
    let file = File::open(path).map_err(|e| fail(e.into()))?;
    let metadata = file.metadata().map_err(|e| fail(e.into()))?;
    if metadata.is_dir() {
        return Err(fail(io::Error::from(io::ErrorKind::IsADirectory).into()));
    }
    let len = metadata.len();
    let packed = if metadata.is_file() && len > 0 {
        let mut head = [0; Compression::MAGIC];
        let head = &mut head[..len.min(Compression::MAGIC as u64) as usize];
        read_exact_at(&file, 0, head).map_err(|e| fail(e.into()))?;
        let Some(compression) = Compression::of(head) else {
            return ReopenedFile::new(path, file).map(Bytes::File).map_err(|e| fail(e.into()));
        };
        // Unpack a large file while reading it, so that its compressed bytes are never all in
        // memory.
        if len > ALWAYS_UNPACKED {
            return unpack(compression, file, len, unpacking).map(Bytes::Kept).map_err(fail);
        }
        file_bytes(&file, len).map_err(fail)?
    } else {
        collect(&file, unpacking, ReadFault::Io, |_| Ok(())).map_err(fail)?
    };
    match Compression::of(&packed) {
        None if packed.is_empty() => Err(fail(ReadFault::Empty)),
        None => Ok(Bytes::Kept(packed)),
        Some(compression) => {
            let at_once = (compression == Compression::Gzip)
                .then(|| unpack_at_once(&packed, unpacking.in_memory));
            match at_once.flatten() {
                Some(unpacked) => Ok(unpacked.into()),
                None => unpack(compression, &packed[..], packed.len() as u64, unpacking)
                    .map(Bytes::Kept)
                    .map_err(fail),
            }
        }
    }
}

/// Reads the first `count` bytes of a file into memory.
fn file_bytes(file: &File, count: u64) -> Result<PrivateBytes, ReadFault> {
    let mut bytes = vec![0; count as usize];
    read_exact_at(file, 0, &mut bytes)?;
    Ok(PrivateBytes::Owned(bytes))
}

/// The maximum number of bytes that a compressed file of `packed` bytes may unpack to.
pub(super) fn unpacked_limit(packed: u64) -> u64 {
    packed.saturating_mul(MAX_RATIO).max(ALWAYS_UNPACKED)
}

/// Unpacks a small file with a single gzip stream in one call, which takes half the time of a
/// stream decoder. Returns `None` if the file is damaged, has several streams, or unpacks to too
/// many bytes.
fn unpack_at_once(packed: &[u8], in_memory: u64) -> Option<Vec<u8>> {
    // A gzip stream ends with the length of its content.
    let trailer = packed.last_chunk::<4>()?;
    let len = u32::from_le_bytes(*trailer);
    if u64::from(len) > in_memory.min(ALWAYS_UNPACKED) {
        return None;
    }
    let mut unpacked = vec![0; len as usize];
    let written = Decompressor::new().gzip_decompress(packed, &mut unpacked).ok()?;
    // Decompression stops at the end of the first stream, which ends with this length. If the
    // length occurs only at the end of the file, the file has a single stream.
    let ends = memmem::find(packed, trailer)? + trailer.len();
    (written == unpacked.len() && ends == packed.len()).then_some(unpacked)
}

/// Unpacks a compressed file of `count` bytes.
fn unpack(
    compression: Compression,
    packed: impl Read,
    count: u64,
    unpacking: Unpacking,
) -> Result<PrivateBytes, ReadFault> {
    let plain = compression.unpack(MeteredBytes::new(packed, count, unpacking))?;
    let damaged = |e: io::Error| match e.kind() {
        io::ErrorKind::OutOfMemory => ReadFault::Unsupported(format!(
            "decompression needs a dictionary of more than {} MiB; decompress the file with \
             another program, or compress it with a smaller dictionary",
            DICTIONARY >> 20
        )),
        _ => ReadFault::Compression(e.to_string()),
    };
    let limit = unpacked_limit(count);
    collect(plain, unpacking, damaged, |total| {
        let what = || {
            format!(
                "the data expands to more than {MAX_RATIO} times the file's size; decompress \
                 the file with another program"
            )
        };
        if total > limit { Err(ReadFault::Compression(what())) } else { Ok(()) }
    })
}

/// Reads all bytes of `source`. After each step, calls `check` with the number of bytes so far, and
/// stops if `check` returns an error.
fn collect(
    mut source: impl Read,
    unpacking: Unpacking,
    fault: impl Fn(io::Error) -> ReadFault,
    check: impl Fn(u64) -> Result<(), ReadFault>,
) -> Result<PrivateBytes, ReadFault> {
    let mut unpacked = UnpackBuffer::new(unpacking);
    let mut chunk = Vec::new();
    loop {
        chunk.clear();
        source.by_ref().take(CHUNK).read_to_end(&mut chunk).map_err(&fault)?;
        if chunk.is_empty() {
            return unpacked.finish();
        }
        unpacked.push(&chunk)?;
        check(unpacked.len())?;
    }
}
