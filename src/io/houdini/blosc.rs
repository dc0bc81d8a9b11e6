//! Reads and writes chunks of Blosc 1.
//!
//! A chunk consists of blocks. In each block, the bytes are shuffled so that the first bytes of all
//! numbers are adjacent, and then compressed by one of several codecs. The format is described in
//! c-blosc's README_HEADER.rst. Numbers are little endian.

use libdeflater::Decompressor;

/// Size, in bytes, of a chunk's header.
const HEADER: usize = 16;
/// Maximum size, in bytes, of the numbers in a block that is split into streams. Such a block has
/// one stream for each byte of a number.
const MOST_SPLITS: usize = 16;
/// Minimum number of values in a block that is split.
const LEAST_SPLIT: usize = 128;
/// Maximum distance, in bytes, that BloscLZ encodes in 13 bits.
const FARTHEST: usize = 8191;

/// Size, in bytes, of the numbers in written chunks, as in Houdini's files.
const WRITTEN_TYPE: usize = 4;
/// Size, in bytes, of the blocks in written chunks, as in Houdini's files.
const WRITTEN_BLOCK: usize = 1 << 19;

/// An error that occurred while unpacking a chunk.
#[derive(Debug, PartialEq, Eq)]
pub enum BloscFault {
    /// The name of a codec that is not supported.
    Unknown(&'static str),
    /// A description of the damage in the chunk.
    Damaged(&'static str),
}

use BloscFault::Damaged;

/// A compression codec.
#[derive(Debug, Clone, Copy)]
enum Codec {
    BloscLz,
    Lz4,
    Zlib,
    Zstd,
}

/// The order of bytes in a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shuffle {
    None,
    /// The first bytes of all numbers, then the second bytes of all numbers, and so on.
    Bytes,
    /// The lowest bits of all numbers, then the second lowest bits, and so on.
    Bits,
}

/// The header of a chunk.
struct BloscHeader {
    codec: Codec,
    filter: Shuffle,
    is_stored: bool,
    may_split: bool,
    type_size: usize,
    block: usize,
}

impl BloscHeader {
    fn of(chunk: &[u8], length: usize) -> Result<Self, BloscFault> {
        let header: &[u8; HEADER] = chunk.first_chunk().ok_or(Damaged("it has no header"))?;
        let number = |at: usize| {
            u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]])
                as usize
        };
        let (flags, type_size) = (header[2], usize::from(header[3]));
        if header[0] == 0 || header[0] > 2 {
            return Err(Damaged("its version is not 1 or 2"));
        }
        if number(4) != length {
            return Err(Damaged("its unpacked length differs from the index"));
        }
        if number(12) != chunk.len() {
            return Err(Damaged("its length differs from the index"));
        }
        let block = number(8);
        if type_size == 0 || (block == 0 && length > 0) {
            return Err(Damaged("the size of its blocks or numbers is 0"));
        }
        let codec = match flags >> 5 {
            0 => Codec::BloscLz,
            1 => Codec::Lz4,
            2 => return Err(BloscFault::Unknown("Snappy")),
            3 => Codec::Zlib,
            4 => Codec::Zstd,
            _ => return Err(Damaged("its compression is unknown")),
        };
        let filter = match flags {
            _ if flags & 4 != 0 => Shuffle::Bits,
            _ if flags & 1 != 0 && type_size > 1 => Shuffle::Bytes,
            _ => Shuffle::None,
        };
        let (is_stored, may_split) = (flags & 2 != 0, flags & 0x10 == 0);
        Ok(Self { codec, filter, is_stored, may_split, type_size, block })
    }

    /// The number of compressed streams in a block that unpacks to `bytes` bytes.
    fn streams(&self, bytes: usize) -> usize {
        let is_split = self.may_split
            && bytes == self.block
            && self.type_size <= MOST_SPLITS
            && bytes / self.type_size >= LEAST_SPLIT;
        if is_split { self.type_size } else { 1 }
    }
}

