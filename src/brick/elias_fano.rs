//! The Elias-Fano code, which stores a multiset of integers in close to the minimum space.
//!
//! Let n integers be at most u, and let l be the number of bits of u / n. The lowest l bits of each
//! integer are stored directly. Its higher bits are its key: integers are sorted by key, and
//! integer number i sets bit `key + i` of a bit map. The code takes l + 1 bits per integer, and up
//! to n more bits for the keys. The order of integers with the same key does not matter, so a
//! counting sort is enough.
//!
//! P. Elias: *Efficient storage and retrieval by content and address of static files* (1974).

use crate::system::bits::ones;

const WORD: usize = u64::BITS as usize;

/// The layout of a coded multiset: the bit map, the low bits, and a word of padding.
#[derive(Debug, Clone, Copy)]
pub(super) struct EliasFano {
    count: usize,
    low_bits: u32,
    keys: usize,
}

impl EliasFano {
    /// The layout for `count` integers that are at most `greatest`. `count` must be at least 1.
    pub fn new(count: usize, greatest: u64) -> Self {
        let low_bits =
            (u64::BITS - (greatest / count as u64).leading_zeros()).clamp(1, u64::BITS - 1);
        Self { count, low_bits, keys: (greatest >> low_bits) as usize + 1 }
    }

    fn map_words(&self) -> usize {
        (self.count + self.keys).div_ceil(WORD)
    }

    /// Returns the length of the code in words.
    pub fn words(&self) -> usize {
        self.map_words() + (self.count * self.low_bits as usize).div_ceil(WORD) + 1
    }

    /// The indices of the `integers`, sorted by key.
    pub fn order(&self, integers: &[u64]) -> Vec<u32> {
        let key = |integer: u64| (integer >> self.low_bits) as usize;
        let mut next = vec![0; self.keys + 1];
        integers.iter().for_each(|&integer| next[key(integer) + 1] += 1);
        for key in 1..next.len() {
            next[key] += next[key - 1];
        }
        let mut order = vec![0; integers.len()];
        for (&integer, number) in integers.iter().zip(0..) {
            let place: &mut u32 = &mut next[key(integer)];
            order[*place as usize] = number;
            *place += 1;
        }
        order
    }

    /// Encodes integers that are sorted in the order of [`order`](Self::order).
    pub fn encode(&self, integers: impl Iterator<Item = u64>) -> Vec<u64> {
        let mut words = vec![0; self.words()];
        let (map, low) = words.split_at_mut(self.map_words());
        for (i, integer) in integers.enumerate() {
            let one = (integer >> self.low_bits) as usize + i;
            map[one / WORD] |= 1 << (one % WORD);
            let (word, shift) = self.low_place(i);
            let pair = u128::from(integer & self.low_mask()) << shift;
            low[word] |= pair as u64;
            low[word + 1] |= (pair >> WORD) as u64;
        }
        words
    }

    /// Decodes `words`.
    pub fn decode(self, words: &[u64]) -> impl Iterator<Item = u64> + '_ {
        let (map, low) = words.split_at(self.map_words());
        let ones =
            map.iter().enumerate().flat_map(|(w, &word)| ones(word).map(move |bit| w * WORD + bit));
        ones.enumerate().map(move |(i, one)| {
            let (word, shift) = self.low_place(i);
            let pair = u128::from(low[word + 1]) << WORD | u128::from(low[word]);
            ((one - i) as u64) << self.low_bits | (pair >> shift) as u64 & self.low_mask()
        })
    }

    fn low_place(&self, i: usize) -> (usize, usize) {
        let bit = i * self.low_bits as usize;
        (bit / WORD, bit % WORD)
    }

    fn low_mask(&self) -> u64 {
        (1 << self.low_bits) - 1
    }
}

#[cfg(test)]
mod tests {
    use std::iter;

    use super::*;

    #[test]
    fn every_multiset_is_decoded_from_nearly_the_minimum_size() {
        let mut state = 1_u64;
        for greatest in [1, 5, 1000, (1 << 51) - 1, (77 << 51) - 1, u64::MAX] {
            for count in [1, 2, 3, 64, 65, 1000, 20_000] {
                let random = iter::repeat_with(|| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    (state ^ state >> 29) % greatest.saturating_add(1).max(1)
                });
                let mut integers: Vec<u64> =
                    [0, greatest].into_iter().chain(random).take(count).collect();
                let code = EliasFano::new(count, greatest);
                let order = code.order(&integers);
                let words = code.encode(order.iter().map(|&i| integers[i as usize]));
                let mut decoded: Vec<u64> = code.decode(&words).collect();
                decoded.sort_unstable();
                integers.sort_unstable();
                assert!(decoded == integers, "{count} up to {greatest}");
                let least = (u64::BITS - (greatest / count as u64).leading_zeros()).max(1);
                let most = (least as usize + 2) * count + 4 * WORD;
                assert!(
                    words.len() * WORD <= most,
                    "{count} up to {greatest}: {} words",
                    words.len()
                );
            }
        }
    }
}
