//! The container of `.bgeo.sc`: consecutive Blosc chunks, and an index.
//!
//! A container consists of "scf1", the length of the metadata, the metadata, the chunks, an index,
//! and "1fcs". The index starts with the offsets of all chunks except the first, relative to the
//! first chunk. It ends with three numbers: the unpacked size of each chunk except the last, the
//! unpacked size of the last chunk, and the length of the index without this number. Numbers have
//! 64 bits and are big endian.

use std::io::{self, Write};

use rayon::prelude::*;

use crate::io::bytes::{ByteView, Bytes, PrivateBytes, UnpackBuffer, Unpacking, unpacked_limit};
use crate::io::columns::Endian;
use crate::io::cursor::Cursor;
use crate::io::{ReadFault, malformed};

use super::blosc;

/// The first bytes of a container.
pub const MAGIC: &[u8] = b"scf1";
/// The last bytes of a container.
const END: &[u8] = b"1fcs";
/// Size, in bytes, of a number in a container.
const NUMBER: u64 = 8;
/// Maximum unpacked size, in bytes, of a chunk that is read. Houdini's chunks unpack to 1 MiB.
const LARGEST: u64 = 64 << 20;

/// Unpacked size, in bytes, of written chunks. Houdini uses the same size.
const CHUNK: usize = 1 << 20;

/// The chunks of a container, and their unpacked sizes.
struct Chunks<'a> {
    view: ByteView<'a>,
    /// Byte offset of the start of each chunk, and of the end of the last chunk.
    bounds: Vec<usize>,
    chunk_size: u64,
    last_chunk_size: u64,
}

/// Unpacks a container. Unpacks several chunks in parallel if the memory suffices.
///
/// # Errors
/// [`ReadFault::Malformed`] and [`ReadFault::Truncated`] for damaged files,
/// [`ReadFault::Compression`] for a compression ratio that is too high, and
/// [`ReadFault::Unsupported`] for an unsupported codec.
pub fn unpack(bytes: Bytes, unpacking: Unpacking) -> Result<PrivateBytes, ReadFault> {
    let view = bytes.view();
    let chunks = Chunks::of(view)?;
    let total = chunks.total();
    let limit = unpacked_limit(view.len() as u64);
    if total > limit {
        let what = format!(
            "the data expands to {total} bytes, too many for a file of {} bytes; decompress the \
             file with another program",
            view.len()
        );
        return Err(ReadFault::Compression(what));
    }
    let unpacked = if total <= unpacking.in_memory {
        let mut whole = vec![0; total as usize];
        chunks.unpack(0, &mut whole, unpacking)?;
        PrivateBytes::Owned(whole)
    } else {
        let mut unpacked = UnpackBuffer::new(unpacking);
        let count = chunks.bounds.len() - 1;
        let room = (unpacking.in_memory / chunks.chunk_size.max(1)) as usize;
        let batch = room.clamp(1, 2 * rayon::current_num_threads());
        let mut several = Vec::new();
        for first in (0..count).step_by(batch) {
            let end = count.min(first + batch);
            several.resize(chunks.length(first..end) as usize, 0);
            chunks.unpack(first, &mut several, unpacking)?;
            unpacked.push(&several)?;
        }
        unpacked.finish()?
    };
    view.check()?;
    Ok(unpacked)
}

/// Unpacks the first chunk of a container.
///
/// # Errors
/// The errors of [`unpack`] for damaged files.
pub fn first_chunk(view: ByteView) -> Result<Vec<u8>, ReadFault> {
    let chunks = Chunks::of(view)?;
    let mut chunk = vec![0; chunks.total().min(chunks.chunk_size) as usize];
    chunks.unpack(0, &mut chunk, Unpacking::in_memory())?;
    Ok(chunk)
}

impl<'a> Chunks<'a> {
    fn of(view: ByteView<'a>) -> Result<Self, ReadFault> {
        let len = view.len() as u64;
        let mut cursor = Cursor::new(view, MAGIC.len(), Endian::Big);
        let metadata = cursor.u64("the container's start")?;
        cursor.skip("the container's metadata", metadata, 1)?;
        let start = cursor.at() as u64;
        let truncated = |needed: u64| ReadFault::Truncated {
            what: "the container's index".to_owned(),
            needed,
            have: len,
        };
        let tail = NUMBER + END.len() as u64;
        if len < start + tail {
            return Err(truncated(start + tail));
        }
        let tail_at = len - tail;
        let mut cursor = Cursor::new(view, tail_at as usize, Endian::Big);
        let index = cursor.u64("the index's length")?;
        if cursor.take("the end", END.len() as u64)? != END {
            let what = "the container does not end with \"1fcs\": it was cut off, or is damaged";
            return Err(malformed(tail_at as usize, what));
        }
        if index % NUMBER != 0 || index < 2 * NUMBER || index > tail_at - start {
            let what = format!("the index has an invalid size of {index} bytes");
            return Err(malformed(tail_at as usize, what));
        }
        let index_at = tail_at - index;
        let count = index / NUMBER - 1;
        let mut cursor = Cursor::new(view, index_at as usize, Endian::Big);
        let mut bounds = vec![start as usize];
        for chunk in 1..count {
            let at = cursor.at();
            let bound = cursor.u64("the index")?.checked_add(start).filter(|at| *at < index_at);
            let bound =
                bound.map(|bound| bound as usize).filter(|bound| *bound > bounds[bounds.len() - 1]);
            let outside = || malformed(at, format!("chunk {chunk} is outside the file"));
            bounds.push(bound.ok_or_else(outside)?);
        }
        bounds.push(index_at as usize);
        let at = cursor.at();
        let (chunk_size, last_chunk_size) = (cursor.u64("the index")?, cursor.u64("the index")?);
        if chunk_size == 0 || chunk_size > LARGEST || last_chunk_size > chunk_size {
            let what = format!(
                "invalid chunk sizes: {chunk_size} bytes, and {last_chunk_size} bytes for the last \
                 chunk"
            );
            return Err(malformed(at, what));
        }
        Ok(Self { view, bounds, chunk_size, last_chunk_size })
    }

