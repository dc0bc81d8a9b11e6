//! Text decoded piece by piece on all threads, so that neither it nor what it says need be in memory whole.

use std::ops::{ControlFlow, Range};

use rayon::prelude::*;

use super::ReadFault;
use super::bytes::{ByteStore, Unpacked};
use super::scan::Scanner;

/// Bytes of a piece, at the least.
const PIECE: usize = 1 << 16;
/// Pieces for every thread between two times that memory is given back.
const PIECES: usize = 4;

/// Cuts a `range` of `source` into pieces that end behind an `end`, and passes what `decode` makes of each on to
/// `take`, in order, until that breaks. Text that was decoded is released.
///
/// # Errors
/// Those of `take`.
pub(super) fn decode_pieces<T: Send>(
    source: &dyn ByteStore,
    range: Range<usize>,
    is_end: fn(u8) -> bool,
    decode: impl Fn(Range<usize>) -> T + Sync,
    mut take: impl FnMut(T) -> Result<ControlFlow<()>, ReadFault>,
) -> Result<(), ReadFault> {
    let text = &source[..range.end];
    let mut start = range.start;
    while start < range.end {
        let mut pieces = Vec::new();
        let mut at = start;
        while at < range.end && pieces.len() < PIECES * rayon::current_num_threads() {
            let least = (at + PIECE).min(range.end);
            let end = text[least..].iter().position(|&b| is_end(b)).map_or(range.end, |end| least + end + 1);
            pieces.push(at..end);
            at = end;
        }
        let decoded: Vec<T> = pieces.into_par_iter().map(&decode).collect();
        for piece in decoded {
            if take(piece)?.is_break() {
                return Ok(());
            }
        }
        source.release(start..at);
        start = at;
    }
    Ok(())
}

/// Appends the numbers of a `text` within `source` as little-endian f64.
///
/// # Errors
/// [`ReadFault::Line`] for what is no number, and those of [`Unpacked::push`].
pub(super) fn decode_numbers(
    source: &dyn ByteStore,
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
