//! Decodes text piece by piece on all threads. Neither the text nor the decoded data need to fit in
//! memory.

use std::borrow::Cow;
use std::ops::{ControlFlow, Range};

use memchr::{memchr, memchr_iter};
use rayon::prelude::*;

use super::bytes::{ByteView, Bytes, Slice, UnpackBuffer, Unpacking};
use super::columns::Endian;
use super::scan::Scanner;
use super::windows::{InputBytes, Windows};
use super::{ReadFault, malformed};

/// Number of bytes per read when lines are read or skipped, and when UTF-16 is converted.
const WINDOW: usize = 1 << 18;
/// Maximum length, in bytes, of a line in a header.
const LONGEST_LINE: usize = 1 << 16;
/// Byte order mark of UTF-8.
const UTF8: &[u8] = b"\xef\xbb\xbf";
/// Byte order marks of UTF-16, with the byte order that each one indicates.
const UTF16: [([u8; 2], Endian); 2] = [([0xff, 0xfe], Endian::Little), ([0xfe, 0xff], Endian::Big)];

/// Minimum size of a piece in bytes.
const PIECE: usize = 1 << 16;
/// Number of bytes that are searched at once for the end of a piece.
const SEARCH_STEP: usize = 1 << 12;
/// Number of pieces per thread that are decoded before their memory is released.
const PIECES: usize = 4;

/// Divides a `range` of `source` into pieces, decodes the pieces on all threads, and passes the
/// results to `take` in order.
///
/// Each piece ends after a byte for which `is_end` returns true. Decoding stops when `take` returns
/// `Break`. The memory of decoded text is released.
pub(super) fn decode_pieces<T: Send>(
    source: Slice,
    range: Range<usize>,
    is_end: fn(u8) -> bool,
    decode: impl Fn(Range<usize>) -> T + Sync,
    take: impl FnMut(T) -> Result<ControlFlow<()>, ReadFault>,
) -> Result<(), ReadFault> {
    let text = &source[..range.end];
    let end_from =
        |least: usize| text[least..].iter().position(|&b| is_end(b)).map(|end| least + end + 1);
    in_pieces(range, end_from, decode, take, |done| source.release(done))
}

/// Like [`decode_pieces`], for a text that is read in windows.
///
/// Each piece is decoded independently, and only the pieces that are being decoded are in memory.
///
/// # Errors
/// The errors of `take`, and [`ReadFault::Changed`] or [`ReadFault::Io`] if the text has changed or
/// cannot be read.
pub(super) fn decode_windows<T: Send>(
    source: &InputBytes,
    range: Range<usize>,
    is_end: fn(u8) -> bool,
    decode: impl Fn(&[u8]) -> T + Sync,
    take: impl FnMut(T) -> Result<ControlFlow<()>, ReadFault>,
) -> Result<(), ReadFault> {
    let end = range.end;
    let end_from = |least: usize| {
        (least..end).step_by(SEARCH_STEP).find_map(|from| {
            let window = from..(from + SEARCH_STEP).min(end);
            let found = source.with(window, |bytes| bytes.iter().position(|&b| is_end(b)));
            found.map(|found| from + found + 1)
        })
    };
    let decode = |piece: Range<usize>| source.with(piece, &decode);
    let decoded = in_pieces(range, end_from, decode, take, |done| source.release(done));
    // A failed read returns zeros, so the result is valid only if this check succeeds.
    source.check().map_err(ReadFault::from)?;
    decoded
}

/// Decodes pieces of `range` and passes the results to `take`. `end_from` returns the first
/// possible end of a piece after a position, or `None` if there is none.
fn in_pieces<T: Send>(
    range: Range<usize>,
    end_from: impl Fn(usize) -> Option<usize>,
    decode: impl Fn(Range<usize>) -> T + Sync,
    mut take: impl FnMut(T) -> Result<ControlFlow<()>, ReadFault>,
    release: impl Fn(Range<usize>),
) -> Result<(), ReadFault> {
    let mut start = range.start;
    while start < range.end {
        let mut pieces = Vec::new();
        let mut at = start;
        while at < range.end && pieces.len() < PIECES * rayon::current_num_threads() {
            let end = end_from((at + PIECE).min(range.end)).unwrap_or(range.end);
            pieces.push(at..end);
            at = end;
        }
        let decoded: Vec<T> = pieces.into_par_iter().map(&decode).collect();
        for piece in decoded {
            if take(piece)?.is_break() {
                return Ok(());
            }
        }
        release(start..at);
        start = at;
    }
    Ok(())
}

/// Decodes the numbers in the range `text` of `source`, and appends them to `out` as little-endian
/// f64.
///
/// # Errors
/// [`ReadFault::Line`] for invalid numbers, and the errors of [`UnpackBuffer::push`].
pub(super) fn decode_numbers(
    source: Slice,
    text: Range<usize>,
    out: &mut UnpackBuffer,
) -> Result<(), ReadFault> {
    let decode = |words: Range<usize>| {
        let mut scan = Scanner::new(&source[..words.end], words.start);
        let mut numbers = Vec::new();
        loop {
            scan.skip_whitespace();
            if scan.rest().is_empty() {
                return Ok(numbers);
            }
            numbers.extend_from_slice(&scan.number::<f64>()?.to_le_bytes());
        }
    };
    let is_end = |byte: u8| byte.is_ascii_whitespace();
    decode_pieces(source, text, is_end, decode, |numbers: Result<Vec<u8>, ReadFault>| {
        out.push(&numbers?)?;
        Ok(ControlFlow::Continue(()))
    })
}

