//! A set of numbers within a range, a bit each, that knows how many come before each of its members.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use bytemuck::allocation::zeroed_vec;
use rayon::prelude::*;

/// Numbers that several threads enter.
pub(super) struct Entered {
    first: u32,
    words: Vec<AtomicU64>,
}

/// Numbers of which each has a rank.
pub(super) struct Ranked {
    first: u32,
    words: Vec<u64>,
    /// Members before each word.
    before: Vec<u32>,
}

impl Entered {
    /// None of a range.
    pub(super) fn none_of(range: Range<u32>) -> Self {
        Self { first: range.start, words: zeroed_vec(range.len().div_ceil(64)) }
    }

    /// Bytes of a set of a range of so many numbers, once it is ranked.
    pub(super) fn bytes(numbers: u64) -> u64 {
        numbers.div_ceil(64) * (size_of::<u64>() + size_of::<u32>()) as u64
    }

    /// Enters a number of the range.
    pub(super) fn insert(&self, number: u32) {
        let at = number - self.first;
        let (word, bit) = (&self.words[at as usize / 64], 1 << (at % 64));
        // Read first: most are there already, and reading disturbs no other thread.
        if word.load(Ordering::Relaxed) & bit == 0 {
            word.fetch_or(bit, Ordering::Relaxed);
        }
    }

    /// Ranks the numbers that were entered.
    pub(super) fn ranked(self) -> Ranked {
        let words: Vec<u64> = self.words.into_iter().map(AtomicU64::into_inner).collect();
        let mut total = 0;
        let before = words.iter().map(|word| {
            let before = total;
            total += word.count_ones();
            before
        });
        let mut before: Vec<u32> = before.collect();
        before.push(total);
        Ranked { first: self.first, words, before }
    }
}

impl Ranked {
    /// How many members there are.
    pub(super) fn len(&self) -> usize {
        self.before.last().map_or(0, |&total| total as usize)
    }

    /// How many members come before a number, if it is one.
    pub(super) fn rank(&self, number: u32) -> Option<u32> {
        let at = number.checked_sub(self.first)?;
        let word = *self.words.get(at as usize / 64)?;
        let bit = 1 << (at % 64);
        (word & bit != 0).then(|| self.before[at as usize / 64] + (word & (bit - 1)).count_ones())
    }

    /// Members of a range, in order.
    pub(super) fn within(&self, range: Range<u32>) -> impl Iterator<Item = u32> + '_ {
        let [start, end] = [range.start, range.end].map(|number| number.saturating_sub(self.first));
        let words = start as usize / 64..(end as usize).div_ceil(64).min(self.words.len());
        let all = words.flat_map(|n| {
            let mut word = self.words[n];
            std::iter::from_fn(move || {
                let bit = (word != 0).then(|| word.trailing_zeros())?;
                word &= word - 1;
                Some((n * 64) as u32 + bit)
            })
        });
        all.filter(move |at| (start..end).contains(at)).map(|at| at + self.first)
    }

    /// Maps the members of a range, on several threads; in their order.
    pub(super) fn map<T: Send>(&self, range: Range<u32>, of: impl Fn(u32) -> Option<T> + Sync) -> Vec<T> {
        const NUMBERS: u32 = 1 << 13;
        let parts: Vec<Vec<T>> = (0..range.len() as u32)
            .into_par_iter()
            .step_by(NUMBERS as usize)
            .map(|from| {
                let start = range.start + from;
                self.within(start..start.saturating_add(NUMBERS).min(range.end)).filter_map(&of).collect()
            })
            .collect();
        parts.into_iter().flatten().collect()
    }
}
