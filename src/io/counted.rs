//! Writing a file and knowing what was written.

use std::fs::File;
use std::io::{self, BufWriter, Write};

use crc32fast::Hasher;

use crate::system::past_cache::PastCache;

/// Bytes that are given to the system at once: of small pieces as many, and of large ones no more, for which it would look for memory that
/// no program has used lately.
const AT_ONCE: usize = 256 << 10;

/// How many bytes `content` writes to `out`, and what sums them up, if anything does.
pub(super) fn counted(
    out: impl Write,
    crc: Option<Hasher>,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<(u64, Option<Hasher>)> {
    let out = Counted { out, bytes: 0, crc };
    let mut out = BufWriter::with_capacity(AT_ONCE, out);
    content(&mut out)?;
    out.flush()?;
    let Counted { bytes, crc, .. } = out.into_inner().map_err(|fault| fault.into_error())?;
    Ok((bytes, crc))
}

/// Works like [`counted`] for a file that is empty, and goes past the system's cache where that becomes large.
pub(super) fn counted_in(
    file: &File,
    crc: Option<Hasher>,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<(u64, Option<Hasher>)> {
    let mut out = PastCache::new(file);
    let counted = counted(&mut out, crc, content)?;
    out.finish()?;
    Ok(counted)
}

struct Counted<W> {
    out: W,
    bytes: u64,
    crc: Option<Hasher>,
}

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let written = self.out.write(&buffer[..buffer.len().min(AT_ONCE)])?;
        self.bytes += written as u64;
        self.crc.iter_mut().for_each(|crc| crc.update(&buffer[..written]));
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
