//! Decodes the data of arrays.
//!
//! An array is stored as text, or as a header of lengths followed by the numbers. The numbers may
//! be compressed, and base64 may encode the header and the numbers. The header of uncompressed
//! numbers is their length in bytes. The header of compressed numbers contains the number of
//! blocks, the block size, the size of a smaller last block (0 if there is none), and the
//! compressed size of each block.
//!
//! Arrays with the same name in several pieces are joined.

use std::io::{self, Read};
use std::ops::ControlFlow;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use flate2::read::ZlibDecoder;

use crate::io::bytes::{
    PrivateBytes, SequentialReader, Slice, UnpackBuffer, Unpacking, unpacked_limit,
};
use crate::io::columns::{Column, Endian, Scalar};
use crate::io::compression::unpack_xz;
use crate::io::number::ParseNumber;
use crate::io::scan::Scanner;
use crate::io::text::decode_numbers;
use crate::io::vertices::{columns, integer};
use crate::io::{ReadFault, malformed};

use super::layout::{Compressor, DataLocation, VtpArray, VtpLayout, VtpPiece};

/// Number of bytes per decoding step.
const CHUNK: usize = 1 << 16;
/// Number of bytes that are read before their memory is released.
const RELEASE_STEP: usize = 1 << 20;
/// Maximum unpacked size, in bytes, of an LZ4 block. The size is limited because a block is
/// unpacked into memory as a whole.
const MOST_LZ4: u64 = 64 << 20;
/// Maximum compression ratio of LZ4.
const LZ4_RATIO: u64 = 255;

/// The arrays that store an attribute, or the positions, in all pieces with points.
pub(super) struct JoinedArray<'a> {
    pub components: usize,
    pub parts: Vec<PieceArray<'a>>,
}

/// The array of one piece of a [`JoinedArray`].
#[derive(Clone, Copy)]
pub(super) struct PieceArray<'a> {
    /// Number of points in the piece.
    pub points: usize,
    /// `None` if the piece lacks the array. In this case, all values of the piece are 0.
    pub array: Option<&'a VtpArray>,
}

impl JoinedArray<'_> {
    /// The number of points and the array of the only piece. `None` if there are several pieces, or
    /// if the array cannot be read in place.
    fn raw(&self) -> Option<(usize, &VtpArray)> {
        match *self.parts {
            [PieceArray { points, array: Some(array) }] => {
                matches!(array.data, DataLocation::Raw(_)).then_some((points, array))
            }
            _ => None,
        }
    }
}

/// Decodes the arrays of a file in order.
pub(super) struct Decoder<'a> {
    layout: &'a VtpLayout<'a>,
    /// The decoded data of arrays that cannot be read in place.
    unpacked: UnpackBuffer<'a>,
    /// Maximum number of bytes that may still be decoded. This limits the memory for a small file
    /// in which several arrays refer to the same data.
    allowance: u64,
}

impl<'a> Decoder<'a> {
    pub fn new(layout: &'a VtpLayout<'a>, unpacking: Unpacking<'a>) -> Self {
        let allowance = unpacked_limit(layout.bytes.len() as u64);
        Self { layout, unpacked: UnpackBuffer::new(unpacking), allowance }
    }

    /// Whether all arrays with values for points can be read in place.
    pub fn all_raw(layout: &VtpLayout) -> bool {
        let is_raw = |array: &VtpArray| matches!(array.data, DataLocation::Raw(_));
        layout.compressor.is_none()
            && layout.pieces.iter().flat_map(VtpPiece::of_points).all(is_raw)
    }

    /// Returns the columns of `arrays`. They refer to the file if all arrays can be read in place,
    /// and otherwise to the result of [`finish`](Self::finish).
    pub fn columns(&mut self, arrays: &[JoinedArray]) -> Result<Vec<Vec<Column>>, ReadFault> {
        let raw: Option<Vec<_>> = arrays.iter().map(JoinedArray::raw).collect();
        match raw.filter(|_| self.layout.compressor.is_none()) {
            Some(raw) => self.in_place(&raw),
            None => arrays.iter().map(|array| self.unpack(array)).collect(),
        }
    }

