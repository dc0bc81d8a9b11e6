//! A stack of words in memory: words are added and removed at the end.
//!
//! The words are in slabs that are mapped one by one. Large slabs are huge pages, which the system
//! provides at a fraction of the cost of small pages. Removed slabs are returned to the system
//! immediately.

use std::borrow::Cow;
use std::io;
use std::ops::Range;

use bytemuck::{cast_slice, cast_slice_mut};
use memmap2::MmapMut;

use crate::system::memory::mapped_in_huge_pages;

/// Minimum size of a slab, in bytes: at least a page on most machines.
const LEAST: u64 = 1 << 14;
/// Maximum size of a slab, in bytes: a huge page on most machines.
const MOST: u64 = 1 << 21;
/// Number of slabs in a stack's share of memory. The number is large, so that the unused part of
/// the last slab is a small fraction of the share.
const SLABS_PER_SHARE: u64 = 16;

/// A stack of words, stored in slabs.
#[derive(Debug)]
pub(super) struct Slabs {
    /// Number of words in a slab.
    slab: usize,
    slabs: Vec<MmapMut>,
    len: usize,
}

impl Slabs {
    /// Bytes of a slab of a stack that may take about `share` bytes in total.
    pub(super) fn slab_bytes(share: u64) -> usize {
        1 << (share / SLABS_PER_SHARE).clamp(LEAST, MOST).ilog2()
    }

    /// An empty stack with slabs of `slab_bytes`.
    pub(super) fn new(slab_bytes: usize) -> Self {
        Self { slab: slab_bytes / size_of::<u64>(), slabs: Vec::new(), len: 0 }
    }

    /// Takes all words out, and leaves an empty stack.
    pub(super) fn take(&mut self) -> Self {
        let none = Self { slab: self.slab, slabs: Vec::new(), len: 0 };
        std::mem::replace(self, none)
    }

    /// Bytes of memory that the stack takes.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes_of(self.slabs.len())
    }

    /// Bytes of the additional slabs that `words` more words need.
    pub(super) fn bytes_for(&self, words: usize) -> u64 {
        self.bytes_of((self.len + words).div_ceil(self.slab) - self.slabs.len())
    }

    fn bytes_of(&self, slabs: usize) -> u64 {
        (slabs * self.slab * size_of::<u64>()) as u64
    }

    /// Adds `words`, and returns the index of the first added word.
    ///
    /// # Errors
    /// If the system has no memory for the words. In this case, no word is added.
    pub(super) fn push(&mut self, mut words: &[u64]) -> io::Result<usize> {
        let at = self.len;
        while self.slabs.len() * self.slab < at + words.len() {
            match mapped_in_huge_pages(self.slab * size_of::<u64>()) {
                Ok(slab) => self.slabs.push(slab),
                Err(fault) => {
                    self.truncate(at);
                    return Err(fault);
                }
            }
        }
        while !words.is_empty() {
            let (slab, first) = (self.len / self.slab, self.len % self.slab);
            let (fitting, rest) = words.split_at(words.len().min(self.slab - first));
            let slab: &mut [u64] = cast_slice_mut(&mut self.slabs[slab]);
            slab[first..][..fitting.len()].copy_from_slice(fitting);
            self.len += fitting.len();
            words = rest;
        }
        Ok(at)
    }

    /// The words of `range`, copied if they lie in more than one slab.
    pub(super) fn get(&self, range: Range<usize>) -> Cow<'_, [u64]> {
        let within = |number: usize| -> &[u64] {
            let begin = number * self.slab;
            let end = range.end.min(begin + self.slab);
            &cast_slice(&self.slabs[number])[range.start.max(begin) - begin..end - begin]
        };
        let slabs = range.start / self.slab..range.end.div_ceil(self.slab);
        match slabs.len() {
            0 => Cow::Borrowed(&[]),
            1 => Cow::Borrowed(within(slabs.start)),
            _ => Cow::Owned(slabs.flat_map(within).copied().collect()),
        }
    }

    /// Removes all words from index `len` on, and returns the number of freed bytes.
    pub(super) fn truncate(&mut self, len: usize) -> u64 {
        let before = self.bytes();
        self.len = len;
        self.slabs.truncate(len.div_ceil(self.slab));
        before - self.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slab_size_depends_on_the_share_within_fixed_limits() {
        for (share, bytes) in
            [(0, 1 << 14), (1 << 20, 1 << 16), ((1 << 21) - 1, 1 << 16), (u64::MAX, 1 << 21)]
        {
            assert_eq!(Slabs::slab_bytes(share), bytes, "{share}");
        }
    }

    #[test]
    fn words_round_trip_across_slabs_and_empty_slabs_are_freed() {
        let slab = Slabs::slab_bytes(0) / size_of::<u64>();
        let (mut slabs, mut all) = (Slabs::new(Slabs::slab_bytes(0)), Vec::new());
        let lengths = [1, slab - 1, 700, 3 * slab, 0, slab + 3];
        let mut places = Vec::new();
        for len in lengths {
            let words: Vec<u64> = (0..len as u64).map(|i| i * i + len as u64).collect();
            let (before, more) = (slabs.bytes(), slabs.bytes_for(len));
            places.push(slabs.push(&words).unwrap());
            assert_eq!(slabs.bytes(), before + more);
            all.extend(words);
        }
        for (&at, len) in places.iter().zip(lengths) {
            assert_eq!(*slabs.get(at..at + len), all[at..at + len]);
        }
        for &at in places.iter().rev() {
            let before = slabs.bytes();
            assert_eq!(before - slabs.truncate(at), slabs.bytes());
            assert_eq!(slabs.bytes(), (at.div_ceil(slab) * slab * size_of::<u64>()) as u64);
            assert_eq!(*slabs.get(0..at), all[..at]);
        }
    }
}