    /// Total unpacked size, in bytes, of a range of chunks.
    fn length(&self, chunks: std::ops::Range<usize>) -> u64 {
        let has_last = chunks.end == self.bounds.len() - 1;
        let full = chunks.len() as u64 - u64::from(has_last);
        full * self.chunk_size + if has_last { self.last_chunk_size } else { 0 }
    }

    fn total(&self) -> u64 {
        self.length(0..self.bounds.len() - 1)
    }

    /// Unpacks the chunks from number `first` on, until `out` is full.
    fn unpack(&self, first: usize, out: &mut [u8], unpacking: Unpacking) -> Result<(), ReadFault> {
        let pieces = out.par_chunks_mut(self.chunk_size as usize).zip(&self.bounds[first..]);
        let pieces = pieces.zip(&self.bounds[first + 1..]);
        let results = pieces.map(|((piece, &start), &end)| {
            unpacking.check_cancelled()?;
            let packed = self.view.read(start..end)?;
            self.view.release(start..end);
            blosc::unpack(&packed, piece).map_err(|fault| match fault {
                blosc::BloscFault::Unknown(name) => ReadFault::Unsupported(format!(
                    "the data is compressed by {name}, which is not supported; save it \
                     uncompressed as .bgeo"
                )),
                blosc::BloscFault::Damaged(what) => malformed(start, format!("chunk: {what}")),
            })
        });
        // Collect all results first, so that the function always returns the error of the first
        // damaged chunk.
        let results: Vec<Result<(), ReadFault>> = results.collect();
        results.into_iter().collect()
    }
}

/// Writes a container. Compresses several chunks at a time, on all threads.
pub struct ContainerWriter<'a> {
    out: &'a mut dyn Write,
    /// Bytes that have not been compressed yet.
    uncompressed: Vec<u8>,
    /// Number of bytes that are compressed together.
    batch_bytes: usize,
    /// Total size, in bytes, of the chunks written so far.
    written: u64,
    /// Byte offset of each chunk, relative to the first chunk.
    starts: Vec<u64>,
    last_chunk_size: usize,
}

impl<'a> ContainerWriter<'a> {
    /// Writes the start of a container.
    ///
    /// # Errors
    /// The errors of `out`.
    pub fn new(out: &'a mut dyn Write) -> io::Result<Self> {
        out.write_all(MAGIC)?;
        out.write_all(&0_u64.to_be_bytes())?;
        let batch_bytes = 2 * rayon::current_num_threads() * CHUNK;
        Ok(Self {
            out,
            uncompressed: Vec::new(),
            batch_bytes,
            written: 0,
            starts: Vec::new(),
            last_chunk_size: 0,
        })
    }

    fn pack(&mut self) -> io::Result<()> {
        let chunks: Vec<Vec<u8>> = self.uncompressed.par_chunks(CHUNK).map(blosc::pack).collect();
        for chunk in &chunks {
            self.starts.push(self.written);
            self.out.write_all(chunk)?;
            self.written += chunk.len() as u64;
        }
        if !self.uncompressed.is_empty() {
            self.last_chunk_size =
                self.uncompressed.len() - (self.uncompressed.len() - 1) / CHUNK * CHUNK;
        }
        self.uncompressed.clear();
        Ok(())
    }

    /// Compresses and writes the remaining bytes, and writes the index.
    ///
    /// # Errors
    /// The errors of the output.
    pub fn finish(mut self) -> io::Result<()> {
        self.pack()?;
        let starts = self.starts.iter().skip(1).copied();
        let index: Vec<u8> = starts
            .chain([CHUNK as u64, self.last_chunk_size as u64])
            .flat_map(u64::to_be_bytes)
            .collect();
        self.out.write_all(&index)?;
        self.out.write_all(&(index.len() as u64).to_be_bytes())?;
        self.out.write_all(END)
    }
}

impl Write for ContainerWriter<'_> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let taken = buffer.len().min(self.batch_bytes - self.uncompressed.len());
        self.uncompressed.extend_from_slice(&buffer[..taken]);
        if self.uncompressed.len() == self.batch_bytes {
            self.pack()?;
        }
        Ok(taken)
    }

    /// Does nothing. [`write`](Write::write) writes chunks when enough bytes are waiting, and
    /// [`finish`](Self::finish) writes the remaining bytes.
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