    fn in_place(&self, arrays: &[(usize, &VtpArray)]) -> Result<Vec<Vec<Column>>, ReadFault> {
        let mut claimed = 0;
        let mut all = Vec::new();
        for &(points, array) in arrays {
            let &VtpArray { scalar, components, .. } = array;
            let span = StoredArray { layout: self.layout, array }.raw_span()?;
            let expected = expected_bytes(array, points)?;
            if span.len() as u64 != expected {
                return Err(array.wrong_count(points));
            }
            claimed += expected;
            if claimed > self.layout.bytes.len() as u64 {
                let what = format!("array {} shares its data with other arrays", array.name);
                return Err(malformed(span.start, what));
            }
            let stride = components * scalar.size();
            all.push(columns(span.start, stride, components, scalar, self.layout.endian));
        }
        Ok(all)
    }

    fn unpack(&mut self, joined: &JoinedArray) -> Result<Vec<Column>, ReadFault> {
        let offset = self.unpacked.len();
        let mut kinds = joined.parts.iter().filter_map(|part| part.array).map(|a| self.kind(a));
        let first = kinds.next().unwrap_or(DOUBLE);
        // If the pieces have different number types, all numbers are converted to f64.
        let kind = if kinds.all(|kind| kind == first) { first } else { DOUBLE };
        for part in &joined.parts {
            self.unpack_part(*part, joined.components, kind)?;
        }
        let (scalar, endian) = kind;
        let stride = joined.components * scalar.size();
        Ok(columns(offset as usize, stride, joined.components, scalar, endian))
    }

    /// Number type and byte order that an array has after decoding.
    fn kind(&self, array: &VtpArray) -> (Scalar, Endian) {
        match array.data {
            DataLocation::Text(_) => DOUBLE,
            _ => (array.scalar, self.layout.endian),
        }
    }

    fn unpack_part(
        &mut self,
        PieceArray { points, array }: PieceArray,
        components: usize,
        kind: (Scalar, Endian),
    ) -> Result<(), ReadFault> {
        let offset = self.unpacked.len();
        let Some(array) = array else {
            let zeros = [0; CHUNK];
            let mut left = points * components * kind.0.size();
            while left > 0 {
                let some = left.min(CHUNK);
                self.unpacked.push(&zeros[..some])?;
                left -= some;
            }
            return Ok(());
        };
        let expected = expected_bytes(array, points)?;
        if let DataLocation::Text(text) = &array.data {
            decode_numbers(self.layout.text(), text.clone(), &mut self.unpacked)?;
            let count = (self.unpacked.len() - offset) / Scalar::F64.size() as u64;
            if count.checked_mul(array.scalar.size() as u64) != Some(expected) {
                return Err(array.wrong_count(points));
            }
            return Ok(());
        }
        let stored = StoredArray { layout: self.layout, array };
        let (out, as_stored) = (&mut self.unpacked, (array.scalar, self.layout.endian));
        let mut push = |bytes: &[u8]| out.push(bytes).map(ControlFlow::Continue);
        let read = if kind == as_stored {
            stored.read(Some(points), &mut self.allowance, &mut push)
        } else {
            stored.each_number(Some(points), &mut self.allowance, |number| {
                push(&double(as_stored, number).to_le_bytes())
            })
        };
        read.map(|_| ())
    }

    /// Returns the decoded data. `None` if all columns are in the file.
    pub fn finish(self) -> Result<Option<PrivateBytes>, ReadFault> {
        if self.unpacked.is_empty() {
            return Ok(None);
        }
        self.layout.bytes.check()?;
        self.unpacked.finish().map(Some)
    }

    /// Decodes all numbers of an integer array.
    pub fn integers(&mut self, array: &VtpArray) -> Result<Vec<i64>, ReadFault> {
        if let DataLocation::Text(text) = &array.data {
            return numbers(&self.layout.text()[..text.end], text.start);
        }
        let bytes = self.whole(array)?;
        let whole = bytes.chunks_exact(array.scalar.size());
        let numbers: Option<_> =
            whole.map(|number| integer(array.scalar, self.layout.endian, number)).collect();
        numbers.ok_or_else(|| no_integers(array))
    }

    /// Calls `take` with the index and value of each number of an integer array.
    pub fn each_integer(
        &mut self,
        array: &VtpArray,
        mut take: impl FnMut(usize, i64),
    ) -> Result<(), ReadFault> {
        let mut count = 0;
        let read = self.integers_until(array, |number| {
            take(count, number);
            count += 1;
            ControlFlow::Continue(())
        });
        read.map(|_| ())
    }

