//! A selection of rows: one bit per row, and counts that find a selected row by its index.

use std::ops::Range;

use crate::system::bits::ones;

/// Number of rows per word: one bit for each row.
const WORD: usize = 64;
/// Number of words per group. [`Sieve`] stores a count of selected rows for each group.
const WORDS: usize = 64;
/// Number of rows per group.
pub(super) const GROUP: usize = WORD * WORDS;

/// A selection of the rows of a table, in order.
#[derive(Debug, Clone, Default)]
pub struct Sieve {
    words: Vec<u64>,
    /// The number of selected rows before each group of words.
    before: Vec<usize>,
    count: usize,
}

impl Sieve {
    /// Selects the rows whose bits are set, row 0 being the lowest bit of the first word.
    pub fn new(words: Vec<u64>) -> Self {
        let (mut before, mut count) = (Vec::with_capacity(words.len().div_ceil(WORDS)), 0);
        for group in words.chunks(WORDS) {
            before.push(count);
            count += group.iter().map(|word| word.count_ones() as usize).sum::<usize>();
        }
        Self { words, before, count }
    }

    /// Words without set bits, for `rows` rows.
    pub fn none(rows: usize) -> Vec<u64> {
        vec![0; rows.div_ceil(WORD)]
    }

    /// Sets the bit of a row.
    pub fn set(words: &mut [u64], row: usize) {
        words[row / WORD] |= 1 << (row % WORD);
    }

    /// The number of selected rows.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Memory, in bytes, that the sieve occupies.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&*self.words) + size_of_val(&*self.before)) as u64
    }

    /// The last selected row.
    pub fn last(&self) -> Option<usize> {
        let (at, word) = self.words.iter().enumerate().rev().find(|(_, word)| **word != 0)?;
        Some(at * WORD + WORD - 1 - word.leading_zeros() as usize)
    }

    /// Returns the selected rows that `inner` also selects. Row i of `inner` stands for selected
    /// row number i of this sieve.
    pub fn filtered_by(&self, inner: &Self) -> Self {
        let mut words = vec![0; self.words.len()];
        let rows = self.rows(0).enumerate().filter(|(number, _)| inner.holds(*number));
        rows.for_each(|(_, row)| Self::set(&mut words, row));
        Self::new(words)
    }

    /// The smallest range of rows that contains the selected rows with the numbers `selected`.
    /// Selected rows are numbered from 0, in order.
    pub fn around(&self, selected: Range<usize>) -> Range<usize> {
        let row = |number| self.rows(number).next();
        match (row(selected.start), selected.end.checked_sub(1).and_then(row)) {
            (Some(first), Some(last)) => first..last + 1,
            _ => 0..0,
        }
    }

    /// Whether a row is selected.
    pub fn holds(&self, row: usize) -> bool {
        self.words[row / WORD] >> (row % WORD) & 1 != 0
    }

    /// The selected rows in order, starting with selected row number `first`.
    pub fn rows(&self, first: usize) -> impl Iterator<Item = usize> + '_ {
        let group = self.before.partition_point(|&before| before <= first).saturating_sub(1);
        let mut skipped = first - self.before.get(group).copied().unwrap_or(first);
        let mut start = group * WORDS;
        while let Some(word) = self.words.get(start) {
            let count = word.count_ones() as usize;
            if count > skipped {
                break;
            }
            (skipped, start) = (skipped - count, start + 1);
        }
        let words = self.words.get(start..).unwrap_or_default().iter().zip(start..);
        words.flat_map(|(&word, at)| ones(word).map(move |bit| at * WORD + bit)).skip(skipped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_found_by_their_number_among_the_selected_rows() {
        for rows in [0, 1, 63, 64, 65, 4096, 4097, 20_000] {
            for every in [1, 2, 63, 64, 65, 5000] {
                let selected: Vec<usize> =
                    (0..rows).filter(|row| row % every == every / 2).collect();
                let mut words = Sieve::none(rows);
                selected.iter().for_each(|&row| Sieve::set(&mut words, row));
                let sieve = Sieve::new(words);
                assert_eq!(sieve.count(), selected.len());
                assert_eq!(sieve.last(), selected.last().copied());
                let inner: Vec<usize> = selected.iter().copied().step_by(3).collect();
                let mut thirds = Sieve::none(selected.len());
                (0..selected.len()).step_by(3).for_each(|number| Sieve::set(&mut thirds, number));
                assert!(sieve.filtered_by(&Sieve::new(thirds)).rows(0).eq(inner));
                assert!((0..rows).all(|row| sieve.holds(row) == (row % every == every / 2)));
                for first in [0, 1, 64, 70, selected.len() / 2, selected.len()] {
                    let from: Vec<usize> = sieve.rows(first).collect();
                    assert_eq!(
                        from,
                        selected.get(first..).unwrap_or_default(),
                        "{rows} {every} {first}"
                    );
                }
            }
        }
    }
}