/// Unpacks a chunk into `out`, whose length must be the unpacked size of the chunk.
pub fn unpack(chunk: &[u8], out: &mut [u8]) -> Result<(), BloscFault> {
    let header = BloscHeader::of(chunk, out.len())?;
    let rest = &chunk[HEADER..];
    if header.is_stored {
        if rest.len() != out.len() {
            return Err(Damaged("its length differs from its header"));
        }
        out.copy_from_slice(rest);
        return Ok(());
    }
    if out.is_empty() {
        return Ok(());
    }
    let mut shuffled = Vec::new();
    for (number, block) in out.chunks_mut(header.block).enumerate() {
        let at = HEADER + 4 * number;
        let at = chunk.get(at..at + 4).ok_or(Damaged("it ends within its blocks' offsets"))?;
        let at = u32::from_le_bytes([at[0], at[1], at[2], at[3]]) as usize;
        let packed = chunk.get(at..).filter(|_| at >= HEADER);
        let packed = packed.ok_or(Damaged("a block is outside of the chunk"))?;
        if header.filter == Shuffle::None {
            unpack_block(&header, packed, block)?;
            continue;
        }
        shuffled.resize(block.len(), 0);
        unpack_block(&header, packed, &mut shuffled)?;
        match header.filter {
            Shuffle::Bits => restore_bits(&shuffled, header.type_size, block),
            _ => restore_bytes(&shuffled, header.type_size, block),
        }
    }
    Ok(())
}

/// Packs `bytes` into a chunk: shuffles them as the bytes of 32-bit numbers, then compresses them
/// with LZ4.
pub fn pack(bytes: &[u8]) -> Vec<u8> {
    let header = |flags: u8, length: usize| {
        let mut header = vec![2, 1, flags, WRITTEN_TYPE as u8];
        for number in [bytes.len(), WRITTEN_BLOCK.min(bytes.len()), length] {
            header.extend((number as u32).to_le_bytes());
        }
        header
    };
    let blocks = bytes.len().div_ceil(WRITTEN_BLOCK);
    let (mut starts, mut packed) = (Vec::new(), Vec::new());
    let mut shuffled = Vec::new();
    for block in bytes.chunks(WRITTEN_BLOCK) {
        let start = HEADER + 4 * blocks + packed.len();
        starts.extend((start as u32).to_le_bytes());
        shuffled.clear();
        let (numbers, rest) = block.as_chunks::<WRITTEN_TYPE>();
        (0..WRITTEN_TYPE).for_each(|byte| shuffled.extend(numbers.iter().map(|n| n[byte])));
        shuffled.extend(rest);
        // Blocks are not split into streams, so that blocks of any length have the same form.
        let small = lz4_flex::block::compress(&shuffled);
        let small = if small.len() < shuffled.len() { &small } else { &shuffled };
        packed.extend((small.len() as u32).to_le_bytes());
        packed.extend_from_slice(small);
    }
    let length = HEADER + starts.len() + packed.len();
    if length >= HEADER + bytes.len() {
        return [&header(0x22, HEADER + bytes.len()), bytes].concat();
    }
    [header(0x31, length), starts, packed].concat()
}

fn unpack_block(header: &BloscHeader, mut packed: &[u8], out: &mut [u8]) -> Result<(), BloscFault> {
    let streams = header.streams(out.len());
    // A block that is split into streams contains complete numbers, so its streams have equal
    // lengths.
    let each = out.len() / streams;
    if each * streams != out.len() {
        return Err(Damaged("a block ends within a number"));
    }
    for stream in out.chunks_mut(each) {
        let length;
        let ends = Damaged("it ends within a block");
        (length, packed) = packed.split_first_chunk::<4>().ok_or(ends)?;
        let length = u32::from_le_bytes(*length) as usize;
        if length > packed.len() {
            return Err(Damaged("it ends within a block"));
        }
        let own;
        (own, packed) = packed.split_at(length);
        if length == stream.len() {
            stream.copy_from_slice(own);
        } else if decompress(header.codec, own, stream) != Some(stream.len()) {
            return Err(Damaged("a block cannot be unpacked"));
        }
    }
    Ok(())
}

/// Decompresses data into `out`. Returns the number of bytes written, or `None` for damaged data.
fn decompress(codec: Codec, packed: &[u8], out: &mut [u8]) -> Option<usize> {
    match codec {
        Codec::BloscLz => blosc_lz(packed, out),
        Codec::Lz4 => lz4_flex::block::decompress_into(packed, out).ok(),
        Codec::Zlib => Decompressor::new().zlib_decompress(packed, out).ok(),
        Codec::Zstd => zstd::bulk::decompress_to_buffer(packed, out).ok(),
    }
}