    /// Whether `holds` returns true for a number of an integer array. Stops decoding at the first
    /// such number.
    pub fn any_integer(
        &mut self,
        array: &VtpArray,
        holds: impl Fn(i64) -> bool,
    ) -> Result<bool, ReadFault> {
        let found = self.integers_until(array, |number| match holds(number) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        });
        found.map(|flow| flow.is_break())
    }

    /// Calls `take` with each number of an integer array, until `take` breaks.
    fn integers_until(
        &mut self,
        array: &VtpArray,
        mut take: impl FnMut(i64) -> ControlFlow<()>,
    ) -> Result<ControlFlow<()>, ReadFault> {
        if let DataLocation::Text(text) = &array.data {
            let mut scan = Scanner::releasing_to(self.layout.text(), text.clone());
            loop {
                scan.skip_whitespace();
                if scan.rest().is_empty() {
                    return Ok(ControlFlow::Continue(()));
                }
                if take(scan.number()?).is_break() {
                    return Ok(ControlFlow::Break(()));
                }
            }
        }
        let (stored, endian) = (StoredArray { layout: self.layout, array }, self.layout.endian);
        stored.each_number(None, &mut self.allowance, |number| {
            let number = integer(array.scalar, endian, number);
            number.map(&mut take).ok_or_else(|| no_integers(array))
        })
    }

    /// Decodes an array of a single number. `None` if it has several numbers or none.
    pub fn single(&mut self, array: &VtpArray) -> Result<Option<f64>, ReadFault> {
        if let DataLocation::Text(text) = &array.data {
            let numbers: Vec<f64> = numbers(&self.layout.text()[..text.end], text.start)?;
            return Ok(numbers.first().copied().filter(|_| numbers.len() == 1));
        }
        let bytes = self.whole(array)?;
        let is_single = bytes.len() == array.scalar.size();
        Ok(is_single.then(|| double((array.scalar, self.layout.endian), &bytes)))
    }

    fn whole(&mut self, array: &VtpArray) -> Result<Vec<u8>, ReadFault> {
        let mut bytes = Vec::new();
        let stored = StoredArray { layout: self.layout, array };
        let _ = stored.read(None, &mut self.allowance, &mut |chunk| {
            bytes.extend_from_slice(chunk);
            Ok(ControlFlow::Continue(()))
        })?;
        Ok(bytes)
    }
}

/// The number type of decoded text. It is also used if the pieces store an array with different
/// number types.
const DOUBLE: (Scalar, Endian) = (Scalar::F64, Endian::Little);

/// Converts a stored number to the nearest f64.
fn double((scalar, endian): (Scalar, Endian), number: &[u8]) -> f64 {
    let bits = |scalar| integer(scalar, endian, number).unwrap_or_default();
    match scalar {
        Scalar::F32 => f32::from_bits(bits(Scalar::U32) as u32).into(),
        Scalar::F64 => f64::from_bits(bits(Scalar::I64) as u64),
        Scalar::U64 => bits(Scalar::I64) as u64 as f64,
        scalar => bits(scalar) as f64,
    }
}

/// Size, in bytes, of an array with a value for each of `points` points.
fn expected_bytes(array: &VtpArray, points: usize) -> Result<u64, ReadFault> {
    let values = points.checked_mul(array.components).filter(|values| *values > 0);
    let bytes = values.and_then(|values| values.checked_mul(array.scalar.size()));
    bytes.map(|bytes| bytes as u64).ok_or_else(|| array.wrong_count(points))
}

fn no_integers(array: &VtpArray) -> ReadFault {
    malformed(array.place(), format!("array {} does not contain integers", array.name))
}

/// Parses all numbers of `text`, starting at byte `at`.
fn numbers<T: ParseNumber>(text: &[u8], at: usize) -> Result<Vec<T>, ReadFault> {
    let mut scan = Scanner::new(text, at);
    let mut numbers = Vec::new();
    loop {
        scan.skip_whitespace();
        if scan.rest().is_empty() {
            return Ok(numbers);
        }
        numbers.push(scan.number()?);
    }
}

/// A function that takes bytes, and returns `Break` if it needs no more bytes.
type TakeBytes<'t> = dyn FnMut(&[u8]) -> Result<ControlFlow<()>, ReadFault> + 't;

/// An array that is stored as numbers, not as text.
struct StoredArray<'a> {
    layout: &'a VtpLayout<'a>,
    array: &'a VtpArray,
}

