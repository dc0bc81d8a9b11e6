//! Compressed files: gzip, zstd or xz, recognised by the bytes that they begin with.

use std::io::{self, BufReader, Read};

use flate2::read::MultiGzDecoder;
use lzma_rust2::XzReader;
use zstd::stream::read::Decoder as ZstdDecoder;

/// Extensions of compressed files, after that of their format.
pub const EXTENSIONS: [&str; 3] = ["gz", "xz", "zst"];

/// Bytes that a decoder may keep of what it has unpacked: `xz -9` refers 64 MiB back and
/// `zstd --ultra -22` 128 MiB.
pub const DICTIONARY: u64 = 1 << 27;
/// Bytes that an xz decoder needs beside its dictionary, and less.
const OVERHEAD: u64 = 1 << 20;

/// A compression of whole files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compression {
    /// RFC 1952.
    Gzip,
    /// The container of LZMA2 streams.
    Xz,
    /// RFC 8878.
    Zstd,
}

impl Compression {
    /// Bytes at the start of a file that tell its compression.
    pub const MAGIC: usize = 6;

    /// The compression of a file that begins with these bytes.
    pub fn of(head: &[u8]) -> Option<Self> {
        let magics: [(&[u8], Self); 3] = [
            (&[0x1f, 0x8b], Self::Gzip),
            (b"\xfd7zXZ\0", Self::Xz),
            (&[0x28, 0xb5, 0x2f, 0xfd], Self::Zstd),
        ];
        magics.into_iter().find(|(magic, _)| head.starts_with(magic)).map(|(_, found)| found)
    }

    /// Unpacks a file while it is read: all streams in it, one after the other.
    ///
    /// # Errors
    /// Where there is no memory for the decoder.
    pub fn unpack<'a>(self, packed: impl Read + 'a) -> io::Result<Box<dyn Read + 'a>> {
        Ok(match self {
            Self::Gzip => Box::new(MultiGzDecoder::new(packed)),
            Self::Xz => unpack_xz(BufReader::new(packed)),
            Self::Zstd => {
                let mut plain = ZstdDecoder::new(packed)?;
                plain.window_log_max(DICTIONARY.ilog2())?;
                Box::new(plain)
            }
        })
    }
}

/// Unpacks the streams of .xz.
///
/// A dictionary beyond 128 MiB is [`io::ErrorKind::OutOfMemory`].
pub fn unpack_xz<'a>(packed: impl Read + 'a) -> Box<dyn Read + 'a> {
    Box::new(XzReader::new_mem_limit(packed, true, ((DICTIONARY + OVERHEAD) >> 10) as u32))
}

/// A file's name without the extension of a compression.
pub fn plain_name(name: &str) -> &str {
    let plain = name.rsplit_once('.').filter(|(_, extension)| {
        EXTENSIONS.iter().any(|compressed| extension.eq_ignore_ascii_case(compressed))
    });
    plain.map_or(name, |(plain, _)| plain)
}
