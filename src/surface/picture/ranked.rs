//! A set of numbers within a range, stored as one bit per number. The rank of a member is the
//! number of smaller members.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use crate::system::bits::ones;
use crate::system::memory::zeroed;

/// Length of the range of numbers that a task maps.
const NUMBERS: u32 = 1 << 13;

/// A set to which several threads can add members at the same time.
pub(super) struct AtomicSet {
    first: u32,
    words: Vec<AtomicU64>,
}

/// A set whose members have ranks.
pub(super) struct RankedSet {
    first: u32,
    words: Vec<u64>,
    /// Number of members before each word.
    before: Vec<u32>,
}

impl AtomicSet {
    /// An empty set for the numbers in a range.
    pub(super) fn none_of(range: Range<u32>) -> Self {
        Self { first: range.start, words: zeroed(range.len().div_ceil(64)) }
    }

    /// Size, in bytes, of a ranked set for a range of `numbers` numbers.
    pub(super) fn bytes(numbers: u64) -> u64 {
        numbers.div_ceil(64) * (size_of::<u64>() + size_of::<u32>()) as u64
    }

    /// Adds a number of the range.
    pub(super) fn insert(&self, number: u32) {
        let at = number - self.first;
        let (word, bit) = (&self.words[at as usize / 64], 1 << (at % 64));
        // Most numbers are already members. Reading the word first avoids most writes, and unlike a
        // write, a read does not slow other threads down.
        if word.load(Ordering::Relaxed) & bit == 0 {
            word.fetch_or(bit, Ordering::Relaxed);
        }
    }

    /// Computes the ranks.
    pub(super) fn ranked(self) -> RankedSet {
        let words: Vec<u64> = self.words.into_iter().map(AtomicU64::into_inner).collect();
        let mut total = 0;
        let before = words.iter().map(|word| {
            let before = total;
            total += word.count_ones();
            before
        });
        let mut before: Vec<u32> = before.collect();
        before.push(total);
        RankedSet { first: self.first, words, before }
    }
}

impl RankedSet {
    /// Number of members.
    pub(super) fn len(&self) -> usize {
        self.before.last().map_or(0, |&total| total as usize)
    }

    /// Whether a number is a member.
    #[inline]
    pub(super) fn contains(&self, number: u32) -> bool {
        let at = number.wrapping_sub(self.first);
        self.words.get(at as usize / 64).is_some_and(|word| word >> (at % 64) & 1 == 1)
    }

    /// The rank of a member; `None` for other numbers.
    #[inline]
    pub(super) fn rank(&self, number: u32) -> Option<u32> {
        let at = number.checked_sub(self.first)?;
        let word = *self.words.get(at as usize / 64)?;
        let bit = 1 << (at % 64);
        (word & bit != 0).then(|| self.before[at as usize / 64] + (word & (bit - 1)).count_ones())
    }

    /// Members in a range, in order.
    pub(super) fn within(&self, range: Range<u32>) -> impl Iterator<Item = u32> + '_ {
        let [start, end] = [range.start, range.end].map(|number| number.saturating_sub(self.first));
        let words = start as usize / 64..(end as usize).div_ceil(64).min(self.words.len());
        let all = words.flat_map(|n| ones(self.words[n]).map(move |bit| (n * 64 + bit) as u32));
        all.filter(move |at| (start..end).contains(at)).map(|at| at + self.first)
    }

    /// Maps the members of a range in parallel. The results are in the order of the members.
    pub(super) fn map<T: Send + Copy + Default>(
        &self,
        range: Range<u32>,
        of: impl Fn(u32) -> T + Sync,
    ) -> Vec<T> {
        let first = self.rank_from(range.start);
        let mut all = vec![T::default(); (self.rank_from(range.end) - first) as usize];
        let (mut rest, mut parts) = (&mut all[..], Vec::new());
        for start in range.clone().step_by(NUMBERS as usize) {
            let part = start..start.saturating_add(NUMBERS).min(range.end);
            let members = self.rank_from(part.end) - self.rank_from(part.start);
            let (own, others) = rest.split_at_mut(members as usize);
            parts.push((part, own));
            rest = others;
        }
        parts.into_par_iter().for_each(|(part, own)| {
            self.within(part).zip(own).for_each(|(member, to)| *to = of(member));
        });
        all
    }

    /// The number of members that are less than `number`.
    fn rank_from(&self, number: u32) -> u32 {
        let at = number.saturating_sub(self.first) as usize;
        match self.words.get(at / 64) {
            Some(word) => self.before[at / 64] + (word & ((1 << (at % 64)) - 1)).count_ones(),
            None => self.before[self.words.len()],
        }
    }
}