impl StoredArray<'_> {
    /// Calls `take` with the bytes of each number, until `take` breaks. The other arguments are
    /// those of [`read`](Self::read).
    fn each_number(
        &self,
        points: Option<usize>,
        allowance: &mut u64,
        mut take: impl FnMut(&[u8]) -> Result<ControlFlow<()>, ReadFault>,
    ) -> Result<ControlFlow<()>, ReadFault> {
        let size = self.array.scalar.size();
        // A batch may end within a number, so the start of that number is kept for the next batch.
        let mut partial = Vec::new();
        self.read(points, allowance, &mut |chunk| {
            partial.extend_from_slice(chunk);
            let whole = partial.len() / size * size;
            for number in partial[..whole].chunks_exact(size) {
                if take(number)?.is_break() {
                    return Ok(ControlFlow::Break(()));
                }
            }
            partial.drain(..whole);
            Ok(ControlFlow::Continue(()))
        })
    }

    /// Calls `take` with batches of the numbers' bytes, until `take` breaks, and subtracts the size
    /// of the array from `allowance`. `points` is the number of points for which the array must
    /// have values. If it is `None`, the array may have any length.
    fn read(
        &self,
        points: Option<usize>,
        allowance: &mut u64,
        take: &mut TakeBytes<'_>,
    ) -> Result<ControlFlow<()>, ReadFault> {
        let mut stream: Box<dyn Read> = match self.array.data {
            DataLocation::Base64(ref text) => {
                let text = RemainingText {
                    bytes: self.layout.text(),
                    at: text.start,
                    end: text.end,
                    unreleased: text.start,
                };
                Box::new(Base64 { text, plain: Vec::new(), returned: 0 })
            }
            _ => Box::new(SequentialReader::new(self.layout.bytes, self.array.place())),
        };
        let expected = points.map(|points| expected_bytes(self.array, points)).transpose()?;
        let mut claim = |bytes: Option<u64>| match bytes {
            Some(bytes) if expected.is_some_and(|expected| bytes != expected) => {
                Err(self.array.wrong_count(points.unwrap_or_default()))
            }
            Some(bytes) if bytes <= *allowance => {
                *allowance -= bytes;
                Ok(bytes)
            }
            _ => {
                let what =
                    format!("array {} is too large for the size of this file", self.array.name);
                Err(ReadFault::Compression(what))
            }
        };
        match self.layout.compressor {
            None => {
                if let DataLocation::Raw(_) = self.array.data {
                    let span = self.raw_span()?;
                    let mut stream = SequentialReader::new(self.layout.bytes, span.start);
                    let length = claim(Some(span.len() as u64))?;
                    return self.take_uncompressed(&mut stream, length, take);
                }
                let length = claim(Some(self.number(&mut stream)?))?;
                let passed = self.take_uncompressed(&mut stream, length, take)?;
                if passed.is_continue() {
                    self.expect_end(&mut stream)?;
                }
                Ok(passed)
            }
            Some(compressor) => {
                let count = self.number(&mut stream)?;
                let block = self.number(&mut stream)?;
                let last = self.number(&mut stream)?;
                let full = if last == 0 { Some(count) } else { count.checked_sub(1) };
                let full = full.ok_or_else(|| {
                    let what = format!("array {} has a last block, but no blocks", self.array.name);
                    malformed(self.array.place(), what)
                })?;
                claim(full.checked_mul(block).and_then(|bytes| bytes.checked_add(last)))?;
                // Each size is pushed as it is read, so that the size of the file limits the
                // memory, even if `count` is wrong.
                let mut packed = Vec::new();
                for _ in 0..count {
                    packed.push(self.number(&mut stream)?);
                }
                for (number, packed) in (0..).zip(packed) {
                    let mut packed = stream.by_ref().take(packed);
                    let length = if number < full { block } else { last };
                    let unpacked = match compressor {
                        Compressor::Zlib => {
                            self.unpack(ZlibDecoder::new(&mut packed), length, take)
                        }
                        Compressor::Lzma => self.unpack(unpack_xz(&mut packed), length, take),
                        Compressor::Lz4 => self.unpack_lz4(&mut packed, length, take),
                    }?;
                    if unpacked.is_break() {
                        return Ok(ControlFlow::Break(()));
                    }
                    io::copy(&mut packed, &mut io::sink()).map_err(|e| self.fault(&e))?;
                }
                Ok(ControlFlow::Continue(()))
            }
        }
    }

    fn damaged(&self, what: impl std::fmt::Display) -> ReadFault {
        ReadFault::Compression(format!("array {}: {what}", self.array.name))
    }

    /// Decompresses an LZ4 block, until `take` breaks. The decompressed size must be `length`
    /// bytes.
    fn unpack_lz4(
        &self,
        packed: &mut io::Take<impl Read>,
        length: u64,
        take: &mut TakeBytes<'_>,
    ) -> Result<ControlFlow<()>, ReadFault> {
        if length > MOST_LZ4 {
            return Err(ReadFault::Unsupported(format!(
                "array {} has LZ4 blocks of {length} bytes; save it in blocks of {MOST_LZ4} \
                 bytes or less",
                self.array.name
            )));
        }
        // Incompressible data grows only slightly in LZ4.
        if packed.limit() > length + length / LZ4_RATIO + 16 {
            return Err(self.damaged(format_args!("a block has more than {length} bytes")));
        }
        let mut block = Vec::new();
        packed.read_to_end(&mut block).map_err(|e| self.fault(&e))?;
        let mut plain = vec![0; length.min(LZ4_RATIO * block.len() as u64) as usize];
        let unpacked = lz4_flex::block::decompress_into(&block, &mut plain);
        let count = unpacked.map_err(|e| self.damaged(e))?;
        self.unpack(&plain[..count], length, take)
    }

    /// Decompresses a block, until `take` breaks. The decompressed size must be `length` bytes.
    fn unpack(
        &self,
        mut plain: impl Read,
        length: u64,
        take: &mut TakeBytes<'_>,
    ) -> Result<ControlFlow<()>, ReadFault> {
        let damaged = |what: String| self.damaged(what);
        let mut chunk = Vec::new();
        let mut left = length;
        loop {
            chunk.clear();
            let most = left.min(CHUNK as u64) + 1;
            plain
                .by_ref()
                .take(most)
                .read_to_end(&mut chunk)
                .map_err(|e| damaged(e.to_string()))?;
            let Some(rest) = left.checked_sub(chunk.len() as u64) else {
                return Err(damaged(format!("a block has more than {length} bytes")));
            };
            if chunk.is_empty() {
                break;
            }
            if take(&chunk)?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
            left = rest;
        }
        match left {
            0 => Ok(ControlFlow::Continue(())),
            _ => Err(damaged(format!("a block has fewer than {length} bytes"))),
        }
    }

    fn take_uncompressed(
        &self,
        stream: &mut dyn Read,
        length: u64,
        take: &mut TakeBytes<'_>,
    ) -> Result<ControlFlow<()>, ReadFault> {
        let mut chunk = vec![0; length.min(CHUNK as u64) as usize];
        let mut left = length;
        while left > 0 {
            let some = &mut chunk[..left.min(CHUNK as u64) as usize];
            stream.read_exact(some).map_err(|e| self.fault(&e))?;
            if take(some)?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
            left -= some.len() as u64;
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Returns an error if the file declares lengths of 4 bytes, and exactly 4 bytes are left in
    /// the array's element after its data. Some programs write lengths of 8 bytes without declaring
    /// them.
    fn expect_end(&self, stream: &mut dyn Read) -> Result<(), ReadFault> {
        let DataLocation::Base64(ref text) = self.array.data else { return Ok(()) };
        if self.layout.header != Scalar::U32
            || !self.layout.text()[text.end..].starts_with(b"</DataArray")
        {
            return Ok(());
        }
        let mut rest = Vec::new();
        stream.take(5).read_to_end(&mut rest).map_err(|e| self.fault(&e))?;
        if rest.len() != 4 {
            return Ok(());
        }
        let what = format!(
            "array {} has 4 bytes more than its length says; if the length has 64 bits, add \
             header_type=\"UInt64\" to the tag VTKFile",
            self.array.name
        );
        Err(malformed(self.array.place(), what))
    }

    /// Reads a length from the header of an array.
    fn number(&self, stream: &mut dyn Read) -> Result<u64, ReadFault> {
        let mut bytes = [0; 8];
        let bytes = &mut bytes[..self.layout.header.size()];
        stream.read_exact(bytes).map_err(|e| self.fault(&e))?;
        let number = integer(self.layout.header, self.layout.endian, bytes);
        Ok(number.and_then(|number| u64::try_from(number).ok()).unwrap_or(u64::MAX))
    }

    fn fault(&self, fault: &io::Error) -> ReadFault {
        if let Err(changed) = self.layout.bytes.check() {
            return changed;
        }
        let VtpArray { name, .. } = self.array;
        let what = match fault.kind() {
            io::ErrorKind::UnexpectedEof => format!("array {name} has less data than announced"),
            _ => format!("array {name}: {fault}"),
        };
        malformed(self.array.place(), what)
    }

    /// The byte range of the numbers of an array that is neither encoded nor compressed.
    fn raw_span(&self) -> Result<std::ops::Range<usize>, ReadFault> {
        let VtpLayout { bytes, header, endian, .. } = self.layout;
        let have = bytes.len() as u64;
        let what = || format!("array {}", self.array.name);
        let truncated = |needed| ReadFault::Truncated { what: what(), needed, have };
        let DataLocation::Raw(at) = self.array.data else {
            return Err(malformed(self.array.place(), what()));
        };
        let start = at.saturating_add(header.size() as u64);
        if start > have {
            return Err(truncated(start));
        }
        let length = integer(*header, *endian, &bytes.read(at as usize..start as usize)?);
        let length = length.and_then(|length| u64::try_from(length).ok()).unwrap_or(u64::MAX);
        let end = start.saturating_add(length);
        if end > have {
            return Err(truncated(end));
        }
        // Some programs write lengths of 8 bytes without declaring them.
        let wide = at.saturating_add(size_of::<u64>() as u64);
        if *header == Scalar::U32 && wide <= have {
            let length = integer(Scalar::U64, *endian, &bytes.read(at as usize..wide as usize)?);
            let length = length.and_then(|length| u64::try_from(length).ok());
            let wide_end = length.and_then(|length| wide.checked_add(length));
            // If only zeros follow the array, they may be padding, and the length may have 4 bytes.
            let padded = || bytes.read(end as usize..have.min(end + 4) as usize);
            if let Some(wide_end) = wide_end.filter(|end| *end <= have)
                && padded()?.iter().any(|&byte| byte != 0)
                && self.layout.is_end_of_array(wide_end)?
                && !self.layout.is_end_of_array(end)?
            {
                return Ok(wide as usize..wide_end as usize);
            }
        }
        Ok(start as usize..end as usize)
    }
}

/// The remaining bytes of a text. After bytes are read, their memory is released.
struct RemainingText<'a> {
    bytes: Slice<'a>,
    at: usize,
    end: usize,
    unreleased: usize,
}

