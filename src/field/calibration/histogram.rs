//! A histogram of a field's samples.

use rayon::prelude::*;

/// Sample counts, indexed by upper byte and then lower byte. Samples inside a fluid have similar
/// values, so few pages are needed.
pub struct Histogram {
    pages: [Option<Box<[u64; 256]>>; 256],
}

impl Default for Histogram {
    fn default() -> Self {
        Self { pages: [const { None }; 256] }
    }
}

impl Histogram {
    /// Counts the samples that `add` adds for each part.
    pub fn of<T: Sync>(parts: &[T], add: impl Fn(&mut Self, &T) + Sync) -> Self {
        let add = |mut histogram: Self, part: &T| {
            add(&mut histogram, part);
            histogram
        };
        parts.par_iter().fold(Self::default, add).reduce(Self::default, Self::join)
    }

    fn page(&mut self, upper: u8) -> &mut [u64; 256] {
        self.pages[usize::from(upper)].get_or_insert_with(|| Box::new([0; 256]))
    }

    /// Adds the samples of `row` whose bits are set in `chosen`.
    pub fn add(&mut self, row: &[u16], mut chosen: u128) {
        for sample in row {
            if chosen & 1 != 0 {
                let [upper, lower] = sample.to_be_bytes();
                self.page(upper)[usize::from(lower)] += 1;
            }
            chosen >>= 1;
        }
    }

    fn join(mut self, other: Self) -> Self {
        for (upper, page) in (0..=255).zip(other.pages) {
            let Some(page) = page else { continue };
            self.page(upper).iter_mut().zip(*page).for_each(|(a, b)| *a += b);
        }
        self
    }

    /// The samples that occurred, in ascending order, with their counts.
    fn counts(&self) -> impl Iterator<Item = (u16, u64)> + '_ {
        let pages =
            (0_u8..=255).zip(&self.pages).filter_map(|(upper, page)| Some((upper, page.as_ref()?)));
        let counts = pages.flat_map(|(upper, page)| {
            (0_u8..=255)
                .zip(page.iter())
                .map(move |(lower, &count)| (u16::from_be_bytes([upper, lower]), count))
        });
        counts.filter(|&(_, count)| count > 0)
    }

    /// The number of added samples.
    pub fn total(&self) -> u64 {
        self.counts().map(|(_, count)| count).sum()
    }

    /// The lowest sample such that at least a fraction `share` of all samples is less than or equal
    /// to it.
    pub fn quantile(&self, share: f64) -> Option<u16> {
        let wanted = ((self.total() as f64 * share).ceil() as u64).max(1);
        let mut below = 0;
        let reached = |&(_, count): &(u16, u64)| {
            below += count;
            below >= wanted
        };
        self.counts().find(reached).map(|(sample, _)| sample)
    }
}