/// Converts UTF-16 with a byte order mark to UTF-8. Returns other text unchanged.
///
/// # Errors
/// [`ReadFault::Malformed`] for an incomplete character at the end, and errors from reading the
/// text or writing the scratch file.
pub(super) fn utf8(bytes: Bytes, unpacking: Unpacking) -> Result<Bytes, ReadFault> {
    let view = bytes.view();
    let mark = view.read(0..view.len().min(2))?;
    let Some((_, endian)) = UTF16.iter().find(|(known, _)| mark[..] == known[..]) else {
        drop(mark);
        return Ok(bytes);
    };
    if !view.len().is_multiple_of(2) {
        return Err(malformed(view.len() - 1, "the last UTF-16 character is incomplete"));
    }
    let unit = match endian {
        Endian::Little => u16::from_le_bytes,
        Endian::Big => u16::from_be_bytes,
    };
    let mut text = UnpackBuffer::new(unpacking);
    let mut units: Vec<u16> = Vec::new();
    for at in (2..view.len()).step_by(WINDOW) {
        let end = view.len().min(at + WINDOW);
        units.extend(view.read(at..end)?.as_chunks().0.iter().map(|&bytes| unit(bytes)));
        // If the window ends with the first half of a surrogate pair, this half is decoded with the
        // next window.
        let is_split = end < view.len() && matches!(units.last(), Some(0xd800..0xdc00));
        let half = if is_split { units.pop() } else { None };
        let decoded: String = char::decode_utf16(units.drain(..))
            .map(|character| character.unwrap_or(char::REPLACEMENT_CHARACTER))
            .collect();
        text.push(decoded.as_bytes())?;
        units.extend(half);
    }
    view.check()?;
    text.finish().map(Bytes::Kept)
}

/// The position of the start of a line.
#[derive(Debug, Clone, Copy)]
pub(super) struct LinePlace {
    /// Byte offset from the start of the text.
    pub at: usize,
    /// Number of lines above this line.
    pub lines_above: u64,
}

/// Reads the lines of a text sequentially, in windows.
pub(super) struct TextLines<'a> {
    view: ByteView<'a>,
    /// The end of the text without trailing whitespace. At most the last `LONGEST_LINE` bytes of
    /// the text are checked for whitespace.
    end: usize,
    at: usize,
    /// Number of lines above the position.
    lines_above: u64,
    window: Cow<'a, [u8]>,
    window_at: usize,
}

impl<'a> TextLines<'a> {
    /// Creates a reader at the first line. A byte order mark is skipped.
    pub fn new(view: ByteView<'a>) -> Result<Self, ReadFault> {
        let marked = *view.read(0..view.len().min(UTF8.len()))? == *UTF8;
        let at = if marked { UTF8.len() } else { 0 };
        let tail = view.len().saturating_sub(LONGEST_LINE).max(at);
        let end = tail + view.read(tail..view.len())?.trim_ascii_end().len();
        Ok(Self { view, end, at, lines_above: 0, window: Cow::Borrowed(&[]), window_at: at })
    }

    /// Creates a reader at the line that starts at `place`.
    pub fn at(view: ByteView<'a>, place: LinePlace) -> Result<Self, ReadFault> {
        let LinePlace { at, lines_above } = place;
        Ok(Self { at, lines_above, window_at: at, ..Self::new(view)? })
    }

    /// The place where the next line starts.
    pub fn place(&self) -> LinePlace {
        LinePlace { at: self.at, lines_above: self.lines_above }
    }

    /// An error in the line that was read last.
    pub fn fault(&self, what: impl Into<String>) -> ReadFault {
        ReadFault::Line { line: self.lines_above.max(1), what: what.into() }
    }

    fn ahead(&mut self) -> Result<&[u8], ReadFault> {
        if self.at >= self.window_at + self.window.len() {
            self.window_at = self.at;
            self.window = self.view.read(self.at..self.end.min(self.at + WINDOW))?;
        }
        Ok(&self.window[self.at - self.window_at..])
    }

    /// Reads a line without its line end and surrounding white space. `None` if only blank lines
    /// remain.
    ///
    /// # Errors
    /// [`ReadFault::Line`] for a line that is too long for a header, and errors from reading the
    /// text.
    pub fn line(&mut self) -> Result<Option<String>, ReadFault> {
        let mut line = Vec::new();
        let start = self.at;
        loop {
            let ahead = self.ahead()?;
            let end = memchr(b'\n', ahead);
            let count = end.unwrap_or(ahead.len());
            line.extend_from_slice(&ahead[..count]);
            let is_last = ahead.is_empty();
            self.at += count + usize::from(end.is_some());
            if line.len() > LONGEST_LINE {
                self.lines_above += 1;
                return Err(self.fault(format!("the line is longer than {LONGEST_LINE} bytes")));
            }
            if end.is_some() || is_last {
                if self.at == start {
                    return Ok(None);
                }
                self.lines_above += 1;
                return Ok(Some(String::from_utf8_lossy(line.trim_ascii()).into_owned()));
            }
        }
    }

    /// Skips `count` lines, or fewer at the end of the text. Returns the number of skipped lines.
    ///
    /// # Errors
    /// Errors from reading the text.
    pub fn skip(&mut self, count: u64) -> Result<u64, ReadFault> {
        let mut skipped = 0;
        // Whether bytes of a line without a line end were skipped.
        let mut begun = false;
        while skipped < count {
            let ahead = self.ahead()?;
            let length = ahead.len();
            if length == 0 {
                skipped += u64::from(begun);
                break;
            }
            let mut passed = length;
            begun = ahead.last() != Some(&b'\n');
            for end in memchr_iter(b'\n', ahead) {
                skipped += 1;
                if skipped == count {
                    passed = end + 1;
                    break;
                }
            }
            self.at += passed;
        }
        self.lines_above += skipped;
        Ok(skipped)
    }
}
