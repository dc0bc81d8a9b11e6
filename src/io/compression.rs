//! Detects and unpacks files that are compressed by gzip, xz or zstd. The first bytes of a file
//! identify its compression.

use std::io::{self, BufReader, Read};

use flate2::read::MultiGzDecoder;
use lzma_rust2::XzReader;
use zstd::stream::read::Decoder as ZstdDecoder;

/// Extensions of compressed files, which come after the extension of the format.
pub const EXTENSIONS: [&str; 3] = ["gz", "xz", "zst"];

/// Maximum size, in bytes, of a decoder's dictionary. `xz -9` needs 64 MiB, and `zstd --ultra -22`
/// needs 128 MiB.
pub const DICTIONARY: u64 = 1 << 27;
/// Upper bound, in bytes, of the memory that an xz decoder needs besides its dictionary.
const OVERHEAD: u64 = 1 << 20;

/// The compression of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compression {
    /// The gzip format (RFC 1952).
    Gzip,
    /// The .xz format, a container of LZMA2 streams.
    Xz,
    /// The Zstandard format (RFC 8878).
    Zstd,
}

impl Compression {
    /// Number of bytes at the start of a file that identify its compression.
    pub const MAGIC: usize = 6;

    /// The compression of a file that starts with `head`. `None` if the file is not compressed.
    pub fn of(head: &[u8]) -> Option<Self> {
        let magics: [(&[u8], Self); 3] = [
            (&[0x1f, 0x8b], Self::Gzip),
            (b"\xfd7zXZ\0", Self::Xz),
            (&[0x28, 0xb5, 0x2f, 0xfd], Self::Zstd),
        ];
        magics.into_iter().find(|(magic, _)| head.starts_with(magic)).map(|(_, found)| found)
    }

    /// Unpacks a stream of bytes, which may contain several compressed streams.
    ///
    /// # Errors
    /// If the system has no memory for the decoder.
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

/// Unpacks the streams of an .xz file.
///
/// A dictionary of more than 128 MiB gives an [`io::ErrorKind::OutOfMemory`] error.
pub fn unpack_xz<'a>(packed: impl Read + 'a) -> Box<dyn Read + 'a> {
    Box::new(XzReader::new_mem_limit(packed, true, ((DICTIONARY + OVERHEAD) >> 10) as u32))
}

/// The name of a file without its compression extension, such as `.gz`.
pub fn plain_name(name: &str) -> &str {
    let plain = name.rsplit_once('.').filter(|(_, extension)| {
        EXTENSIONS.iter().any(|compressed| extension.eq_ignore_ascii_case(compressed))
    });
    plain.map_or(name, |(plain, _)| plain)
}
