//! Text decoded piece by piece on all threads, so that neither it nor what it says need be in
//! memory whole.

use std::ops::{ControlFlow, Range};

use rayon::prelude::*;

use super::ReadFault;
use super::bytes::{Slice, Unpacked};
use super::scan::Scanner;
use super::windows::{Source, Windows};

/// Bytes of a piece, at the least.
const PIECE: usize = 1 << 16;
/// Bytes in which the end of a piece is looked for at once.
const LOOKED_AT: usize = 1 << 12;
/// Pieces for every thread between two times that memory is given back.
const PIECES: usize = 4;

/// Cuts a `range` of `source` into pieces that end behind an `end`, and passes what `decode` makes
/// of each on to `take`, in order, until that breaks. Text that was decoded is released.
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

/// Cuts a text that is read by windows like [`decode_pieces`] one that is in memory, and decodes
/// each piece by itself: no more than the pieces in hand is kept.
///
/// # Errors
/// Those of `take`, and [`ReadFault::Changed`] or [`ReadFault::Io`] where the text cannot be read
/// as it was.
pub(super) fn decode_windows<T: Send>(
    source: &Source,
    range: Range<usize>,
    is_end: fn(u8) -> bool,
    decode: impl Fn(&[u8]) -> T + Sync,
    take: impl FnMut(T) -> Result<ControlFlow<()>, ReadFault>,
) -> Result<(), ReadFault> {
    let end = range.end;
    let end_from = |least: usize| {
        (least..end).step_by(LOOKED_AT).find_map(|from| {
            let window = from..(from + LOOKED_AT).min(end);
            let found = source.with(window, |bytes| bytes.iter().position(|&b| is_end(b)));
            found.map(|found| from + found + 1)
        })
    };
    let decode = |piece: Range<usize>| source.with(piece, &decode);
    let decoded = in_pieces(range, end_from, decode, take, |done| source.release(done));
    // What could not be read was taken for zeros.
    source.check().map_err(ReadFault::from)?;
    decoded
}

/// Passes what `decode` makes of pieces on, each of which ends where `end_from` says that one does
/// from a place on.
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

/// Appends the numbers of a `text` within `source` as little-endian f64.
///
/// # Errors
/// [`ReadFault::Line`] for what is no number, and those of [`Unpacked::push`].
pub(super) fn decode_numbers(
    source: Slice,
    text: Range<usize>,
    out: &mut Unpacked,
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