/// Decompresses BloscLZ data, which consists of literals and matches, as in FastLZ.
fn blosc_lz(mut packed: &[u8], out: &mut [u8]) -> Option<usize> {
    let mut at = 0;
    // The first control byte always starts a literal, so its upper bits have another meaning.
    let mut control = next(&mut packed)? & 0x1f;
    loop {
        if control < 32 {
            let (literal, rest) = packed.split_at_checked(control + 1)?;
            let end = at + literal.len();
            out.get_mut(at..end)?.copy_from_slice(literal);
            (packed, at) = (rest, end);
        } else {
            let (mut length, high) = ((control >> 5) + 2, (control & 31) << 8);
            if length == 9 {
                loop {
                    let more = next(&mut packed)?;
                    length += more;
                    if more != 255 {
                        break;
                    }
                }
            }
            let low = next(&mut packed)?;
            let mut distance = high + low + 1;
            if high == 31 << 8 && low == 255 {
                let (upper, lower) = (next(&mut packed)?, next(&mut packed)?);
                distance = (upper << 8) + lower + FARTHEST + 1;
            }
            let from = at.checked_sub(distance)?;
            let end = at + length;
            if end > out.len() {
                return None;
            }
            // The match may overlap the bytes that it appends, so bytes are copied one by one.
            for to in at..end {
                out[to] = out[from + (to - at)];
            }
            at = end;
        }
        match next(&mut packed) {
            Some(next) => control = next,
            None => return Some(at),
        }
    }
}

fn next(packed: &mut &[u8]) -> Option<usize> {
    let first;
    (first, *packed) = packed.split_first()?;
    Some(usize::from(*first))
}

/// Reverses the byte shuffle. The bytes of an incomplete number at the end are not shuffled.
fn restore_bytes(shuffled: &[u8], type_size: usize, out: &mut [u8]) {
    let count = out.len() / type_size;
    let whole = count * type_size;
    match type_size {
        4 => restore::<4>(&shuffled[..whole], &mut out[..whole]),
        8 => restore::<8>(&shuffled[..whole], &mut out[..whole]),
        _ => {
            for (byte, bytes) in shuffled[..whole].chunks_exact(count.max(1)).enumerate() {
                let to = out[..whole].iter_mut().skip(byte).step_by(type_size);
                to.zip(bytes).for_each(|(to, from)| *to = *from);
            }
        }
    }
    out[whole..].copy_from_slice(&shuffled[whole..]);
}

/// Reverses the byte shuffle for numbers of `N` bytes. `N` is a constant, so that the compiler can
/// vectorize the loop.
fn restore<const N: usize>(shuffled: &[u8], out: &mut [u8]) {
    let count = out.len() / N;
    if count == 0 {
        return;
    }
    let bytes: [&[u8]; N] = std::array::from_fn(|byte| &shuffled[byte * count..][..count]);
    for (at, number) in out.as_chunks_mut::<N>().0.iter_mut().enumerate() {
        *number = std::array::from_fn(|byte| bytes[byte][at]);
    }
}

/// Reverses the bit shuffle, which stores the lowest bits of all numbers first, then the second
/// lowest bits, and so on. A block whose count of numbers is not a multiple of 8 is not shuffled.
fn restore_bits(shuffled: &[u8], type_size: usize, out: &mut [u8]) {
    let count = out.len() / type_size;
    if !count.is_multiple_of(8) {
        return out.copy_from_slice(shuffled);
    }
    let (whole, row) = (count * type_size, count / 8);
    out.fill(0);
    for (bit, bits) in shuffled[..whole].chunks_exact(row.max(1)).enumerate() {
        let (byte, shift) = (bit / 8, bit % 8);
        for (eight, bits) in bits.iter().enumerate() {
            for number in 0..8 {
                let to = (8 * eight + number) * type_size + byte;
                out[to] |= (bits >> number & 1) << shift;
            }
        }
    }
    out[whole..].copy_from_slice(&shuffled[whole..]);
}
