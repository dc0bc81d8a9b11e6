//! The integers of a legacy .vtk's arrays.

use crate::io::bytes::View;
use crate::io::columns::Endian;
use crate::io::scan::Scanner;
use crate::io::vertices::integer;
use crate::io::{ReadFault, malformed};

use super::layout::Array;

/// Numbers that are read from a file at once.
pub(super) const AT_ONCE: usize = 1 << 14;

/// Passes the numbers of an array on one by one, each with its place among them.
pub(super) fn each_integer(
    bytes: View,
    ascii: bool,
    array: &Array,
    mut take: impl FnMut(usize, i64),
) -> Result<(), ReadFault> {
    let (count, size) = (array.values(), array.scalar.size());
    if ascii {
        let mut scan = Scanner::releasing_to(bytes.kept()?, array.at..array.end);
        for index in 0..count {
            scan.skip_whitespace();
            take(index, scan.number()?);
        }
        return Ok(());
    }
    for first in (0..count).step_by(AT_ONCE) {
        let end = count.min(first + AT_ONCE);
        let piece = bytes.read(array.at + first * size..array.at + end * size)?;
        for (index, number) in (first..).zip(stored(&piece, array)) {
            take(index, number?);
        }
    }
    Ok(())
}

pub(super) type Integers<'a> = Box<dyn Iterator<Item = Result<i64, ReadFault>> + 'a>;

/// The numbers of an array of integers in a file that is in memory.
pub(super) fn integers<'a>(bytes: &'a [u8], ascii: bool, array: &'a Array) -> Integers<'a> {
    let Array { at, scalar, .. } = *array;
    if ascii {
        let mut scan = Scanner::new(bytes, at);
        return Box::new((0..array.values()).map(move |_| {
            scan.skip_whitespace();
            scan.number()
        }));
    }
    Box::new(stored(&bytes[at..at + array.values() * scalar.size()], array))
}

/// The integers that these bytes of a binary array hold.
pub(super) fn stored<'b>(
    bytes: &'b [u8],
    array: &'b Array,
) -> impl Iterator<Item = Result<i64, ReadFault>> + 'b {
    bytes.chunks_exact(array.scalar.size()).map(|stored| {
        let value = integer(array.scalar, Endian::Big, stored);
        value.ok_or_else(|| malformed(array.at, format!("{} are no integers", array.name)))
    })
}