impl<'a> RemainingText<'a> {
    fn rest(&self) -> &'a [u8] {
        &self.bytes.bytes()[self.at..self.end]
    }

    fn advance(&mut self, count: usize) {
        self.at += count;
        if self.at - self.unreleased >= RELEASE_STEP {
            self.bytes.release(self.unreleased..self.at);
            self.unreleased = self.at;
        }
    }
}

/// Decodes base64 that may contain white space anywhere. Padding may end any group of four
/// characters, because the header of an array may be encoded and padded separately from its data.
struct Base64<'a> {
    text: RemainingText<'a>,
    plain: Vec<u8>,
    returned: usize,
}

impl Base64<'_> {
    fn decode(&mut self) -> io::Result<()> {
        let rest = self.text.rest();
        let rest = &rest[..rest.len().min(CHUNK)];
        let is_code = |&byte: &u8| byte != b'=' && !byte.is_ascii_whitespace();
        let codes = rest.iter().position(|byte| !is_code(byte)).unwrap_or(rest.len()) / 4 * 4;
        let mut group = Vec::new();
        let (codes, passed) = if codes > 0 {
            (&rest[..codes], codes)
        } else {
            let mut passed = 0;
            while group.len() < 4
                && let Some(&byte) = self.text.rest().get(passed)
            {
                passed += 1;
                group.extend(Some(byte).filter(|byte| !byte.is_ascii_whitespace()));
            }
            (&group[..], passed)
        };
        self.plain.clear();
        self.returned = 0;
        let damaged =
            |e: base64::DecodeError| io::Error::new(io::ErrorKind::InvalidData, e.to_string());
        BASE64_STANDARD.decode_vec(codes, &mut self.plain).map_err(damaged)?;
        self.text.advance(passed);
        Ok(())
    }
}

impl Read for Base64<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        while self.returned == self.plain.len() && !self.text.rest().is_empty() {
            self.decode()?;
        }
        let count = (&self.plain[self.returned..]).read(out)?;
        self.returned += count;
        Ok(count)
    }
}
